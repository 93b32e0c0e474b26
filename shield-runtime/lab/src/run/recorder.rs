//! Writes a run's folder while the run goes on.

mod observing;

use std::{
    collections::BTreeMap,
    path::Path,
    time::{Duration, Instant},
};

use anyhow::Result;
use hdrhistogram::Histogram;
use serde::{Deserialize, Serialize};
use shield_api::ResetKind;

use super::{
    accepted_risk::AcceptedRisk,
    attempt_log::AttemptLog,
    files::{self, Files, Lengths},
    folder::{RunFolder, write_whole},
    summary::{Evaluations, FoundInRun, Identity, Summary},
};
use crate::{
    checkpoint::{CheckpointError, CheckpointStore, RunFiles},
    observer::Occasion,
};
use shield_core::events::Counters;
use shield_decisions::{DecisionLog, DecisionState, check};

/// How long finished rows may wait in memory.
const FLUSH_EVERY: Duration = Duration::from_secs(1);

/// What a recorder carries through a checkpoint.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct RecorderState {
    /// Length of each file in bytes.
    lengths: Lengths,
    episodes: u64,
    results: Evaluations,
    causes: BTreeMap<String, u64>,
    hard_resets: Vec<(String, u64)>,
    decisions: DecisionState,
    /// Nanoseconds, and how many decisions took so long.
    decision_times: Vec<(u64, u32)>,
    seconds: f64,
}

impl RunFiles for RecorderState {
    fn check(&self, run: &Path) -> Result<(), CheckpointError> {
        files::check(run, &self.lengths)?;
        check(&run.join(DECISIONS), self.decisions)
    }
}

/// The folder of the recorded decisions.
const DECISIONS: &str = "decisions";

/// Takes the loop's reports and writes them: `metrics.csv`, `interventions.csv`, `evaluations.csv`, `learning.csv`, `timings.csv`, the
/// checkpoints, and in the end `summary.json`.
pub struct Recorder {
    folder: RunFolder,
    identity: Identity,
    rules: Vec<String>,
    files: Files,
    episodes: u64,
    results: Evaluations,
    solved_at: f64,
    deterministic: bool,
    decisions: DecisionLog,
    causes: BTreeMap<String, u64>,
    attempts: AttemptLog,
    /// How many of each of the environment's kinds of hard resets.
    hard_resets: Vec<(String, u64)>,
    decision_ns: Histogram<u32>,
    /// Wall-clock time before the run was last continued.
    seconds_before: f64,
    start: Instant,
    last_flush: Instant,
    checkpoints: Option<CheckpointStore>,
    /// Whether everything was in the last checkpoint.
    is_saved_exactly: bool,
    findings: Vec<FoundInRun>,
}

impl Recorder {
    /// Begins the tables of a folder that [`RunFolder::create`] made. `rules` are the ids of the shield's rules.
    ///
    /// # Errors
    /// A file cannot be created.
    pub fn new(folder: RunFolder, identity: Identity, rules: Vec<String>, solved_at: f64) -> Result<Self> {
        let files = Files::create(folder.path())?;
        Self::over(files, folder, identity, rules, solved_at, RecorderState::default())
    }

    /// Opens the tables of a run that goes on. Nothing changes before [`cut_back`](Self::cut_back).
    ///
    /// # Errors
    /// A file is missing or cannot be written.
    pub fn reopen(
        folder: RunFolder,
        identity: Identity,
        rules: Vec<String>,
        solved_at: f64,
        state: RecorderState,
    ) -> Result<Self> {
        let files = Files::reopen(folder.path())?;
        Self::over(files, folder, identity, rules, solved_at, state)
    }

    fn over(
        files: Files,
        folder: RunFolder,
        identity: Identity,
        rules: Vec<String>,
        solved_at: f64,
        state: RecorderState,
    ) -> Result<Self> {
        // Up to a minute at three digits; longer decisions count as a minute.
        let mut decision_ns = Histogram::new_with_bounds(1, 60_000_000_000, 3)?;
        for (nanoseconds, count) in state.decision_times {
            decision_ns.saturating_record_n(nanoseconds, count);
        }
        Ok(Self {
            files,
            decisions: DecisionLog::new(folder.path().join(DECISIONS)),
            folder,
            identity,
            rules,
            episodes: state.episodes,
            results: state.results,
            solved_at,
            deterministic: true,
            causes: state.causes,
            attempts: AttemptLog::default(),
            hard_resets: state.hard_resets,
            decision_ns,
            seconds_before: state.seconds,
            start: Instant::now(),
            last_flush: Instant::now(),
            checkpoints: None,
            is_saved_exactly: false,
            findings: Vec::new(),
        })
    }

