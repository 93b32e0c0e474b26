//! What the recorder hears of the loop, and writes of it.

use std::time::Duration;

use anyhow::{Context, Result};

use super::{FLUSH_EVERY, Recorder};
use crate::{
    observer::{Observer, Scene, Snapshot},
    run::tables::{EvaluationRow, InterventionRow, LearningRow, MetricsRow, TimingRow},
};
use shield_core::{
    decision::ProjectionKind,
    events::{Counters, DecisionEvent, EpisodeEvent, EvaluationEvent, Intervention},
    experience::AgentRole,
};

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
