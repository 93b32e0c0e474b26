//! What an instance of a plugin has learned, to be kept.

use serde::{Deserialize, Serialize};
use serde_bytes::ByteBuf;
use shield_api::{Checkpoint, ErrorKind, Result};

/// The state of a plugin's instance, or that it cannot save one.
#[derive(Serialize, Deserialize)]
pub struct PluginState(Option<ByteBuf>);

impl PluginState {
    /// Asks a plugin for its state.
    ///
    /// # Errors
    /// The plugin can save its state, but failed to.
    pub fn of<P: Checkpoint + ?Sized>(plugin: &P) -> Result<Self> {
        let mut bytes = Vec::new();
        match plugin.save(&mut bytes) {
            Ok(()) => Ok(Self(Some(bytes.into()))),
            Err(error) if error.kind() == ErrorKind::Unsupported => Ok(Self(None)),
            Err(error) => Err(error),
        }
    }

    /// Whether there is a state.
    pub fn is_saved(&self) -> bool {
        self.0.is_some()
    }

    /// Gives the state to a new instance of the same configuration; leaves it new where there is none.
    ///
    /// # Errors
    /// The plugin refuses the state.
    pub fn restore<P: Checkpoint + ?Sized>(&self, plugin: &mut P) -> Result<()> {
        self.0.as_ref().map_or(Ok(()), |bytes| plugin.load(bytes))
    }
}
