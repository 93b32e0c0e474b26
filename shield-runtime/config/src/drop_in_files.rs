//! The files of a drop-in: what it has learned and counted, and an event file for TensorBoard.

use std::path::{Path, PathBuf};

use shield_api::Error;

use crate::{
    state_file::{CheckpointError, DROP_IN, read, write},
    tensorboard::EventFile,
};
use shield_core::{
    cycle::HardResetDue,
    drop_in::{DropIn, DropInState, EpisodeLog, RestoreError},
};

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
    Plugin(Error),
}

/// Writes the reset agent, the rules, the reset task, the experience and the counts into a file, in one step.
///
/// # Errors
/// A plugin fails to save its state, or the file cannot be written.
pub fn save(drop_in: &mut DropIn, path: &Path) -> Result<(), StateError> {
    let state = drop_in.state().map_err(StateError::Plugin)?;
    Ok(write(&absolute(path)?, DROP_IN, None, &state)?)
}

/// Goes on from a file of a shield with the same spaces, reset agent, rules and reset task; the settings of the rules may differ. Where the
/// environment stands is not known: a hard reset is needed.
///
/// # Errors
/// The file cannot be read or is damaged, belongs to another shield, or a plugin refuses its state; then a hard reset is needed too, and what was
/// learned may be half of each.
pub fn load(drop_in: &mut DropIn, path: &Path) -> Result<(), StateError> {
    drop_in.require_hard_reset(HardResetDue::Lost);
    let path = absolute(path)?;
    let state: DropInState = read(&path, DROP_IN)?;
    drop_in.restore(state).map_err(|error| match error {
        RestoreError::Foreign(what) => StateError::Foreign { path: path.display().to_string(), what },
        RestoreError::Plugin(error) => StateError::Plugin(error),
    })
}

/// The folder of a bare file name is the working folder.
fn absolute(path: &Path) -> Result<PathBuf, CheckpointError> {
    std::path::absolute(path).map_err(|error| CheckpointError::io(path, error))
}

/// Writes an event file for TensorBoard, `tensorboard/…` in `folder`, with what each episode comes to from now on.
///
/// # Errors
/// It cannot be written.
pub fn log_to(drop_in: &mut DropIn, folder: &Path) -> shield_api::Result<()> {
    let events = EventFile::create(folder).map_err(failed)?;
    drop_in.log_episodes(Box::new(Events(events)));
    Ok(())
}

struct Events(EventFile);

impl EpisodeLog for Events {
    fn write(&mut self, step: u64, figures: &[(&str, f64)]) -> shield_api::Result<()> {
        self.0.scalars(step, figures).and_then(|()| self.0.flush()).map_err(failed)
    }
}

fn failed(error: anyhow::Error) -> Error {
    Error::failed(format!("{error:#}"))
}
