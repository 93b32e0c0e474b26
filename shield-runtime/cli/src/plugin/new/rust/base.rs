//! `[[ id ]]`: <% block summary %><% endblock %>.
#![forbid(unsafe_code)]

use shield_api::*;
<% block imports %><% endblock %>

config! {
    /// Settings of `[[ id ]]`.
    pub struct Settings {
<% block settings %><% endblock %>
    }
}

<% block instance %><% endblock %>

impl Plugin for [[ type ]] {
    type Config = Settings;

    fn create(settings: Settings, <% block setup %>setup<% endblock %>: &Setup) -> Result<Self> {
<% block create %><% endblock %>
    }
}

<% block abilities %><% endblock %>

<% if saved %>
impl Checkpoint for [[ type ]] {
    fn save(&self, bytes: &mut Vec<u8>) -> Result<()> {
        bytes.extend(self.[[ saved ]].to_le_bytes());
        Ok(())
    }

    fn load(&mut self, bytes: &[u8]) -> Result<()> {
        let bytes = bytes.try_into().map_err(|_| Error::invalid_argument("a saved state has 4 bytes"))?;
        self.[[ saved ]] = f32::from_le_bytes(bytes);
        Ok(())
    }
}
<% else %>
/// There is no state beyond the configuration: nothing to save, and nothing to load.
impl Checkpoint for [[ type ]] {
    fn save(&self, _bytes: &mut Vec<u8>) -> Result<()> {
        Ok(())
    }

    fn load(&mut self, bytes: &[u8]) -> Result<()> {
        if bytes.is_empty() { Ok(()) } else { Err(Error::invalid_argument("there is no state to load")) }
    }
}
<% endif %>

shield_api::export_plugin! {
    [[ entry ]] "[[ id ]]" => [[ type ]] { description: "<% block description %><% endblock %>", deterministic: true }
}

#[cfg(test)]
mod tests {
    use super::*;

<% block tests %><% endblock %>
}
