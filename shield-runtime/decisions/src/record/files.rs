//! The files of a record that grow.

use std::{
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use anyhow::Result;

use super::folder::{RULES, RULES_FORMAT, RecordSettings};
use crate::{
    log::DecisionLog,
    tables::{InterventionRow, LearningRow, MetricsRow, Row, Table},
};
use shield_config::{experiment::DropInFile, state_file};
use shield_core::{
    events::{Counters, DecisionEvent, EpisodeEnd, EpisodeEvent, HardReset, Tally},
    plugin_state::PluginState,
    settings::RecordConfig,
};

/// How long finished rows of the tables may wait in memory.
const FLUSH_EVERY: Duration = Duration::from_secs(1);
/// How long decisions may: a part is closed after so long, or after so many rows.
const PART_EVERY: Duration = Duration::from_secs(60);
const PART_ROWS: u64 = 65_536;

/// A figure that plugins report: its sum and count in the present episode.
struct Figure {
    name: String,
    sum: f64,
    count: u64,
}

/// The files, open for writing.
pub(super) struct Files {
    folder: PathBuf,
    /// The ids of the rules.
    rules: Vec<String>,
    settings: RecordSettings,
    /// What one costs.
    hard_reset_cost: f64,
    /// Decisions so far, and in the present part.
    recorded: u64,
    in_part: u64,
    episodes: u64,
    decisions: DecisionLog,
    interventions: Table,
    metrics: Table,
    learning: Table,
    figures: Vec<Figure>,
    /// The last episode, until it is known whether a hard reset follows.
    last: Option<(EpisodeEvent, Counters)>,
    last_flush: Instant,
    last_part: Instant,
}

impl Files {
    /// The names of the tables.
    pub const TABLES: [&str; 3] = [InterventionRow::FILE, MetricsRow::FILE, LearningRow::FILE];

    /// Those of a record that begins.
    pub fn create(folder: &Path, file: &DropInFile, settings: RecordSettings) -> Result<Self> {
        Ok(Self {
            rules: file.config.rules().map(|choice| choice.plugin.clone()).collect(),
            settings,
            hard_reset_cost: file.config.hard_reset_cost,
            recorded: 0,
            in_part: 0,
            episodes: 0,
            decisions: DecisionLog::new(folder.join("decisions")),
            interventions: Table::create::<InterventionRow<'_>>(folder)?,
            metrics: Table::create::<MetricsRow>(folder)?,
            learning: Table::create::<LearningRow<'_>>(folder)?,
            figures: Vec::new(),
            last: None,
            last_flush: Instant::now(),
            last_part: Instant::now(),
            folder: folder.to_owned(),
        })
    }

    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Takes a decision. Returns why the record must end, if it must.
    pub fn decision(&mut self, event: &DecisionEvent<'_>, reason: &str) -> Result<Option<String>> {
        let RecordSettings { decisions, limit } = self.settings;
        let every = RecordConfig { decisions, states_every: 0 };
        if every.takes(event.step, event.rejection.is_some()) {
            if self.recorded == limit {
                return Ok(Some(format!(
                    "it has {limit} decisions, which is its limit; a higher limit, or only every n-th decision, makes it last longer"
                )));
            }
            self.decisions.push(event)?;
            (self.recorded, self.in_part) = (self.recorded + 1, self.in_part + 1);
        }
        if let Some(intervention) = event.intervention(reason) {
            self.interventions.write(&InterventionRow::of(&intervention, &self.rules))?;
        }
        self.flush_if_due()
    }

    pub fn metric(&mut self, name: &str, mean: f64) {
        match self.figures.iter_mut().find(|figure| figure.name == name) {
            Some(figure) => (figure.sum, figure.count) = (figure.sum + mean, figure.count + 1),
            None => self.figures.push(Figure { name: name.to_owned(), sum: mean, count: 1 }),
        }
    }

    pub fn episode(&mut self, episode: &EpisodeEvent, counters: &Counters) -> Result<Option<String>> {
        self.write_last()?;
        self.last = Some((*episode, *counters));
        for figure in self.figures.iter_mut().filter(|figure| figure.count > 0) {
            let mean = figure.sum / figure.count as f64;
            self.learning.write(&LearningRow::new(counters.steps, &figure.name, mean))?;
            (figure.sum, figure.count) = (0.0, 0);
        }
        self.flush_if_due()
    }

    /// Takes note of a hard reset, which belongs to the episode that ended before it. Where that is written already, or is not known, an
    /// episode without a step stands for it.
    pub fn hard_reset(&mut self, counters: &Counters) -> Result<Option<String>> {
        let last = self.last.take_if(|(_, then)| then.steps == counters.steps);
        self.write_last()?;
        let nothing = || EpisodeEvent::of_forward(&Tally::default(), EpisodeEnd::Interrupted);
        let episode = last.map_or_else(nothing, |(episode, _)| episode);
        let hard_reset = Some(HardReset { kind: None, cost: self.hard_reset_cost });
        self.last = Some((EpisodeEvent { hard_reset, ..episode }, *counters));
        self.write_last()?;
        Ok(None)
    }

    /// The rules go on from these states. A replay begins with them, so nothing may have been recorded before.
    pub fn restored(&mut self, rules: &[PluginState]) -> Result<Option<String>> {
        if self.recorded > 0 || self.episodes > 0 || self.last.is_some() {
            return Ok(Some(
                "the shield goes on from another state, which would not follow from what is recorded; give what follows a folder of its own"
                    .into(),
            ));
        }
        state_file::write(&self.folder.join(RULES), RULES_FORMAT, None, &rules)?;
        Ok(None)
    }

    fn write_last(&mut self) -> Result<()> {
        if let Some((episode, counters)) = self.last.take() {
            self.metrics.write(&MetricsRow::of(self.episodes, &episode, &counters))?;
            self.episodes += 1;
        }
        Ok(())
    }

    fn flush_if_due(&mut self) -> Result<Option<String>> {
        if self.in_part == PART_ROWS || self.last_part.elapsed() >= PART_EVERY {
            return self.flush();
        }
        if self.last_flush.elapsed() >= FLUSH_EVERY {
            self.flush_tables()?;
        }
        Ok(None)
    }

    fn flush_tables(&mut self) -> Result<()> {
        self.last_flush = Instant::now();
        [&mut self.interventions, &mut self.metrics, &mut self.learning]
            .into_iter()
            .try_for_each(Table::flush)
    }

    /// Writes everything, so that it can be read. The decisions come last: what belongs to them is there before.
    pub fn flush(&mut self) -> Result<Option<String>> {
        self.write_last()?;
        self.flush_tables()?;
        (self.in_part, self.last_part) = (0, Instant::now());
        self.decisions.begin_part()?;
        Ok(None)
    }

    /// Writes everything for the last time. Where that fails, each file ends with what was written whole.
    pub fn end(mut self) -> Result<()> {
        match self.flush() {
            Ok(_) => Ok(()),
            Err(error) => Err(match self.abandon() {
                Ok(()) => error,
                Err(further) => error.context(format!("{further:#}")),
            }),
        }
    }

    /// After a failure: each file ends with what was written whole.
    pub fn abandon(mut self) -> Result<()> {
        let closed = self.decisions.begin_part().map(drop);
        let tables = [self.interventions, self.metrics, self.learning];
        let cut: Vec<_> = tables.into_iter().map(Table::abandon).collect();
        cut.into_iter().collect::<Result<()>>().and(closed)
    }
}
