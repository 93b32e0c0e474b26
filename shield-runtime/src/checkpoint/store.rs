//! The folder `checkpoint` of a run.

use std::{
    fs::{self, File, TryLockError},
    path::{Path, PathBuf},
};

use anyhow::Context;
use serde::{Deserialize, Serialize};

use super::{
    experience_log::{ExperienceLog, Mark},
    file::{self, CheckpointError, Result, sync_folder},
};
use crate::{
    atomic_file::remove_leftovers,
    experience::Experience,
    experiment,
    loop_state::LoopState,
    observer::{Occasion, Snapshot},
    run::RecorderState,
};

/// A plugin of a run.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PluginVersion {
    /// Its id.
    pub id: String,
    /// Its version.
    pub version: String,
}

/// What a run was made of: a checkpoint continues only that.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Provenance {
    /// The fully resolved configuration.
    pub config: String,
    /// The plugins, in the order of the experiment.
    pub plugins: Vec<PluginVersion>,
}

/// A checkpoint.
#[derive(Serialize, Deserialize)]
pub struct Saved {
    /// What the run was made of.
    pub provenance: Provenance,
    /// The loop and everyone in it.
    pub state: LoopState,
    /// Where the files of the run ended.
    pub recorder: RecorderState,
    /// Where the experience ended; `None` once the run is finished, since nobody learns any more.
    experience: Option<Mark>,
}

#[derive(Serialize)]
struct ToSave<'a> {
    provenance: &'a Provenance,
    state: &'a LoopState,
    recorder: &'a RecorderState,
    experience: &'a Option<Mark>,
}

/// Writes the checkpoints of one run. While it exists, no other process can.
#[derive(Debug)]
pub struct CheckpointStore {
    folder: PathBuf,
    provenance: Provenance,
    log: ExperienceLog,
    last_mark: Option<Mark>,
    /// Holds the lock.
    _lock: File,
}

fn folder_of(run: &Path) -> PathBuf {
    run.join("checkpoint")
}

fn latest(folder: &Path) -> PathBuf {
    folder.join("latest.bin")
}

fn previous(folder: &Path) -> PathBuf {
    folder.join("previous.bin")
}

impl CheckpointStore {
    /// Begins in the folder of a new run.
    ///
    /// # Errors
    /// The folder cannot be written.
    pub fn create(run: &Path, provenance: Provenance) -> Result<Self> {
        let folder = folder_of(run);
        fs::create_dir_all(&folder).map_err(|error| CheckpointError::io(&folder, error))?;
        let lock = lock(&folder)?;
        clear(&[run, &folder])?;
        sync_folder(run)?;
        Ok(Self { log: ExperienceLog::new(&folder), folder, provenance, last_mark: None, _lock: lock })
    }

    /// Refuses a run that another process is writing.
    ///
    /// # Errors
    /// It is so.
    pub fn ensure_free(run: &Path) -> Result<()> {
        let folder = folder_of(run);
        if folder.exists() { lock(&folder).map(drop) } else { Ok(()) }
    }

    /// Goes on from the last usable checkpoint of a run, if there is one, and fills `experience` from it. `warn` is told of a
    /// checkpoint that is passed over.
    ///
    /// # Errors
    /// Another process writes the run; a checkpoint belongs to another configuration or other plugins; a file cannot be cut back.
    pub fn resume(
        run: &Path,
        provenance: Provenance,
        experience: &mut Experience,
        warn: &mut dyn FnMut(String),
    ) -> Result<Option<(Self, Saved)>> {
        let folder = folder_of(run);
        if !folder.exists() {
            return Ok(None);
        }
        let lock = lock(&folder)?;
        clear(&[run, &folder])?;
        for path in [latest(&folder), previous(&folder)] {
            let usable = usable(&path, run, Some(&provenance)).and_then(|saved| {
                let mark = saved.experience.as_ref();
                mark.map_or(Ok(()), |mark| ExperienceLog::read(&folder, mark, experience))?;
                Ok(saved)
            });
            match usable {
                Ok(saved) => {
                    make_latest(&folder, &path)?;
                    let log = match &saved.experience {
                        Some(mark) => ExperienceLog::reopen(&folder, mark, experience.row_bytes())?,
                        None => ExperienceLog::new(&folder),
                    };
                    let last_mark = saved.experience.clone();
                    let store = Self { folder, provenance, log, last_mark, _lock: lock };
                    return Ok(Some((store, saved)));
                }
                Err(error) if error.is_damage() => {
                    if path.exists() {
                        warn(format!("a checkpoint is passed over: {error}"));
                    }
                }
                Err(error) => return Err(error),
            }
        }
        Ok(None)
    }

