//! What a row says of an episode, of a rejection and of a figure.

use serde::Serialize;

use super::Row;
use shield_core::{
    decision::ProjectionKind,
    events::{AttemptOutcome, Counters, EpisodeEnd, EpisodeEvent, Intervention},
};

/// `metrics.csv`: an episode.
#[derive(Serialize, Default)]
pub struct MetricsRow {
    step: u64,
    episode: u64,
    phase: &'static str,
    length: u64,
    forward_return: f64,
    reset_return: f64,
    success: u8,
    end: Option<EpisodeEnd>,
    has_reset: u8,
    hard_reset: u8,
    early_aborts: u64,
    hard_resets: u64,
    irreversible_entries: u64,
    forward_steps: u64,
    hard_reset_cost: f64,
    reset_value: Option<f32>,
    lifetime_return: f64,
    undo_probability: Option<f32>,
    attempt: Option<AttemptOutcome>,
}

/// `interventions.csv`: a rejected action.
#[derive(Serialize, Default)]
pub struct InterventionRow<'a> {
    step: u64,
    phase: &'static str,
    verdict: &'static str,
    cause: &'static str,
    rule: &'a str,
    score: Option<String>,
    reason: &'a str,
    proposed: String,
    executed: Option<String>,
    solver_status: &'static str,
    iterations: Option<u32>,
    distance: Option<String>,
}

/// `learning.csv`: a learner's own figure.
#[derive(Serialize, Default)]
pub struct LearningRow<'a> {
    step: u64,
    metric: &'a str,
    mean: f64,
}

impl Row for MetricsRow {
    const FILE: &'static str = "metrics.csv";
}
impl Row for InterventionRow<'_> {
    const FILE: &'static str = "interventions.csv";
}
impl Row for LearningRow<'_> {
    const FILE: &'static str = "learning.csv";
}

impl MetricsRow {
    /// Of the episode with this number, with everything that was counted until its end.
    pub fn of(number: u64, episode: &EpisodeEvent, counters: &Counters) -> Self {
        Self {
            step: counters.steps,
            episode: number,
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
        }
    }
}

impl<'a> InterventionRow<'a> {
    /// Of one rejection by a shield that has these rules.
    pub fn of(intervention: &Intervention<'a>, rules: &'a [String]) -> Self {
        let Intervention { step, role, proposed, executed, abort, projection, reason } = *intervention;
        Self {
            step,
            phase: role.name(),
            verdict: match (projection, executed) {
                (Some(_), _) => "project",
                (None, Some(_)) => "replace",
                (None, None) => "abort",
            },
            cause: abort.cause.name(),
            rule: abort.rule.and_then(|index| rules.get(index)).map_or("", String::as_str),
            score: (!abort.score.is_nan()).then(|| abort.score.to_string()),
            reason,
            proposed: numbers(proposed),
            executed: executed.map(numbers),
            solver_status: match projection.map(|projection| projection.kind) {
                Some(ProjectionKind::Qp) => "solved",
                Some(ProjectionKind::Replace | ProjectionKind::Best) => "",
                None => abort.cause.solver_status().unwrap_or(""),
            },
            iterations: projection.map(|projection| projection.iterations),
            distance: projection.map(|projection| projection.distance.to_string()),
        }
    }
}

impl<'a> LearningRow<'a> {
    /// The mean of a figure over the episode that ended after so many steps.
    pub fn new(step: u64, metric: &'a str, mean: f64) -> Self {
        Self { step, metric, mean }
    }
}

/// Numbers separated by blanks: one column for a vector.
fn numbers(values: &[f32]) -> String {
    values.iter().map(f32::to_string).collect::<Vec<_>>().join(" ")
}
