//! Going on with a run.
//!
//! Everything is judged before anything changes: the checkpoint, the files that belong to it, and whether every plugin takes its state. A
//! launch that fails leaves the folder of the run as it was.

use std::path::{Path, PathBuf};

use anyhow::{Result, anyhow};

use super::{
    build::Prepared,
    launch::{Launch, Order},
};
use crate::checkpoint::{BEGIN_ANEW, CheckpointError, LockedCheckpoints, Provenance, Saved};

/// What came of the trial of a checkpoint.
enum Judged {
    Usable(Box<(Prepared, Saved)>),
    Refused(CheckpointError),
}

impl Order<'_> {
    /// Goes on with the run from its last checkpoint, or from the one before it if the last one is damaged or a plugin refuses its state.
    /// The run stays locked from the first look to its end.
    ///
    /// # Errors
    /// There is no usable checkpoint, another process writes the run, a checkpoint is of other plugins or another configuration, or a file is
    /// missing or cannot be read or written. Then the folder is as it was.
    pub fn proceed(&self) -> Result<Launch> {
        let provenance = self.provenance()?;
        let locked = LockedCheckpoints::of(self.folder.path()).map_err(stop)?;
        let locked = locked.ok_or_else(|| without_checkpoint(&[]))?;
        let mut refused = Vec::new();
        for path in locked.paths().map_err(stop)? {
            let judged = self.judge(&locked, &path, &provenance);
            match judged.map_err(|error| after_refusals(error, &refused))? {
                Judged::Usable(usable) => {
                    let (prepared, saved) = *usable;
                    return self.go_on(locked, provenance, prepared, saved, &refused);
                }
                Judged::Refused(error) => refused.push((path, error)),
            }
        }
        Err(without_checkpoint(&refused))
    }

    /// Tries a checkpoint with plugins of its own, which nobody uses any more if they refuse it.
    fn judge(&self, locked: &LockedCheckpoints, path: &Path, provenance: &Provenance) -> Result<Judged> {
        let saved = match locked.read(path, provenance) {
            Ok(saved) => saved,
            Err(error) if error.is_damage() => return Ok(Judged::Refused(error)),
            Err(error) => return Err(stop(error)),
        };
        let mut prepared = self.prepare()?;
        let participants = &mut prepared.participants;
        let taken = locked.fill(&saved, &mut participants.experience).and_then(|()| {
            let restored = participants.restore(&saved.state);
            restored.map_err(|error| CheckpointError::Refused { path: path.to_owned(), error })
        });
        match taken {
            Ok(()) => Ok(Judged::Usable(Box::new((prepared, saved)))),
            Err(error) if error.is_damage() => Ok(Judged::Refused(error)),
            Err(error) => Err(stop(error)),
        }
    }

    /// First everything is opened, then the files are cut back to the checkpoint.
    fn go_on(
        &self,
        locked: LockedCheckpoints,
        provenance: Provenance,
        prepared: Prepared,
        saved: Saved,
        refused: &[(PathBuf, CheckpointError)],
    ) -> Result<Launch> {
        let mut recorder = self.recorder(Some(saved.recorder.clone()), &prepared).map_err(|error| {
            anyhow!("{error:#}. Nothing was changed; remove the cause, then give the same command again")
        })?;
        let mut store = locked.go_on(&saved, provenance).map_err(stop)?;
        // From here on the folder changes.
        recorder.cut_back(&saved.recorder)?;
        let mut warnings = Vec::new();
        for (path, error) in refused {
            let kept = store.set_aside(path)?;
            warnings.push(format!(
                "a checkpoint is passed over for the one before, and kept as {}: {error}",
                kept.display()
            ));
        }
        store.cut_back(prepared.participants.experience.row_bytes())?;

        let unsaved = saved.state.unsaved();
        warnings.extend(unsaved.iter().map(|field| {
            format!(
                "the plugin of `{field}` cannot save its state: it begins anew, after a counted hard reset"
            )
        }));
        let recorder = recorder.with_checkpoints(store, unsaved.is_empty());
        Ok(self.launch(prepared, recorder, Some(saved.state), None, warnings))
    }
}

/// Why the run does not go on, and what to do.
fn stop(error: CheckpointError) -> anyhow::Error {
    anyhow!("{error}. Nothing was changed; {}", error.remedy())
}

/// The same, where the latest checkpoint had been passed over before.
fn after_refusals(error: anyhow::Error, refused: &[(PathBuf, CheckpointError)]) -> anyhow::Error {
    if refused.is_empty() { error } else { anyhow!("{}; then {error:#}", reasons(refused)) }
}

fn without_checkpoint(refused: &[(PathBuf, CheckpointError)]) -> anyhow::Error {
    if refused.is_empty() {
        return anyhow!("it has no checkpoint to go on from. Nothing was changed; {BEGIN_ANEW}");
    }
    anyhow!("no checkpoint of it can be used: {}. Nothing was changed; {BEGIN_ANEW}", reasons(refused))
}

fn reasons(refused: &[(PathBuf, CheckpointError)]) -> String {
    refused.iter().map(|(_, error)| error.to_string()).collect::<Vec<_>>().join("; ")
}
