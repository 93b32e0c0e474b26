//! The folder `checkpoint` of a run.

use std::{
    fs::{self, File},
    io,
    path::{Path, PathBuf},
};

use anyhow::Context;
use serde::{Deserialize, Serialize, de::DeserializeOwned};

use super::{
    experience_log::{ExperienceLog, Mark},
    lock::lock,
};
use crate::{
    loop_state::LoopState,
    observer::{Occasion, Snapshot},
};
use shield_config::{
    atomic_file::remove_leftovers,
    experiment,
    state_file::{self, CheckpointError, RUN, Result, sync_folder},
};
use shield_core::experience::Experience;

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

/// Where the other files of a run ended when a checkpoint was written. The checkpoint carries it and does not look into it.
pub trait RunFiles: Serialize + DeserializeOwned {
    /// Whether the files reach as far as they did.
    ///
    /// # Errors
    /// One is missing or too short.
    fn check(&self, run: &Path) -> Result<()>;
}

/// A checkpoint. `R` says where the other files of the run ended.
#[derive(Serialize, Deserialize)]
pub struct Saved<R> {
    /// What the run was made of.
    pub provenance: Provenance,
    /// The loop and everyone in it.
    pub state: LoopState,
    /// Where the files of the run ended.
    pub recorder: R,
    /// Where the experience ended; `None` once the run is finished, since nobody learns any more.
    experience: Option<Mark>,
}

#[derive(Serialize)]
struct ToSave<'a, R> {
    provenance: &'a Provenance,
    state: &'a LoopState,
    recorder: &'a R,
    experience: &'a Option<Mark>,
}

