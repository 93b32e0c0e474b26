//! The CSV files of a run: a structure per row, which names the columns too.

use std::{
    fs::File,
    io::BufWriter,
    path::{Path, PathBuf},
};

use anyhow::{Context, Result};
use csv::Writer;
use serde::Serialize;

use shield_config::growing_file;
use shield_core::events::{AttemptOutcome, EpisodeEnd};

/// A row of one of the files; the fields are the columns.
pub(super) trait Row: Serialize + Default {
    const FILE: &'static str;
}

/// `metrics.csv`: an episode.
#[derive(Serialize, Default)]
pub(super) struct MetricsRow {
    pub step: u64,
    pub episode: u64,
    pub phase: &'static str,
    pub length: u64,
    pub forward_return: f64,
    pub reset_return: f64,
    pub success: u8,
    pub end: Option<EpisodeEnd>,
    pub has_reset: u8,
    pub hard_reset: u8,
    pub early_aborts: u64,
    pub hard_resets: u64,
    pub irreversible_entries: u64,
    pub forward_steps: u64,
    pub hard_reset_cost: f64,
    pub reset_value: Option<f32>,
    pub lifetime_return: f64,
    pub undo_probability: Option<f32>,
    pub attempt: Option<AttemptOutcome>,
}

/// `interventions.csv`: a rejected action.
#[derive(Serialize, Default)]
pub(super) struct InterventionRow<'a> {
    pub step: u64,
    pub phase: &'static str,
    pub verdict: &'static str,
    pub cause: &'a str,
    pub rule: &'a str,
    pub score: Option<String>,
    pub reason: &'a str,
    pub proposed: String,
    pub executed: Option<String>,
    pub solver_status: &'static str,
    pub iterations: Option<u32>,
    pub distance: Option<String>,
}

/// `evaluations.csv`.
#[derive(Serialize, Default)]
pub(super) struct EvaluationRow {
    pub step: u64,
    pub mean_return: f64,
    pub success_rate: f64,
    pub irreversible_entries: u64,
    pub steps: u64,
    pub lifetime_return: f64,
    pub hard_resets: u64,
    pub mean_return_without_shield: Option<f64>,
    pub success_rate_without_shield: Option<f64>,
    pub irreversible_entries_without_shield: Option<u64>,
    pub steps_without_shield: Option<u64>,
}

/// `learning.csv`: a learner's own figure.
#[derive(Serialize, Default)]
pub(super) struct LearningRow<'a> {
    pub step: u64,
    pub metric: &'a str,
    pub mean: f64,
}

/// `timings.csv`.
#[derive(Serialize, Default)]
pub(super) struct TimingRow {
    pub step: u64,
    pub wall_seconds: f64,
}

impl Row for MetricsRow {
    const FILE: &'static str = "metrics.csv";
}
impl Row for InterventionRow<'_> {
    const FILE: &'static str = "interventions.csv";
}
impl Row for EvaluationRow {
    const FILE: &'static str = "evaluations.csv";
}
impl Row for LearningRow<'_> {
    const FILE: &'static str = "learning.csv";
}
impl Row for TimingRow {
    const FILE: &'static str = "timings.csv";
}

/// A file that grows row by row.
pub(super) struct Table {
    path: PathBuf,
    name: &'static str,
    writer: Writer<BufWriter<File>>,
}

impl Table {
    /// A new file with the heading of `R`.
    pub fn create<R: Row>(folder: &Path) -> Result<Self> {
        let path = folder.join(R::FILE);
        let file =
            growing_file::begin(&path).with_context(|| format!("{} cannot be created", path.display()))?;
        let mut table = Self::over(path, R::FILE, file);
        // The heading stands there even if no row follows: it is that of a row which nobody sees.
        let mut heading = Writer::from_writer(Vec::new());
        heading.serialize(R::default())?;
        let heading = heading.into_inner().map_err(|error| error.into_error())?;
        let columns = csv::Reader::from_reader(heading.as_slice()).headers()?.clone();
        table.writer.write_record(&columns)?;
        Ok(table)
    }

    /// The file of a run that goes on. Nothing changes before [`cut_back`](Self::cut_back).
    pub fn reopen<R: Row>(folder: &Path) -> Result<Self> {
        let path = folder.join(R::FILE);
        let file = growing_file::reopen(&path);
        let file = file.with_context(|| format!("{} cannot be continued", path.display()))?;
        Ok(Self::over(path, R::FILE, file))
    }

    /// Cuts off what follows the first `length` bytes.
    pub fn cut_back(&mut self, length: u64) -> Result<()> {
        growing_file::cut_back(self.writer.get_ref().get_ref(), length).with_context(|| self.cannot_write())
    }

    fn over(path: PathBuf, name: &'static str, file: File) -> Self {
        let writer = csv::WriterBuilder::new().has_headers(false).from_writer(BufWriter::new(file));
        Self { path, name, writer }
    }

    /// The name of the file.
    pub fn name(&self) -> &'static str {
        self.name
    }

    /// Appends a row of the type that the table was made for.
    pub fn write(&mut self, row: &impl Row) -> Result<()> {
        self.writer.serialize(row).with_context(|| self.cannot_write())
    }

    /// Hands finished rows to the system.
    pub fn flush(&mut self) -> Result<()> {
        self.writer.flush().with_context(|| self.cannot_write())
    }

    /// Makes the rows last. Returns the name of the file and its length.
    pub fn sync(&mut self) -> Result<(String, u64)> {
        self.flush()?;
        let file = self.writer.get_ref().get_ref();
        let synced = file.sync_data().and_then(|()| Ok(file.metadata()?.len()));
        Ok((self.name.to_owned(), synced.with_context(|| self.cannot_write())?))
    }

    fn cannot_write(&self) -> String {
        format!("{} cannot be written", self.path.display())
    }
}