    /// Writes a checkpoint; the one before it is kept until the run is finished.
    ///
    /// # Errors
    /// A file cannot be written. The checkpoints before are as they were.
    pub fn write(&mut self, snapshot: &Snapshot<'_>, recorder: &RecorderState) -> Result<()> {
        let is_finished = snapshot.occasion == Occasion::Finished;
        let experience = if is_finished { None } else { Some(self.log.append(snapshot.experience)?) };
        let saved =
            ToSave { provenance: &self.provenance, state: snapshot.state, recorder, experience: &experience };
        let (latest, previous) = (latest(&self.folder), previous(&self.folder));
        file::write(&latest, Some(&previous), &saved)?;
        if is_finished && previous.exists() {
            fs::remove_file(&previous).map_err(|error| CheckpointError::io(&previous, error))?;
        }
        let before = std::mem::replace(&mut self.last_mark, experience);
        let needed: Vec<&Mark> = match &self.last_mark {
            Some(last) => before.iter().chain([last]).collect(),
            None => Vec::new(),
        };
        self.log.keep_only(&needed)
    }
}

/// The last usable checkpoint of a run, to look at: nothing is written. The configuration is that of the run, not compared with any other.
///
/// # Errors
/// There is none; the message says why of the last one.
pub fn last_checkpoint(run: &Path) -> anyhow::Result<Saved> {
    let folder = folder_of(run);
    usable(&latest(&folder), run, None)
        .or_else(|error| usable(&previous(&folder), run, None).map_err(|_| error))
        .with_context(|| format!("{} has no checkpoint from which the agents could be taken", run.display()))
}

/// Reads a checkpoint and holds it against what the run is now.
fn usable(path: &Path, run: &Path, provenance: Option<&Provenance>) -> Result<Saved> {
    let saved: Saved = file::read(path)?;
    if let Some(now) = provenance {
        if let Some(difference) = experiment::first_difference(&saved.provenance.config, &now.config) {
            return Err(CheckpointError::Config {
                path: path.to_owned(),
                difference: difference.to_string(),
            });
        }
        let pairs = saved.provenance.plugins.iter().zip(&now.plugins);
        if let Some((was, is)) = pairs.into_iter().find(|(was, is)| was != is) {
            let name = |plugin: &PluginVersion| format!("{} {}", plugin.id, plugin.version);
            return Err(CheckpointError::Plugin { path: path.to_owned(), was: name(was), is: name(is) });
        }
    }
    saved.recorder.check(run)?;
    Ok(saved)
}

/// After the latest checkpoint was passed over, the one before it takes its place.
fn make_latest(folder: &Path, path: &Path) -> Result<()> {
    let latest = latest(folder);
    if path != latest {
        fs::rename(path, &latest).map_err(|error| CheckpointError::io(path, error))?;
        sync_folder(folder)?;
    }
    Ok(())
}

/// Removes what a killed program left half written. The lock must be held.
fn clear(folders: &[&Path]) -> Result<()> {
    folders
        .iter()
        .try_for_each(|folder| remove_leftovers(folder).map_err(|error| CheckpointError::io(folder, error)))
}

/// The system gives the lock back when the process ends, in whatever way.
fn lock(folder: &Path) -> Result<File> {
    let path = folder.join("lock");
    let file = File::create(&path).map_err(|error| CheckpointError::io(&path, error))?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(TryLockError::WouldBlock) => Err(CheckpointError::Busy { path: folder.to_owned() }),
        Err(TryLockError::Error(error)) => Err(CheckpointError::io(&path, error)),
    }
}
