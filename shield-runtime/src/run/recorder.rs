//! Writes a run's folder while the run goes on.

use std::{
    collections::BTreeMap,
    fs::{self, File},
    io::BufWriter,
    path::{Path, PathBuf},
    time::{Duration, Instant},
};

use anyhow::{Context, Result, bail};
use csv::Writer;
use hdrhistogram::Histogram;
use shield_api::ResetKind;

use super::summary::{Evaluations, Identity, Summary};
use crate::decision::ProjectionKind;
use crate::observer::{Counters, EpisodeRecord, EvaluationRecord, Intervention, Observer};

/// How long finished rows may wait in memory.
const FLUSH_EVERY: Duration = Duration::from_secs(1);

/// The folder of one run, `<out>/<experiment>/<variant>/seed-<n>`.
#[derive(Debug, Clone)]
pub struct RunFolder {
    path: PathBuf,
}

impl RunFolder {
    /// Where the run belongs; creates nothing.
    pub fn new(out: &Path, identity: &Identity) -> Self {
        let path =
            out.join(&identity.experiment).join(&identity.variant).join(format!("seed-{}", identity.seed));
        Self { path }
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Whether something is already there.
    pub fn exists(&self) -> bool {
        self.path.exists()
    }

    /// Creates the folder with its `config.ron` and `plugins.json`. What stood there before is removed first if `overwrite` says so.
    ///
    /// # Errors
    /// The folder exists and must not be overwritten, or cannot be written.
    pub fn create(&self, config: &str, plugins: &str, overwrite: bool) -> Result<()> {
        let path = &self.path;
        if self.exists() {
            if !overwrite {
                bail!("{} exists already", path.display());
            }
            fs::remove_dir_all(path).with_context(|| format!("{} cannot be removed", path.display()))?;
        }
        // The folder itself must be new: another process may have made it meanwhile.
        path.parent()
            .map_or(Ok(()), fs::create_dir_all)
            .and_then(|()| fs::create_dir(path))
            .with_context(|| format!("{} cannot be created", path.display()))?;
        let written = write_whole(&path.join("config.ron"), config.as_bytes())
            .and_then(|()| write_whole(&path.join("plugins.json"), plugins.as_bytes()));
        if written.is_err() {
            self.discard();
        }
        written
    }

    /// Removes the folder of a run that could not start.
    pub fn discard(&self) {
        fs::remove_dir_all(&self.path).ok();
    }
}

/// Writes a file so that it is there whole or not at all.
fn write_whole(path: &Path, bytes: &[u8]) -> Result<()> {
    let aside = path.with_extension("partial");
    fs::write(&aside, bytes)
        .and_then(|()| fs::rename(&aside, path))
        .with_context(|| format!("{} cannot be written", path.display()))
}

type Table = Writer<BufWriter<File>>;

fn table(folder: &RunFolder, name: &str, columns: &[&str]) -> Result<Table> {
    let path = folder.path.join(name);
    let file = File::create(&path).with_context(|| format!("{} cannot be created", path.display()))?;
    let mut table = Writer::from_writer(BufWriter::new(file));
    table.write_record(columns)?;
    Ok(table)
}

/// Takes the loop's reports and writes them: `metrics.csv`, `interventions.csv`, `evaluations.csv`, `learning.csv`, `timings.csv`,
/// and in the end `summary.json`.
pub struct Recorder {
    folder: RunFolder,
    identity: Identity,
    rules: Vec<String>,
    metrics: Table,
    interventions: Table,
    evaluations: Table,
    learning: Table,
    timings: Table,
    episodes: u64,
    results: Evaluations,
    solved_at: f64,
    deterministic: bool,
    causes: BTreeMap<String, u64>,
    /// How many of each of the environment's kinds of hard resets.
    hard_resets: Vec<(String, u64)>,
    decision_ns: Histogram<u32>,
    start: Instant,
    last_flush: Instant,
}

impl Recorder {
    /// Opens the tables of a folder that [`RunFolder::create`] made. `rules` are the ids of the shield's rules.
    ///
    /// # Errors
    /// A file cannot be created.
    pub fn new(folder: RunFolder, identity: Identity, rules: Vec<String>, solved_at: f64) -> Result<Self> {
        let metrics = [
            "step",
            "episode",
            "phase",
            "length",
            "forward_return",
            "reset_return",
            "success",
            "end",
            "has_reset",
            "hard_reset",
            "early_aborts",
            "hard_resets",
            "irreversible_entries",
            "forward_steps",
            "hard_reset_cost",
        ];
        let interventions = [
            "step",
            "phase",
            "verdict",
            "cause",
            "rule",
            "score",
            "reason",
            "proposed",
            "executed",
            "solver_status",
            "iterations",
            "distance",
        ];
        Ok(Self {
            metrics: table(&folder, "metrics.csv", &metrics)?,
            interventions: table(&folder, "interventions.csv", &interventions)?,
            evaluations: table(
                &folder,
                "evaluations.csv",
                &["step", "mean_return", "success_rate", "irreversible_entries", "steps"],
            )?,
            learning: table(&folder, "learning.csv", &["step", "metric", "mean"])?,
            timings: table(&folder, "timings.csv", &["step", "wall_seconds"])?,
            folder,
            identity,
            rules,
            episodes: 0,
            results: Evaluations::default(),
            solved_at,
            deterministic: true,
            causes: BTreeMap::new(),
            hard_resets: Vec::new(),
            // Up to a minute at three digits; longer decisions count as a minute.
            decision_ns: Histogram::new_with_bounds(1, 60_000_000_000, 3)?,
            start: Instant::now(),
            last_flush: Instant::now(),
        })
    }

