//! Writes a run's folder while the run goes on.

use std::{
    collections::BTreeMap,
    path::Path,
    time::{Duration, Instant},
};

use anyhow::{Context, Result};
use hdrhistogram::Histogram;
use serde::{Deserialize, Serialize};
use shield_api::ResetKind;

use super::{
    accepted_risk::AcceptedRisk,
    attempt_log::AttemptLog,
    decisions::{self, DecisionLog, DecisionState},
    files::{self, Files, Lengths},
    folder::{RunFolder, write_whole},
    summary::{Evaluations, FoundInRun, Identity, Summary},
    tables::{EvaluationRow, InterventionRow, LearningRow, MetricsRow, TimingRow},
};
use crate::{
    checkpoint::{CheckpointError, CheckpointStore, RunFiles},
    observer::{Observer, Occasion, Scene, Snapshot},
};
use shield_core::{
    decision::ProjectionKind,
    events::{Counters, DecisionEvent, EpisodeEvent, EvaluationEvent, Intervention},
    experience::AgentRole,
};

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
        decisions::check(&run.join(DECISIONS), self.decisions)
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

impl Observer for Recorder {
    fn on_decision_time(&mut self, time: Duration) {
        self.decision_ns.saturating_record(u64::try_from(time.as_nanos()).unwrap_or(u64::MAX));
    }

    fn on_intervention(&mut self, intervention: &Intervention<'_>, _: &mut Scene<'_>) -> Result<()> {
        let Intervention { step, role, proposed, executed, abort, projection, reason } = intervention;
        let cause = abort.cause.to_string();
        let verdict = match (projection, executed) {
            (Some(_), _) => "project",
            (None, Some(_)) => "replace",
            (None, None) => "abort",
        };
        let solver_status = match projection.map(|projection| projection.kind) {
            Some(ProjectionKind::Qp) => "solved",
            Some(ProjectionKind::Replace | ProjectionKind::Best) => "",
            None => abort.cause.solver_status().unwrap_or(""),
        };
        self.files.interventions.write(&InterventionRow {
            step: *step,
            phase: role.name(),
            verdict,
            cause: &cause,
            rule: abort.rule.and_then(|index| self.rules.get(index)).map_or("", String::as_str),
            score: (!abort.score.is_nan()).then(|| abort.score.to_string()),
            reason,
            proposed: numbers(proposed),
            executed: executed.map(numbers),
            solver_status,
            iterations: projection.map(|projection| projection.iterations),
            distance: projection.map(|projection| projection.distance.to_string()),
        })?;
        *self.causes.entry(cause).or_default() += 1;
        Ok(())
    }

    fn on_decision(&mut self, decision: &DecisionEvent<'_>) -> Result<()> {
        self.decisions.push(decision)
    }

    fn on_episode(&mut self, episode: &EpisodeEvent, counters: &Counters) -> Result<()> {
        let gain = match episode.role {
            AgentRole::Forward => episode.forward_return,
            AgentRole::Reset => episode.reset_return,
        };
        if let Some(kind) = episode.hard_reset.and_then(|reset| reset.kind) {
            self.hard_resets[kind].1 += 1;
        }
        self.files.metrics.write(&MetricsRow {
            step: counters.steps,
            episode: self.episodes,
            phase: episode.role.name(),
            length: episode.length,
            forward_return: episode.forward_return,
            reset_return: episode.reset_return,
            success: u8::from(episode.success),
            end: Some(episode.end),
            has_reset: u8::from(episode.has_reset),
            hard_reset: u8::from(episode.hard_reset.is_some()),
            early_aborts: counters.early_aborts,
            hard_resets: counters.hard_resets,
            irreversible_entries: counters.irreversible_entries,
            forward_steps: counters.forward_steps,
            hard_reset_cost: counters.hard_reset_cost,
            reset_value: episode.reset_value,
            lifetime_return: counters.lifetime_return,
            undo_probability: episode.undo_probability,
            attempt: episode.attempt,
        })?;
        let of_role = if episode.role == AgentRole::Forward { "forward/return" } else { "reset/return" };
        let mut figures = vec![
            (of_role, gain),
            ("counts/early_aborts", counters.early_aborts as f64),
            ("counts/hard_resets", counters.hard_resets as f64),
            ("counts/irreversible_entries", counters.irreversible_entries as f64),
            ("counts/forward_steps", counters.forward_steps as f64),
            ("lifetime/return", counters.lifetime_return),
        ];
        figures.extend(self.attempts.note(counters.steps, episode));
        self.files.events.scalars(counters.steps, &figures)?;
        self.episodes += 1;
        if self.last_flush.elapsed() >= FLUSH_EVERY {
            self.files.timings.write(&TimingRow { step: counters.steps, wall_seconds: self.seconds() })?;
            self.flush()?;
        }
        Ok(())
    }

    fn on_metric(&mut self, step: u64, name: &str, mean: f64) -> Result<()> {
        self.files.events.scalars(step, &[(name, mean)])?;
        self.files.learning.write(&LearningRow { step, metric: name, mean })
    }

    fn on_evaluation(&mut self, evaluation: &EvaluationEvent, counters: &Counters) -> Result<()> {
        self.results.add(evaluation, self.solved_at);
        let EvaluationEvent { step, figures, without_shield: bare } = *evaluation;
        self.files.events.scalars(
            step,
            &[
                ("evaluation/mean_return", figures.mean_return),
                ("evaluation/success_rate", figures.success_rate),
                ("evaluation/irreversible_entries", figures.irreversible_entries as f64),
            ],
        )?;
        if let Some(bare) = bare {
            self.files.events.scalars(
                step,
                &[
                    ("evaluation/mean_return_without_shield", bare.mean_return),
                    ("evaluation/success_rate_without_shield", bare.success_rate),
                    ("evaluation/irreversible_entries_without_shield", bare.irreversible_entries as f64),
                ],
            )?;
        }
        self.files.evaluations.write(&EvaluationRow {
            step,
            mean_return: figures.mean_return,
            success_rate: figures.success_rate,
            irreversible_entries: figures.irreversible_entries,
            steps: figures.steps,
            lifetime_return: counters.lifetime_return,
            hard_resets: counters.hard_resets,
            mean_return_without_shield: bare.map(|bare| bare.mean_return),
            success_rate_without_shield: bare.map(|bare| bare.success_rate),
            irreversible_entries_without_shield: bare.map(|bare| bare.irreversible_entries),
            steps_without_shield: bare.map(|bare| bare.steps),
        })
    }

    fn on_checkpoint(&mut self, snapshot: &Snapshot<'_>) -> Result<()> {
        if self.checkpoints.is_none() {
            return Ok(());
        }
        let state = self.state(snapshot.occasion)?;
        if let Some(store) = &mut self.checkpoints {
            store.write(snapshot, &state).context("the checkpoint cannot be written")?;
            self.is_saved_exactly = snapshot.state.unsaved().is_empty();
        }
        Ok(())
    }
}

/// Numbers separated by blanks: one column for a vector.
fn numbers(values: &[f32]) -> String {
    values.iter().map(f32::to_string).collect::<Vec<_>>().join(" ")
}
