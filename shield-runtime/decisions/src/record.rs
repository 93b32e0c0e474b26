//! The record of a drop-in: what it decides, in a folder that `shield explain` and `shield what-if` read like that of a run.

mod files;
mod folder;

pub use folder::{RecordSettings, is_record, kept_rules};

use std::{
    path::Path,
    process,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use anyhow::{Result, bail};

use self::{files::Files, folder::create};
use shield_config::experiment::DropInFile;
use shield_core::{
    drop_in::{DropIn, DropInObserver},
    events::{Counters, DecisionEvent, EpisodeEvent},
    plugin_state::PluginState,
};
use shield_host::plugin::Registry;

/// The record of one drop-in, while it is written. It ends with the drop-in, at its limit, or when something cannot be written; the drop-in
/// goes on all the same.
///
/// Rows wait in memory, decisions for a minute at most. They are written by [`flush`](Self::flush) and when record and drop-in are dropped.
pub struct Record(Arc<Mutex<Writing>>);

impl Record {
    /// Begins the record of `drop_in`, which `file` describes, in a `folder` that is new or empty.
    ///
    /// # Errors
    /// The folder holds something or cannot be written, or a plugin is missing.
    pub fn begin(
        drop_in: &mut DropIn,
        file: &DropInFile,
        registry: &Registry,
        folder: &Path,
        settings: RecordSettings,
    ) -> Result<Self> {
        if settings.decisions == 0 || settings.limit == 0 {
            bail!("a record needs at least one decision: neither every 0th nor at most 0 can be recorded");
        }
        let folder = std::path::absolute(folder)?;
        let files = create(&folder, file, registry, drop_in.spaces(), settings)?;
        let writing = Writing { files: Some(files), trouble: None, process: process::id() };
        let record = Self(Arc::new(Mutex::new(writing)));
        drop_in.report_to(Box::new(Reporter(Arc::clone(&record.0))));
        Ok(record)
    }

    /// Writes what waits in memory. Where that fails, the record ends, and says so as its [trouble](Self::take_trouble).
    pub fn flush(&self) {
        lock(&self.0).go_on(Files::flush);
    }

    /// Whether [`take_trouble`](Self::take_trouble) has something to tell.
    pub fn has_trouble(&self) -> bool {
        lock(&self.0).trouble.is_some()
    }

    /// Why the record has ended, for a person, if it has and this was not told yet.
    pub fn take_trouble(&self) -> Option<String> {
        lock(&self.0).trouble.take()
    }
}

/// What is being written, and why no more is.
struct Writing {
    /// `None` once it has ended.
    files: Option<Files>,
    trouble: Option<String>,
    /// Where it was begun: a forked process must not write what waits in both.
    process: u32,
}

impl Writing {
    /// Writes, unless the record has ended. It ends where that fails, and where `write` returns why it must.
    fn go_on(&mut self, write: impl FnOnce(&mut Files) -> Result<Option<String>>) {
        let Some(files) = self.files.as_mut().filter(|_| self.process == process::id()) else { return };
        let written = write(files);
        if let Ok(None) = written {
            return;
        }
        let Some(files) = self.files.take() else { return };
        let folder = files.folder().display().to_string();
        let (why, ended) = match written {
            Ok(why) => (why.unwrap_or_default(), files.end()),
            Err(error) => (format!("{error:#}"), files.abandon()),
        };
        let left = ended.err().map_or(String::new(), |error| format!("; moreover, {error:#}"));
        self.trouble = Some(format!(
            "the record in {folder} ends here: {why}{left}. The shield decides as before; what was recorded until now can be read"
        ));
    }
}

impl Drop for Writing {
    fn drop(&mut self) {
        let Some(files) = self.files.take() else { return };
        if self.process != process::id() {
            // The files are those of the other process.
            std::mem::forget(files);
            return;
        }
        let folder = files.folder().display().to_string();
        if let Err(error) = files.end() {
            log::warn!("the end of the record in {folder} is missing: {error:#}");
        }
    }
}

fn lock(writing: &Mutex<Writing>) -> MutexGuard<'_, Writing> {
    writing.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Hears of the drop-in.
struct Reporter(Arc<Mutex<Writing>>);

impl DropInObserver for Reporter {
    fn on_decision(&mut self, decision: &DecisionEvent<'_>, reason: &str) {
        lock(&self.0).go_on(|files| files.decision(decision, reason));
    }

    fn on_metric(&mut self, name: &str, mean: f64) {
        lock(&self.0).go_on(|files| {
            files.metric(name, mean);
            Ok(None)
        });
    }

    fn on_episode(&mut self, episode: &EpisodeEvent, counters: &Counters) {
        lock(&self.0).go_on(|files| files.episode(episode, counters));
    }

    fn on_hard_reset(&mut self, counters: &Counters) {
        lock(&self.0).go_on(|files| files.hard_reset(counters));
    }

    fn on_restored(&mut self, _: &Counters, rules: &[PluginState]) {
        lock(&self.0).go_on(|files| files.restored(rules));
    }
}
