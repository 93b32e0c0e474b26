//! What is said of a shield around somebody's own policy and environment: a RON file without environment and forward agent.

use std::{collections::HashSet, path::Path};

use super::config::DropInConfig;
use super::validate::validate_drop_in;
use super::{ExperimentFile, InputError, Override, Source};

/// A drop-in as it was read: its values, and the way back from each of them to the text.
#[derive(Debug, Clone)]
pub struct DropInFile {
    /// What it says; valid.
    pub config: DropInConfig,
    pub(crate) source: Source,
}

impl DropInFile {
    /// Reads a file, with the overrides in their order.
    ///
    /// # Errors
    /// The first fault, with its place and, where known, the remedy.
    pub fn read(path: impl AsRef<Path>, sets: &[Override]) -> Result<Self, InputError> {
        Self::from_file(&ExperimentFile::read(path)?, sets)
    }

    /// Reads a text that is in memory; messages call it `name`.
    ///
    /// # Errors
    /// As for [`read`](Self::read).
    pub fn from_text(name: &str, text: &str, sets: &[Override]) -> Result<Self, InputError> {
        Self::from_file(&ExperimentFile::from_text(name, text), sets)
    }

    fn from_file(file: &ExperimentFile, sets: &[Override]) -> Result<Self, InputError> {
        let source = Source::new(file, file.tree()?, None, sets.to_vec())?;
        let config: DropInConfig = source.read(validate_drop_in)?;
        let named: HashSet<&str> =
            config.plugins().iter().map(|(_, _, choice)| choice.plugin.as_str()).collect();
        if let Some(id) = config.pins.keys().find(|id| !named.contains(id.as_str())) {
            let message = format!("{id:?} is pinned, but no plugin of that id is used");
            return Err(source.error_at(&format!("pins.{id}"), None, message));
        }
        Ok(Self { config, source })
    }

    /// The RON text at a path such as `shield.rules[0].config.schedule`, the overrides applied; `None` where nothing is written.
    pub fn written_at(&self, path: &str) -> Option<&str> {
        self.source.written_at(path)
    }
}