    /// What the summary says of a repetition: whether it would give the same.
    #[must_use]
    pub fn deterministic(mut self, is_deterministic: bool) -> Self {
        self.deterministic = is_deterministic;
        self
    }

    /// Counts hard resets by the environment's kinds of them.
    #[must_use]
    pub fn reset_kinds(mut self, kinds: &[ResetKind]) -> Self {
        self.hard_resets = kinds.iter().map(|kind| (kind.name.clone(), 0)).collect();
        self
    }

    fn flush(&mut self) -> Result<()> {
        for table in [
            &mut self.metrics,
            &mut self.interventions,
            &mut self.evaluations,
            &mut self.learning,
            &mut self.timings,
        ] {
            table.flush().with_context(|| format!("{} cannot be written", self.folder.path.display()))?;
        }
        self.last_flush = Instant::now();
        Ok(())
    }

    /// Writes what is left and `summary.json`, with the `error` of a run that failed.
    ///
    /// # Errors
    /// A file cannot be written.
    pub fn finish(mut self, counters: &Counters, budget: u64, error: Option<String>) -> Result<Summary> {
        self.flush()?;
        let seconds = self.start.elapsed().as_secs_f64();
        let quantile = |q| {
            (!self.decision_ns.is_empty()).then(|| self.decision_ns.value_at_quantile(q) as f64 / 1_000.0)
        };
        let summary = Summary {
            complete: error.is_none() && counters.steps >= budget,
            error,
            rejected_by_cause: self.causes,
            hard_resets_by_kind: self.hard_resets.into_iter().collect(),
            final_return: self.results.last.map(|last| last.mean_return),
            best_return: self.results.best_return,
            success_rate: self.results.last.map(|last| last.success_rate),
            steps_to_solve: self.results.steps_to_solve(budget),
            deterministic: self.deterministic,
            wall_seconds: seconds,
            steps_per_second: counters.steps as f64 / seconds,
            decision_us_p50: quantile(0.5),
            decision_us_p99: quantile(0.99),
            ..Summary::new(&self.identity, counters, budget)
        };
        write_whole(&self.folder.path.join("summary.json"), &serde_json::to_vec_pretty(&summary)?)?;
        Ok(summary)
    }
}

impl Observer for Recorder {
    fn on_decision_time(&mut self, time: Duration) {
        self.decision_ns.saturating_record(u64::try_from(time.as_nanos()).unwrap_or(u64::MAX));
    }

    fn on_intervention(&mut self, intervention: &Intervention<'_>) -> Result<()> {
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
        let rule = abort.rule.and_then(|index| self.rules.get(index)).map_or("", String::as_str);
        let score = if abort.score.is_nan() { String::new() } else { abort.score.to_string() };
        self.interventions.write_record([
            &step.to_string(),
            role.name(),
            verdict,
            &cause,
            rule,
            &score,
            reason,
            &numbers(proposed),
            &executed.map_or(String::new(), numbers),
            solver_status,
            &projection.map_or(String::new(), |projection| projection.iterations.to_string()),
            &projection.map_or(String::new(), |projection| projection.distance.to_string()),
        ])?;
        *self.causes.entry(cause).or_default() += 1;
        Ok(())
    }

    fn on_episode(&mut self, episode: &EpisodeRecord, counters: &Counters) -> Result<()> {
        if let Some(kind) = episode.hard_reset.and_then(|reset| reset.kind) {
            self.hard_resets[kind].1 += 1;
        }
        self.metrics.serialize((
            (counters.steps, self.episodes, episode.role.name(), episode.length),
            (episode.forward_return, episode.reset_return, u8::from(episode.success), episode.end),
            (u8::from(episode.has_reset), u8::from(episode.hard_reset.is_some()), counters.early_aborts),
            (
                counters.hard_resets,
                counters.irreversible_entries,
                counters.forward_steps,
                counters.hard_reset_cost,
            ),
        ))?;
        self.episodes += 1;
        if self.last_flush.elapsed() >= FLUSH_EVERY {
            self.timings.serialize((counters.steps, self.start.elapsed().as_secs_f64()))?;
            self.flush()?;
        }
        Ok(())
    }

    fn on_metric(&mut self, step: u64, name: &str, mean: f64) -> Result<()> {
        Ok(self.learning.serialize((step, name, mean))?)
    }

    fn on_evaluation(&mut self, evaluation: &EvaluationRecord) -> Result<()> {
        self.results.add(evaluation, self.solved_at);
        let EvaluationRecord { step, mean_return, success_rate, irreversible_entries, steps } = evaluation;
        Ok(self.evaluations.serialize((step, mean_return, success_rate, irreversible_entries, steps))?)
    }
}

/// Numbers separated by blanks: one column for a vector.
fn numbers(values: &[f32]) -> String {
    values.iter().map(f32::to_string).collect::<Vec<_>>().join(" ")
}
