//! What the recorder hears of the loop, and writes of it.

use std::time::Duration;

use anyhow::{Context, Result};

use super::{FLUSH_EVERY, Recorder};
use crate::{
    observer::{Observer, Scene, Snapshot},
    run::tables::{EvaluationRow, TimingRow},
};
use shield_core::{
    events::{Counters, DecisionEvent, EpisodeEvent, EvaluationEvent, Intervention},
    experience::AgentRole,
};
use shield_decisions::tables::{InterventionRow, LearningRow, MetricsRow};

impl Observer for Recorder {
    fn on_decision_time(&mut self, time: Duration) {
        self.decision_ns.saturating_record(u64::try_from(time.as_nanos()).unwrap_or(u64::MAX));
    }

    fn on_intervention(&mut self, intervention: &Intervention<'_>, _: &mut Scene<'_>) -> Result<()> {
        self.files.interventions.write(&InterventionRow::of(intervention, &self.rules))?;
        *self.causes.entry(intervention.abort.cause.to_string()).or_default() += 1;
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
        self.files.metrics.write(&MetricsRow::of(self.episodes, episode, counters))?;
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
        self.files.learning.write(&LearningRow::new(step, name, mean))
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
