//! The folder of one run.

use std::{
    fs,
    path::{Path, PathBuf},
};

use anyhow::{Context, Result, bail};
use shield_api::regular_file;

use super::summary::{Identity, Summary};

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

    /// Whether something is already there.
    pub fn exists(&self) -> bool {
        self.path.exists()
    }

    /// Creates the folder with its `config.ron` and `plugins.json`. What stood there before is removed first if `overwrite` says so.
    ///
    /// # Errors
    /// The folder exists and must not be overwritten, or cannot be written.
    pub fn create(&self, config: &str, plugins: &str, overwrite: bool) -> Result<()> {
        let path = &self.path;
        if self.exists() {
            if !overwrite {
                bail!("{} exists already", path.display());
            }
            fs::remove_dir_all(path).with_context(|| format!("{} cannot be removed", path.display()))?;
        }
        // The folder itself must be new: another process may have made it meanwhile.
        path.parent()
            .map_or(Ok(()), fs::create_dir_all)
            .and_then(|()| fs::create_dir(path))
            .with_context(|| format!("{} cannot be created", path.display()))?;
        let written = write_whole(&path.join("config.ron"), config.as_bytes())
            .and_then(|()| write_whole(&path.join("plugins.json"), plugins.as_bytes()));
        if written.is_err() {
            self.discard();
        }
        written
    }

    /// Whether something of a run is there. A program that was killed at once leaves a folder with nothing or with a file that was not finished.
    ///
    /// # Errors
    /// The folder cannot be read.
    pub(super) fn is_begun(&self) -> Result<bool> {
        let entries =
            fs::read_dir(&self.path).with_context(|| format!("{} cannot be read", self.path.display()))?;
        for entry in entries {
            if entry?.path().extension().is_none_or(|extension| extension != "partial") {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// The resolved configuration that the run was started with.
    ///
    /// # Errors
    /// There is none: the folder is not that of a run.
    pub fn config(&self) -> Result<String> {
        let path = self.path.join("config.ron");
        regular_file::read_to_string(&path).with_context(|| format!("{} cannot be read", path.display()))
    }

    /// The summary; `None` before the run's first end.
    ///
    /// # Errors
    /// It cannot be read or is not a summary.
    pub fn summary(&self) -> Result<Option<Summary>> {
        let path = self.path.join("summary.json");
        if !path.exists() {
            return Ok(None);
        }
        let bytes =
            regular_file::read(&path).with_context(|| format!("{} cannot be read", path.display()))?;
        let summary = serde_json::from_slice(&bytes);
        summary.map(Some).with_context(|| format!("{} is not the summary of a run", path.display()))
    }

    /// Removes the folder of a run that could not start.
    pub fn discard(&self) {
        fs::remove_dir_all(&self.path).ok();
    }
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
    let aside = path.with_extension("partial");
    fs::write(&aside, bytes)
        .and_then(|()| fs::rename(&aside, path))
        .with_context(|| format!("{} cannot be written", path.display()))
}
