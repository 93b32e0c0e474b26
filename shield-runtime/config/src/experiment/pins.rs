//! Pins: which file of a plugin an experiment means.

use std::collections::HashSet;

use super::{ExperimentFile, InputError, Variant, edit::place_for_field};

impl ExperimentFile {
    /// The text of the file with `pins` (plugin id and SHA-256) in the place of its own. Nothing else in it changes.
    ///
    /// # Errors
    /// The text is not RON.
    pub fn with_pins(&self, pins: &[(String, String)]) -> Result<String, InputError> {
        let text = &self.text;
        let root = self.tree()?;
        let lines = pins.iter().map(|(id, sha256)| format!("\n        {id:?}: {sha256:?},"));
        let map = format!("{{{}\n    }}", lines.collect::<String>());
        let mut pinned = text.clone();
        if let Some(given) = root.entry("pins") {
            pinned.replace_range(given.value.span.clone(), &map);
        } else if let Some((at, needs_comma)) = place_for_field(&root) {
            let comma = if needs_comma { "," } else { "" };
            pinned.insert_str(at, &format!("{comma}\n    pins: {map}"));
        }
        Ok(pinned)
    }
}

/// A pin of a plugin that no variant uses protects nothing: most likely its id is misspelt.
pub(super) fn check_used(variants: &[Variant]) -> Result<(), InputError> {
    let plugins = variants.iter().flat_map(|variant| variant.experiment.plugins());
    let used: HashSet<&str> = plugins.map(|(_, _, choice)| choice.plugin.as_str()).collect();
    for variant in variants {
        if let Some(id) = variant.experiment.pins.keys().find(|id| !used.contains(id.as_str())) {
            let message = format!("{id:?} is pinned, but no variant uses a plugin of that id");
            return Err(variant.error_at(&format!("pins.{id}"), None, message));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pins_are_added_or_replaced_and_the_rest_of_the_file_stays() {
        let pins = [("a/b".to_string(), "12".to_string())];
        let map = "{\n        \"a/b\": \"12\",\n    }";
        for (before, after) in [
            ("X(\n    a: 1, // one\n)", format!("X(\n    a: 1,\n    pins: {map}, // one\n)")),
            ("X(\n    a: 1\n)", format!("X(\n    a: 1,\n    pins: {map}\n)")),
            ("X(pins: {\"c\": \"0\"}, a: 1)", format!("X(pins: {map}, a: 1)")),
        ] {
            assert_eq!(ExperimentFile::from_text("x.ron", before).with_pins(&pins).unwrap(), after);
        }
        let broken = ExperimentFile::from_text("x.ron", "X(").with_pins(&pins).unwrap_err();
        assert!(broken.to_string().starts_with("x.ron:1:"), "{broken}");
    }
}
