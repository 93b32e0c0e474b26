//! The folder of a record.

use std::{
    fs,
    io::{self, Write as _},
    path::Path,
};

use anyhow::{Context, Result, bail};
use serde::{Deserialize, Serialize};
use shield_api::{Spaces, regular_file};

use super::files::Files;
use crate::provenance::{fields_of, manifests, plugins_json};
use shield_config::{
    atomic_file::{AtomicFile, write_atomically},
    experiment::DropInFile,
    state_file,
};
use shield_core::plugin_state::PluginState;
use shield_host::plugin::Registry;

/// Tells the folder of a record from that of a run.
const SETTINGS: &str = "recording.json";
const CONFIG: &str = "config.ron";
const PLUGINS: &str = "plugins.json";
/// The states of the rules, where the shield had learned before.
pub(super) const RULES: &str = "rules.bin";
/// Their format.
pub(super) const RULES_FORMAT: u32 = 1;

/// How much of a drop-in's decisions is recorded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecordSettings {
    /// The decisions of every n-th step, and every rejection.
    pub decisions: u64,
    /// Decisions after which the record ends.
    pub limit: u64,
}

impl Default for RecordSettings {
    /// Every decision, and at most a million: some hundred megabytes.
    fn default() -> Self {
        Self { decisions: 1, limit: 1_000_000 }
    }
}

impl RecordSettings {
    /// Those of the record in a folder.
    ///
    /// # Errors
    /// There is none, or its file is damaged.
    pub fn read(folder: &Path) -> Result<Self> {
        let path = folder.join(SETTINGS);
        let text = regular_file::read_to_string(&path);
        let text = text.with_context(|| format!("{} cannot be read", path.display()))?;
        serde_json::from_str(&text).with_context(|| format!("{} is damaged", path.display()))
    }
}

/// Whether a folder holds the record of a drop-in.
pub fn is_record(folder: &Path) -> bool {
    folder.join(SETTINGS).is_file()
}

/// The states that the rules had at the beginning of the record in a folder; `None` where they began anew.
///
/// # Errors
/// The file is damaged.
pub fn kept_rules(folder: &Path) -> Result<Option<Vec<PluginState>>> {
    let path = folder.join(RULES);
    if !path.exists() {
        return Ok(None);
    }
    Ok(Some(state_file::read(&path, RULES_FORMAT)?))
}

/// Makes the folder and what does not grow in it. If something cannot be written, nothing is left of it.
pub(super) fn create(
    folder: &Path,
    file: &DropInFile,
    registry: &Registry,
    spaces: &Spaces,
    settings: RecordSettings,
) -> Result<Files> {
    let plugins = file.config.plugins();
    let manifests = manifests(registry, &plugins)?;
    let config = file.resolved_ron(spaces, &|id| fields_of(&manifests, id));
    let plugins = plugins_json(registry, &plugins)?;
    let is_new = ensure_empty(folder)?;
    // Of several processes, one succeeds.
    write_first(&folder.join(CONFIG), config.as_bytes())?;
    let write = |name: &str, bytes: &[u8]| {
        let path = folder.join(name);
        write_atomically(&path, bytes).with_context(|| format!("{} cannot be written", path.display()))
    };
    let created = write(PLUGINS, plugins.as_bytes())
        .and_then(|()| write(SETTINGS, &serde_json::to_vec_pretty(&settings)?))
        .and_then(|()| Files::create(folder, file, settings));
    created.map_err(|error| match discard(folder, is_new) {
        Ok(()) => error,
        Err(kept) => error.context(format!("{} cannot be emptied: {kept}", folder.display())),
    })
}

/// Makes the folder, or refuses one that holds something. Returns whether it is new.
fn ensure_empty(folder: &Path) -> Result<bool> {
    let complaint = || format!("{} cannot be used for a record", folder.display());
    if is_record(folder) {
        bail!(
            "{} already holds the record of a shield; each shield needs a folder of its own, also one that goes on from a saved state: give a \
             new folder, or move this one aside",
            folder.display()
        );
    }
    match fs::read_dir(folder) {
        Ok(mut entries) => {
            if entries.next().is_some() {
                bail!(
                    "{} is not empty, and what it holds is no record: give a new or an empty folder",
                    folder.display()
                );
            }
            Ok(false)
        }
        Err(error) if error.kind() == io::ErrorKind::NotFound => {
            fs::create_dir_all(folder).with_context(complaint)?;
            Ok(true)
        }
        Err(error) => Err(error).with_context(complaint),
    }
}

fn write_first(path: &Path, bytes: &[u8]) -> Result<()> {
    let write = || {
        let mut file = AtomicFile::create(path)?;
        file.write_all(bytes)?;
        file.commit_new()
    };
    write().with_context(|| format!("{} cannot be written", path.display()))
}

/// Removes what [`create`] wrote: the folder was empty before.
fn discard(folder: &Path, is_new: bool) -> io::Result<()> {
    for name in [CONFIG, PLUGINS, SETTINGS].into_iter().chain(Files::TABLES) {
        match fs::remove_file(folder.join(name)) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
    }
    if is_new { fs::remove_dir(folder) } else { Ok(()) }
}