/// Writes the checkpoints of one run. While it exists, no other process can.
#[derive(Debug)]
pub struct CheckpointStore {
    folder: PathBuf,
    provenance: Provenance,
    log: ExperienceLog,
    last_mark: Option<Mark>,
    has_checkpoint: bool,
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
        let log = ExperienceLog::new(&folder);
        Ok(Self { folder, provenance, log, last_mark: None, has_checkpoint: false, _lock: lock })
    }

    /// Whether a checkpoint was written, or is gone on from.
    pub fn has_checkpoint(&self) -> bool {
        self.has_checkpoint
    }

    /// Cuts back the experience that was written after the checkpoint from which the run goes on, and removes what a killed program left half
    /// written.
    ///
    /// # Errors
    /// A file cannot be cut back or removed.
    pub fn cut_back(&mut self, row_bytes: usize) -> Result<()> {
        self.log.cut_back(row_bytes)?;
        self.folder.parent().map_or(Ok(()), |run| clear(&[run, &self.folder]))
    }

    /// Gives a refused checkpoint a name that no file has, and returns it: it may be good with another version of the plugin. The checkpoint
    /// before then counts as the latest.
    ///
    /// # Errors
    /// It cannot be renamed.
    pub fn set_aside(&self, refused: &Path) -> Result<PathBuf> {
        let mut number = 1;
        let aside = loop {
            let path = self.folder.join(format!("refused-{number}.bin"));
            match path.symlink_metadata() {
                Err(error) if error.kind() == io::ErrorKind::NotFound => break path,
                found => found.map_err(|error| CheckpointError::io(&path, error))?,
            };
            number += 1;
        };
        fs::rename(refused, &aside).map_err(|error| CheckpointError::io(refused, error))?;
        sync_folder(&self.folder)?;
        Ok(aside)
    }

    /// Writes a checkpoint; the one before it is kept until the run is finished.
    ///
    /// # Errors
    /// A file cannot be written. The checkpoints before are as they were.
    pub fn write(&mut self, snapshot: &Snapshot<'_>, recorder: &impl RunFiles) -> Result<()> {
        let is_finished = snapshot.occasion == Occasion::Finished;
        let experience = if is_finished { None } else { Some(self.log.append(snapshot.experience)?) };
        let saved =
            ToSave { provenance: &self.provenance, state: snapshot.state, recorder, experience: &experience };
        let (latest, previous) = (latest(&self.folder), previous(&self.folder));
        state_file::write(&latest, RUN, Some(&previous), &saved)?;
        self.has_checkpoint = true;
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

/// The checkpoints of a run, while no other process can write it. Looking at them changes nothing.
#[derive(Debug)]
pub struct LockedCheckpoints {
    run: PathBuf,
    folder: PathBuf,
    lock: File,
}

impl LockedCheckpoints {
    /// Takes the lock of a run; `None` if it has no folder of checkpoints.
    ///
    /// # Errors
    /// Another process writes the run, or the lock cannot be taken.
    pub fn of(run: &Path) -> Result<Option<Self>> {
        let folder = folder_of(run);
        if !is_there(&folder)? {
            return Ok(None);
        }
        let lock = lock(&folder)?;
        Ok(Some(Self { run: run.to_owned(), folder, lock }))
    }

    /// The checkpoints that are there, the latest first.
    ///
    /// # Errors
    /// The folder cannot be read.
    pub fn paths(&self) -> Result<Vec<PathBuf>> {
        paths(&self.folder)
    }

    /// Reads a checkpoint and holds it against what the run is now.
    ///
    /// # Errors
    /// It is damaged or cannot be read, belongs to another configuration or other plugins, or a file of the run is not as long as it was.
    pub fn read<R: RunFiles>(&self, path: &Path, provenance: &Provenance) -> Result<Saved<R>> {
        let saved: Saved<R> = state_file::read(path, RUN)?;
        saved.ensure_same(path, provenance)?;
        saved.recorder.check(&self.run)?;
        Ok(saved)
    }

    /// Fills an empty `experience` up to a checkpoint.
    ///
    /// # Errors
    /// It is damaged, or a file of it is missing or cannot be read.
    pub fn fill<R>(&self, saved: &Saved<R>, experience: &mut Experience) -> Result<()> {
        let mark = saved.experience.as_ref();
        mark.map_or(Ok(()), |mark| ExperienceLog::read(&self.folder, mark, experience))
    }

    /// Opens what is needed to go on from a checkpoint. Nothing changes before [`CheckpointStore::cut_back`].
    ///
    /// # Errors
    /// A file cannot be opened.
    pub fn go_on<R>(self, saved: &Saved<R>, provenance: Provenance) -> Result<CheckpointStore> {
        let Self { folder, lock, .. } = self;
        let last_mark = saved.experience.clone();
        let log = match &last_mark {
            Some(mark) => ExperienceLog::reopen(&folder, mark)?,
            None => ExperienceLog::new(&folder),
        };
        Ok(CheckpointStore { folder, provenance, log, last_mark, has_checkpoint: true, _lock: lock })
    }
}

/// The last usable checkpoint of a run, to look at: nothing is written. The configuration is that of the run, not compared with any other.
///
/// # Errors
/// There is none, and the message says why the latest one is not; or a file is missing or cannot be read.
pub fn last_checkpoint<R: RunFiles>(run: &Path) -> anyhow::Result<Saved<R>> {
    first_usable(&folder_of(run))
        .with_context(|| format!("{} has no checkpoint from which the agents could be taken", run.display()))
}

fn first_usable<R: RunFiles>(folder: &Path) -> Result<Saved<R>> {
    let mut passed_over = None;
    for path in paths(folder)? {
        match state_file::read(&path, RUN) {
            Err(error) if error.is_damage() => passed_over = passed_over.or(Some(error)),
            found => return found,
        }
    }
    let missing = || CheckpointError::io(&latest(folder), io::ErrorKind::NotFound.into());
    Err(passed_over.unwrap_or_else(missing))
}

/// The checkpoints in a folder, the latest first. The last one may be missing: the program may have been killed between two renames.
fn paths(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut paths = Vec::new();
    for path in [latest(folder), previous(folder)] {
        if is_there(&path)? {
            paths.push(path);
        }
    }
    Ok(paths)
}

fn is_there(path: &Path) -> Result<bool> {
    path.try_exists().map_err(|error| CheckpointError::io(path, error))
}

impl<R> Saved<R> {
    /// Refuses another configuration and other plugins.
    fn ensure_same(&self, path: &Path, now: &Provenance) -> Result<()> {
        let saved = &self.provenance;
        if let Some(difference) = experiment::first_difference(&saved.config, &now.config) {
            let difference = difference.to_string();
            return Err(CheckpointError::Config { path: path.to_owned(), difference });
        }
        let pairs = saved.plugins.iter().zip(&now.plugins);
        if let Some((was, is)) = pairs.into_iter().find(|(was, is)| was != is) {
            let name = |plugin: &PluginVersion| format!("{} {}", plugin.id, plugin.version);
            return Err(CheckpointError::Plugin { path: path.to_owned(), was: name(was), is: name(is) });
        }
        Ok(())
    }
}

/// Removes what a killed program left half written. The lock must be held.
fn clear(folders: &[&Path]) -> Result<()> {
    folders
        .iter()
        .try_for_each(|folder| remove_leftovers(folder).map_err(|error| CheckpointError::io(folder, error)))
}
