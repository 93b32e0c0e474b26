//! What is said of a shield around somebody's own policy and environment: a RON file without environment and forward agent.

use std::path::Path;

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
        let source = Source::new(file, None, sets.to_vec())?;
        let config: DropInConfig = source.read(validate_drop_in)?;
        let named = config.plugins();
        let unused = config.pins.keys().find(|id| !named.iter().any(|(_, _, choice)| choice.plugin == **id));
        if let Some(id) = unused {
            let message = format!("{id:?} is pinned, but no plugin of that id is used");
            return Err(source.error_at(&format!("pins.{id}"), None, message));
        }
        Ok(Self { config, source })
    }
}
