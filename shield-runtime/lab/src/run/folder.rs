//! The folder of one run.

use std::{
    fs,
    io::{self, Write as _},
    path::{Path, PathBuf},
};

use anyhow::{Context, Result, bail, ensure};
use shield_api::regular_file;

use super::{
    new_folder::NewFolder,
    summary::{Identity, Summary},
};
use shield_config::atomic_file::{AtomicFile, write_atomically};
use shield_decisions::record::is_record;

/// The folder of one run, `<out>/<experiment>/<variant>/seed-<n>`.
#[derive(Debug, Clone)]
pub struct RunFolder {
    path: PathBuf,
}

impl RunFolder {
    /// Where the run belongs; creates nothing.
    pub fn new(out: &Path, identity: &Identity) -> Self {
        let path =
            out.join(&identity.experiment).join(&identity.variant).join(format!("seed-{}", identity.seed));
        Self { path }
    }

    /// The folder of a run that exists.
    pub fn at(path: impl Into<PathBuf>) -> Self {
        Self { path: path.into() }
    }

    /// Every run in a folder of runs, or the one that the folder is, ordered by path.
    ///
    /// # Errors
    /// A folder cannot be read.
    pub fn find(root: &Path) -> Result<Vec<Self>> {
        if root.join("config.ron").is_file() {
            return Ok(vec![Self::at(root)]);
        }
        let entries = fs::read_dir(root).with_context(|| format!("{} cannot be read", root.display()))?;
        let mut folders = Vec::new();
        for entry in entries {
            let path = entry?.path();
            // A link is not followed: it could lead around in a circle.
            if path.is_dir() && !path.is_symlink() {
                folders.push(path);
            }
        }
        folders.sort();
        let found: Result<Vec<Vec<Self>>> = folders.iter().map(|folder| Self::find(folder)).collect();
        Ok(found?.concat())
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Creates the folder with its `config.ron` and `plugins.json`. What stood there before is removed first if `overwrite` says so. Without it, the
    /// folder may be there, but only if no run was begun in it.
    ///
    /// # Errors
    /// Something is there and must not be overwritten, or the folder cannot be written.
    pub fn create(&self, config: &str, plugins: &str, overwrite: bool) -> Result<NewFolder> {
        let path = &self.path;
        if self.is_begun()? {
            if !overwrite {
                bail!("{} exists already", path.display());
            }
            fs::remove_dir_all(path).with_context(|| format!("{} cannot be removed", path.display()))?;
        }
        let is_own = path
            .parent()
            .map_or(Ok(()), fs::create_dir_all)
            .and_then(|()| create_folder(path))
            .with_context(|| format!("{} cannot be created", path.display()))?;
        if let Err(error) = write_first(&path.join("config.ron"), config.as_bytes()) {
            // Another process may have begun meanwhile: then the folder is not empty, and stays.
            if is_own && let Err(kept) = fs::remove_dir(path) {
                log::warn!("{} stays: {kept}", path.display());
            }
            return Err(error);
        }
        let new = NewFolder::new(path, is_own);
        match write_whole(&path.join("plugins.json"), plugins.as_bytes()) {
            Ok(()) => Ok(new),
            Err(error) => Err(new.discard_after(error)),
        }
    }

    /// Whether something of a run is there, or anything else. A program that was killed at once leaves a folder with nothing, or with a file
    /// that was not finished.
    ///
    /// # Errors
    /// The folder cannot be read.
    pub fn is_begun(&self) -> Result<bool> {
        let cannot_be_read = || format!("{} cannot be read", self.path.display());
        let entries = match fs::read_dir(&self.path) {
            // Whoever creates the folder hears of a file in its place.
            Err(error) if matches!(error.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory) => {
                return Ok(false);
            }
            entries => entries.with_context(cannot_be_read)?,
        };
        for entry in entries {
            let path = entry.with_context(cannot_be_read)?.path();
            if path.extension().is_none_or(|extension| extension != "partial") {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Whether the folder has the configuration of a run.
    ///
    /// # Errors
    /// It cannot be told.
    pub(super) fn has_config(&self) -> Result<bool> {
        let path = self.path.join("config.ron");
        path.try_exists().with_context(|| format!("{} cannot be read", path.display()))
    }

    /// The resolved configuration that the run was started with.
    ///
    /// # Errors
    /// There is none: the folder is not that of a run.
    pub fn config(&self) -> Result<String> {
        self.refuse_record()?;
        let path = self.path.join("config.ron");
        regular_file::read_to_string(&path).with_context(|| format!("{} cannot be read", path.display()))
    }

    fn refuse_record(&self) -> Result<()> {
        ensure!(
            !is_record(&self.path),
            "{} is the record of a shield in another program's loop, not a run; `shield explain` and `shield what-if` read it",
            self.path.display()
        );
        Ok(())
    }

    /// The summary; `None` before the run's first end.
    ///
    /// # Errors
    /// It cannot be read or is not a summary.
    pub fn summary(&self) -> Result<Option<Summary>> {
        self.refuse_record()?;
        let path = self.path.join("summary.json");
        let bytes = match regular_file::read(&path) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
            bytes => bytes.with_context(|| format!("{} cannot be read", path.display()))?,
        };
        let summary = serde_json::from_slice(&bytes);
        let complaint =
            || format!("{} is not the summary of a run; move it aside, and the run goes on", path.display());
        summary.map(Some).with_context(complaint)
    }
}

/// Creates a folder; `false` if it was there.
fn create_folder(path: &Path) -> io::Result<bool> {
    match fs::create_dir(path) {
        Err(error) if error.kind() == io::ErrorKind::AlreadyExists && path.is_dir() => Ok(false),
        created => created.map(|()| true),
    }
}

/// Writes a file that nobody else may have written: of several processes, one succeeds.
fn write_first(path: &Path, bytes: &[u8]) -> Result<()> {
    let write = || {
        let mut file = AtomicFile::create(path)?;
        file.write_all(bytes)?;
        file.commit_new()
    };
    write().with_context(|| format!("{} cannot be written", path.display()))
}

/// Writes a file so that it is there whole or not at all, and makes its folder if need be.
///
/// # Errors
/// It cannot be written.
pub fn write_in_folder(path: &Path, bytes: &[u8]) -> Result<()> {
    path.parent()
        .map_or(Ok(()), fs::create_dir_all)
        .with_context(|| format!("{} cannot be written", path.display()))?;
    write_whole(path, bytes)
}

/// Writes a file so that it is there whole or not at all.
pub(super) fn write_whole(path: &Path, bytes: &[u8]) -> Result<()> {
    write_atomically(path, bytes).with_context(|| format!("{} cannot be written", path.display()))
}
