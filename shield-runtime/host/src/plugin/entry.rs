//! What is said of a plugin before it is loaded: which one is meant, what was found, and which one it was.

use std::path::{Path, PathBuf};

use serde::Serialize;
use shield_api::manifest::Manifest;

use super::{Kind, PluginError, manifest::kind_of};

/// A plugin that was found. Nothing of its file has been executed yet.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Entry {
    /// Which kind it is.
    pub kind: Kind,
    /// What it says of itself.
    pub manifest: Manifest,
    /// Its file, as a canonical path.
    pub path: PathBuf,
}

impl Entry {
    pub(super) fn new(path: &Path, manifest: Manifest) -> Result<Self, PluginError> {
        Ok(Self { kind: kind_of(path, &manifest)?, manifest, path: path.into() })
    }
}

/// A file or folder that was passed over.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Skipped {
    /// The file.
    pub path: PathBuf,
    /// The ids in it, where the manifest can be read at all.
    pub ids: Vec<String>,
    /// Why.
    pub reason: PluginError,
}

/// Which plugin an experiment names.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Selection {
    /// Its id.
    pub id: String,
    /// The file to load it from, instead of the search path.
    pub path: Option<PathBuf>,
    /// The SHA-256 that the file must have, as [`fingerprint`] writes it; checked before anything of the file is executed.
    pub sha256: Option<String>,
}

impl Selection {
    /// The plugin of that id, wherever the search path has it.
    pub fn new(id: impl Into<String>) -> Self {
        Self { id: id.into(), path: None, sha256: None }
    }

    /// The plugin of that id in the given file.
    #[must_use]
    pub fn at(mut self, path: impl Into<PathBuf>) -> Self {
        self.path = Some(path.into());
        self
    }
}

/// Which plugin it was, exactly: what a run's folder says of each that it used.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Identity {
    /// Its id.
    pub id: String,
    /// Which kind it is.
    pub kind: &'static str,
    /// Its version.
    pub version: String,
    /// Version of the interface that it was built with.
    pub interface: String,
    /// `rust` or `c`.
    pub language: String,
    /// SHA-256 of its file.
    pub sha256: String,
}
