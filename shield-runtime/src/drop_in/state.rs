//! Keeping what a drop-in has learned and counted, in a file.

use std::{io, ops::Range, path::Path};

use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};
use serde_bytes::ByteBuf;

use super::DropIn;
use crate::{
    checkpoint::{
        CheckpointError,
        file::{read, write},
    },
    plugin::PluginState,
    record::Counters,
    shield::ShieldState,
};

/// Tells the file from that of a run.
const KIND: &str = "shield drop-in 2";

/// Why a state cannot be kept or used.
#[derive(Debug, thiserror::Error)]
pub enum StateError {
    /// The file.
    #[error(transparent)]
    File(#[from] CheckpointError),
    /// It belongs to another kind of program, or to other spaces.
    #[error("{path}: {what}")]
    Foreign {
        /// The file.
        path: String,
        /// In which way.
        what: String,
    },
    /// A plugin cannot save or refuses its state.
    #[error("{0}")]
    Plugin(shield_api::Error),
}

#[derive(Serialize, Deserialize)]
struct DropInState {
    kind: String,
    observation_len: usize,
    action_len: usize,
    /// As they are printed: they are only compared.
    spaces: String,
    counters: Counters,
    reset_successes: u64,
    shield: ShieldState,
    task: Option<PluginState>,
    learned: Option<LearnedState>,
}

#[derive(Serialize, Deserialize)]
struct LearnedState {
    masks: Pcg64,
    row_bytes: usize,
    kept: Range<u64>,
    rows: ByteBuf,
}

impl LearnedState {
    /// Whether the rows are those that it says it keeps.
    fn is_complete(&self) -> bool {
        let count = self.kept.end.checked_sub(self.kept.start);
        let bytes = count.and_then(|count| usize::try_from(count).ok()?.checked_mul(self.row_bytes));
        bytes == Some(self.rows.len())
    }
}

impl DropIn {
    /// Writes the reset agent, the rules, the reset task, the experience and the counts into a file, in one step: it is there whole or as it was.
    ///
    /// # Errors
    /// A plugin fails to save its state, or the file cannot be written. Only a regular file is replaced, see [`atomic_file`](crate::atomic_file).
    pub fn save(&mut self, path: &Path) -> Result<(), StateError> {
        let learned = self.learning.as_ref().map(|learning| {
            let (experience, mut rows) = (&learning.experience, Vec::new());
            experience.write_rows(experience.kept(), &mut rows);
            LearnedState {
                masks: learning.masks.clone(),
                row_bytes: experience.row_bytes(),
                kept: experience.kept(),
                rows: rows.into(),
            }
        });
        let state = DropInState {
            kind: KIND.into(),
            observation_len: self.observation.len(),
            action_len: self.executed.len(),
            spaces: format!("{:?}", self.spaces()),
            counters: self.counters,
            reset_successes: self.reset_successes,
            shield: self.shield.save().map_err(StateError::Plugin)?,
            task: self
                .task
                .as_ref()
                .map(|task| PluginState::of(&**task))
                .transpose()
                .map_err(StateError::Plugin)?,
            learned,
        };
        let path = absolute(path)?;
        Ok(write(&path, None, &state)?)
    }

    /// Goes on from a file of a shield with the same spaces, reset agent, rules and reset task; the settings of the rules may differ, and so may
    /// the capacity of the experience: of more transitions than there is room for, the newest stay. Where the environment stands is not known: a
    /// hard reset is needed.
    ///
    /// # Errors
    /// The file cannot be read or is damaged, belongs to another shield, or a plugin refuses its state; then a hard reset is needed too, and what was
    /// learned may be half of each.
    pub fn load(&mut self, path: &Path) -> Result<(), StateError> {
        self.require_hard_reset();
        let path = absolute(path)?;
        let state: DropInState = read(&path)?;
        let foreign = |what: String| StateError::Foreign { path: path.display().to_string(), what };
        if state.kind != KIND {
            return Err(foreign("it is not the state of a drop-in shield".into()));
        }
        let (found, own) =
            ((state.observation_len, state.action_len), (self.observation.len(), self.executed.len()));
        if found != own {
            return Err(foreign(format!(
                "it belongs to observations of {} and actions of {} numbers; here they have {} and {}",
                found.0, found.1, own.0, own.1
            )));
        }
        if state.spaces != format!("{:?}", self.spaces()) {
            return Err(foreign("it belongs to spaces with other bounds".into()));
        }
        for (name, is_there, is_here) in [
            ("a reset task", state.task.is_some(), self.task.is_some()),
            ("a memory", state.learned.is_some(), self.learning.is_some()),
        ] {
            if is_there != is_here {
                let (with, without) = if is_there { ("it", "this shield") } else { ("this shield", "it") };
                return Err(foreign(format!("{with} has {name}, and {without} has none")));
            }
        }
        if let (Some(learning), Some(learned)) = (&self.learning, &state.learned) {
            let (own, found) = (learning.experience.row_bytes(), learned.row_bytes);
            if own != found {
                let what = "its experience belongs to another ensemble";
                return Err(foreign(format!(
                    "{what}: a transition takes {found} bytes; here it takes {own}"
                )));
            }
            if !learned.is_complete() {
                return Err(foreign("its experience has more or fewer transitions than it says".into()));
            }
        }
        self.restore(state).map_err(StateError::Plugin)
    }

    fn restore(&mut self, state: DropInState) -> shield_api::Result<()> {
        self.shield.restore(&state.shield)?;
        if let (Some(task), Some(state)) = (&mut self.task, &state.task) {
            state.restore(&mut **task)?;
        }
        if let (Some(learning), Some(learned)) = (&mut self.learning, state.learned) {
            learning.experience.replace(learned.kept, &learned.rows);
            learning.masks = learned.masks;
        }
        (self.counters, self.reset_successes) = (state.counters, state.reset_successes);
        (self.is_deciding, self.is_in_forward_episode) = (false, false);
        Ok(())
    }
}

/// The folder of a bare file name is the working folder.
fn absolute(path: &Path) -> Result<std::path::PathBuf, CheckpointError> {
    std::path::absolute(path).map_err(|error: io::Error| CheckpointError::io(path, error))
}
