//! The files of a run that grow with it: its tables and its events.

use std::{collections::BTreeMap, path::Path};

use anyhow::Result;

use super::tables::{EvaluationRow, TimingRow};
use crate::checkpoint::CheckpointError;
use shield_config::tensorboard::{self, EventFile};
use shield_decisions::tables::{InterventionRow, LearningRow, MetricsRow, Row, Table};

/// Their names in the folder of the run.
pub(super) const NAMES: [&str; 6] = [
    MetricsRow::FILE,
    InterventionRow::FILE,
    EvaluationRow::FILE,
    LearningRow::FILE,
    TimingRow::FILE,
    tensorboard::FILE,
];

/// The length of each file in bytes, by its name.
pub(super) type Lengths = BTreeMap<String, u64>;

/// Refuses a run whose files do not reach as far as `lengths` says.
pub(super) fn check(run: &Path, lengths: &Lengths) -> Result<(), CheckpointError> {
    for name in NAMES {
        let path = run.join(name);
        let Some(length) = lengths.get(name) else {
            return Err(CheckpointError::Torn { path, what: "the checkpoint has no length for it" });
        };
        let found = path.metadata().map_err(|error| CheckpointError::io(&path, error))?;
        if found.len() < *length {
            return Err(CheckpointError::Torn { path, what: "it ends before the checkpoint" });
        }
    }
    Ok(())
}

/// The files, open for writing.
pub(super) struct Files {
    pub metrics: Table,
    pub interventions: Table,
    pub evaluations: Table,
    pub learning: Table,
    pub timings: Table,
    pub events: EventFile,
}

impl Files {
    /// Those of a run that begins.
    pub fn create(run: &Path) -> Result<Self> {
        Ok(Self {
            metrics: Table::create::<MetricsRow>(run)?,
            interventions: Table::create::<InterventionRow<'_>>(run)?,
            evaluations: Table::create::<EvaluationRow>(run)?,
            learning: Table::create::<LearningRow<'_>>(run)?,
            timings: Table::create::<TimingRow>(run)?,
            events: EventFile::create(run)?,
        })
    }

    /// Those of a run that goes on. Nothing changes before [`cut_back`](Self::cut_back).
    pub fn reopen(run: &Path) -> Result<Self> {
        Ok(Self {
            metrics: Table::reopen::<MetricsRow>(run)?,
            interventions: Table::reopen::<InterventionRow<'_>>(run)?,
            evaluations: Table::reopen::<EvaluationRow>(run)?,
            learning: Table::reopen::<LearningRow<'_>>(run)?,
            timings: Table::reopen::<TimingRow>(run)?,
            events: EventFile::reopen(run)?,
        })
    }

    /// Cuts off what the files have beyond `lengths`, which [`check`] saw.
    pub fn cut_back(&mut self, lengths: &Lengths) -> Result<()> {
        let length = |name: &str| lengths.get(name).copied().unwrap_or(0);
        self.events.cut_back(length(tensorboard::FILE))?;
        self.tables().into_iter().try_for_each(|table| table.cut_back(length(table.name())))
    }

    /// Hands finished rows and events to the system.
    pub fn flush(&mut self) -> Result<()> {
        self.tables().into_iter().try_for_each(Table::flush)?;
        self.events.flush()
    }

    /// Makes everything written so far last.
    pub fn sync(&mut self) -> Result<Lengths> {
        let tables: Result<Vec<_>> = self.tables().into_iter().map(Table::sync).collect();
        Ok(tables?.into_iter().chain([self.events.sync()?]).collect())
    }

    fn tables(&mut self) -> [&mut Table; 5] {
        [
            &mut self.metrics,
            &mut self.interventions,
            &mut self.evaluations,
            &mut self.learning,
            &mut self.timings,
        ]
    }
}
