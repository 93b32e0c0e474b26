//! Checkpoints: what is needed to continue a run as if it had never stopped.
//!
//! A checkpoint is one file, written aside, synced and renamed, with the one before it kept. The experience is too large to be
//! written each time: it lies beside the file in segments that only grow, and the checkpoint says how far they count.

mod experience_log;
pub(crate) mod file;
mod store;

pub use file::CheckpointError;
pub use store::{CheckpointStore, PluginVersion, Provenance, Saved, last_checkpoint};

use serde::{Deserialize, Serialize};
use serde_bytes::ByteBuf;
use shield_api::{AbortRule, Checkpoint, ErrorKind, Result};

use crate::shield::Ladder;

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

/// The states of rules: all that a shield's ladder carries from one decision to the next.
pub(crate) fn save_rules(shield: Option<&mut Ladder>) -> Result<Vec<PluginState>> {
    let rules = shield.into_iter().flat_map(Ladder::rules);
    rules.map(|rule: &mut dyn AbortRule| PluginState::of(rule)).collect()
}

/// Gives rules their states.
pub(crate) fn restore_rules(shield: Option<&mut Ladder>, states: &[PluginState]) -> Result<()> {
    let rules = shield.into_iter().flat_map(Ladder::rules);
    rules.zip(states).try_for_each(|(rule, state)| state.restore(rule))
}