    /// Cuts off what the files have beyond the checkpoint with this `state`.
    ///
    /// # Errors
    /// A file cannot be cut back.
    pub fn cut_back(&mut self, state: &RecorderState) -> Result<()> {
        // First what reads and may fail: then the tables are as they were.
        self.decisions.cut_back(state.decisions)?;
        self.files.cut_back(&state.lengths)?;
        self.attempts.read_back(self.folder.path())
    }

    /// What the summary says of a repetition: whether it would give the same.
    #[must_use]
    pub fn deterministic(mut self, is_deterministic: bool) -> Self {
        self.deterministic = is_deterministic;
        self
    }

    /// Compares the share of failed attempts with this one.
    #[must_use]
    pub fn accepted_risk(mut self, accepted: Option<AcceptedRisk>) -> Self {
        self.attempts = AttemptLog::new(accepted);
        self
    }

    /// Counts hard resets by the environment's kinds of them, on from what was counted before.
    #[must_use]
    pub fn reset_kinds(mut self, kinds: &[ResetKind]) -> Self {
        self.hard_resets.resize(kinds.len(), (String::new(), 0));
        for (count, kind) in self.hard_resets.iter_mut().zip(kinds) {
            count.0.clone_from(&kind.name);
        }
        self
    }

    /// Writes checkpoints, too. `is_exact` says whether the one from which the run goes on had everything.
    #[must_use]
    pub fn with_checkpoints(mut self, store: CheckpointStore, is_exact: bool) -> Self {
        self.checkpoints = Some(store);
        self.is_saved_exactly = is_exact;
        self
    }

    /// Gives the checkpoints back, and with them the lock of the run.
    pub fn take_checkpoints(&mut self) -> Option<CheckpointStore> {
        self.checkpoints.take()
    }

    /// Names and seed of the run.
    pub fn identity(&self) -> &Identity {
        &self.identity
    }

    /// What kept the shield from helping, for the summary.
    pub fn found(&mut self, findings: Vec<FoundInRun>) {
        self.findings = findings;
    }

    fn flush(&mut self) -> Result<()> {
        self.files.flush()?;
        self.last_flush = Instant::now();
        Ok(())
    }

    fn seconds(&self) -> f64 {
        self.seconds_before + self.start.elapsed().as_secs_f64()
    }

    /// Makes everything written so far last, and says how far that is.
    fn state(&mut self, occasion: Occasion) -> Result<RecorderState> {
        Ok(RecorderState {
            lengths: self.files.sync()?,
            episodes: self.episodes,
            results: self.results,
            causes: self.causes.clone(),
            hard_resets: self.hard_resets.clone(),
            decisions: match occasion {
                // Parts begin at the same steps in every run of an experiment, wherever it was interrupted.
                Occasion::Interrupted => self.decisions.suspend()?,
                Occasion::Periodic | Occasion::Finished => self.decisions.begin_part()?,
            },
            decision_times: {
                let recorded = self.decision_ns.iter_recorded();
                recorded.map(|at| (at.value_iterated_to(), at.count_at_value())).collect()
            },
            seconds: self.seconds(),
        })
    }

    /// Writes what is left and `summary.json`, with the `error` of a run that failed.
    ///
    /// # Errors
    /// A file cannot be written.
    pub fn finish(mut self, counters: &Counters, budget: u64, error: Option<String>) -> Result<Summary> {
        self.flush()?;
        self.decisions.begin_part()?;
        let seconds = self.seconds();
        let quantile = |q| {
            (!self.decision_ns.is_empty()).then(|| self.decision_ns.value_at_quantile(q) as f64 / 1_000.0)
        };
        let last = self.results.last.map(|last| last.figures);
        let bare = self.results.last.and_then(|last| last.without_shield);
        let summary = Summary {
            complete: error.is_none() && counters.steps >= budget,
            error,
            exact_resume: self.is_saved_exactly && self.deterministic,
            rejected_by_cause: self.causes,
            hard_resets_by_kind: self.hard_resets.into_iter().collect(),
            attempts: self.attempts.summary(counters.steps),
            final_return: last.map(|last| last.mean_return),
            final_return_without_shield: bare.map(|bare| bare.mean_return),
            best_return: self.results.best_return,
            best_return_without_shield: self.results.best_return_without_shield,
            success_rate: last.map(|last| last.success_rate),
            success_rate_without_shield: bare.map(|bare| bare.success_rate),
            steps_to_solve: self.results.steps_to_solve(budget),
            solved: self.results.is_solved(),
            findings: self.findings,
            deterministic: self.deterministic,
            wall_seconds: seconds,
            steps_per_second: counters.steps as f64 / seconds,
            decision_us_p50: quantile(0.5),
            decision_us_p99: quantile(0.99),
            ..Summary::new(&self.identity, counters)
        };
        write_whole(&self.folder.path().join("summary.json"), &serde_json::to_vec_pretty(&summary)?)?;
        Ok(summary)
    }
}
