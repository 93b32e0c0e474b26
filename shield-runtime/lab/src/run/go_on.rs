//! Going on with a run.
//!
//! Everything is judged before anything changes: the checkpoint, the files that belong to it, and whether every plugin takes its state. A
//! launch that fails leaves the folder of the run as it was.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow};

use super::{
    build::prepare,
    launch::{Launch, Run, provenance},
    recorder::{Recorder, RecorderState},
};
use crate::{
    checkpoint::{BEGIN_ANEW, CheckpointError, LockedCheckpoints, Provenance, Saved},
    joint_loop::LoopParts,
};
use shield_host::plugin::Registry;

/// What came of the trial of a checkpoint.
enum Judged {
    Usable(Box<(LoopParts, Saved<RecorderState>)>),
    Refused(CheckpointError),
}

impl Run {
    /// Goes on with the run from its last checkpoint, or from the one before it if the last one is damaged or a plugin refuses its state.
    /// The run stays locked from the first look to its end.
    ///
    /// # Errors
    /// There is no usable checkpoint, another process writes the run, a checkpoint is of other plugins or another configuration, or a file is
    /// missing or cannot be read or written. Then the folder is as it was.
    pub fn proceed(&self, registry: &Registry) -> Result<Launch> {
        let provenance = provenance(registry, &self.variant, self.seed)?;
        let locked = LockedCheckpoints::of(self.folder.path()).map_err(stop)?;
        let locked = locked.ok_or_else(|| without_checkpoint(&[]))?;
        let mut refused = Vec::new();
        for path in locked.paths().map_err(stop)? {
            let judged = self.judge(registry, &locked, &path, &provenance);
            match judged.map_err(|error| after_refusals(error, &refused))? {
                Judged::Usable(usable) => {
                    let (parts, saved) = *usable;
                    let recorder = self.reopen(registry, &saved, &parts)?;
                    return go_on(locked, provenance, parts, recorder, saved, &refused);
                }
                Judged::Refused(error) => refused.push((path, error)),
            }
        }
        Err(without_checkpoint(&refused))
    }

    /// Tries a checkpoint with plugins of its own, which nobody uses any more if they refuse it.
    fn judge(
        &self,
        registry: &Registry,
        locked: &LockedCheckpoints,
        path: &Path,
        provenance: &Provenance,
    ) -> Result<Judged> {
        let saved: Saved<RecorderState> = match locked.read(path, provenance) {
            Ok(saved) => saved,
            Err(error) if error.is_damage() => return Ok(Judged::Refused(error)),
            Err(error) => return Err(stop(error)),
        };
        let mut parts = prepare(registry, &self.variant, self.seed)?;
        let experience = &mut parts.agents.memory.as_mut().context("a run has a memory")?.experience;
        let taken = locked.fill(&saved, experience).and_then(|()| {
            let restored = parts.restore(&saved.state);
            restored.map_err(|error| CheckpointError::Refused { path: path.to_owned(), error })
        });
        match taken {
            Ok(()) => Ok(Judged::Usable(Box::new((parts, saved)))),
            Err(error) if error.is_damage() => Ok(Judged::Refused(error)),
            Err(error) => Err(stop(error)),
        }
    }

    /// Opens the files, and changes nothing yet.
    fn reopen(
        &self,
        registry: &Registry,
        saved: &Saved<RecorderState>,
        parts: &LoopParts,
    ) -> Result<Recorder> {
        self.recorder(registry, Some(saved.recorder.clone()), parts).map_err(|error| {
            anyhow!("{error:#}. Nothing was changed; remove the cause, then give the same command again")
        })
    }
}

/// Cuts everything that is opened back to the checkpoint.
fn go_on(
    locked: LockedCheckpoints,
    provenance: Provenance,
    parts: LoopParts,
    mut recorder: Recorder,
    saved: Saved<RecorderState>,
    refused: &[(PathBuf, CheckpointError)],
) -> Result<Launch> {
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
    let memory = parts.agents.memory.as_ref().context("a run has a memory")?;
    store.cut_back(memory.experience.row_bytes())?;

    let unsaved = saved.state.unsaved();
    warnings.extend(unsaved.iter().map(|field| {
        format!("the plugin of `{field}` cannot save its state: it begins anew, after a counted hard reset")
    }));
    let recorder = recorder.with_checkpoints(store, unsaved.is_empty());
    Ok(Launch { parts, recorder, state: Some(saved.state), new: None, warnings })
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
