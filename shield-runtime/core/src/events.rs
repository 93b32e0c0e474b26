//! What a run reports and counts.

use std::ops::AddAssign;

use serde::{Deserialize, Serialize};

use crate::{
    decision::{Abort, Decision, Projection},
    experience::AgentRole,
    shield::Judgement,
};

/// Why an episode ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum EpisodeEnd {
    /// The episode's length is reached.
    TimeLimit,
    /// The shield aborted the forward episode.
    Abort,
    /// A reset episode reached the reset set.
    ResetSet,
    /// The environment cannot go on.
    Terminated,
    /// The environment's process failed, and another took its place.
    WorkerLost,
    /// The run's steps are used up.
    Budget,
    /// The user asked to stop.
    Interrupted,
}

impl EpisodeEnd {
    /// The run ended, not the episode.
    pub fn is_cut(self) -> bool {
        matches!(self, Self::Budget | Self::Interrupted)
    }

    /// There is no going on without a hard reset.
    pub fn needs_hard_reset(self) -> bool {
        matches!(self, Self::Terminated | Self::WorkerLost)
    }
}

/// How an attempt to get back to the start ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AttemptOutcome {
    /// The reset set was reached.
    Succeeded,
    /// It was not, or the environment terminated before.
    Failed,
}

/// One finished episode of either agent.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EpisodeEvent {
    /// Who was in charge.
    pub role: AgentRole,
    /// Its steps.
    pub length: u64,
    /// Sum of forward rewards.
    pub forward_return: f64,
    /// Sum of reset rewards.
    pub reset_return: f64,
    /// The task was achieved at some step.
    pub success: bool,
    /// Why it ended.
    pub end: EpisodeEnd,
    /// For a reset episode: whether it succeeded by the configured test.
    pub has_reset: bool,
    /// The outcome of the attempt that ended with this episode: of a reset episode that was not cut short, or of a forward episode in which
    /// the environment terminated, which is a failed attempt.
    pub attempt: Option<AttemptOutcome>,
    /// For a reset episode: the mean of the ensemble's values of the greedy action at its start.
    pub reset_value: Option<f32>,
    /// For a reset episode: the mean of the success critic's estimates at its start.
    pub undo_probability: Option<f32>,
    /// The hard reset that follows, if one does.
    pub hard_reset: Option<HardReset>,
}

impl EpisodeEvent {
    /// Of a forward episode that no attempt ends with and no hard reset follows.
    pub fn of_forward(tally: &Tally, end: EpisodeEnd) -> Self {
        Self {
            role: AgentRole::Forward,
            length: tally.length,
            forward_return: tally.forward_return,
            reset_return: tally.reset_return,
            success: tally.success,
            end,
            has_reset: false,
            attempt: None,
            reset_value: tally.reset_value,
            undo_probability: None,
            hard_reset: None,
        }
    }
}

/// A hard reset.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HardReset {
    /// Its kind, as an index into the environment's list; `None` where all are alike.
    pub kind: Option<usize>,
    /// What it costs.
    pub cost: f64,
}

/// One rejected action.
#[derive(Debug, Clone, Copy)]
pub struct Intervention<'a> {
    /// Environment steps before it.
    pub step: u64,
    /// Whose action it was.
    pub role: AgentRole,
    /// The rejected action.
    pub proposed: &'a [f32],
    /// What was executed instead; `None` where the episode ended.
    pub executed: Option<&'a [f32]>,
    /// Cause, rule and score.
    pub abort: Abort,
    /// How the executed action was found, where that was by projection.
    pub projection: Option<Projection>,
    /// Why, for a person.
    pub reason: &'a str,
}

/// One decision, whatever it was.
#[derive(Debug, Clone, Copy)]
pub struct DecisionEvent<'a> {
    /// Environment steps before it.
    pub step: u64,
    /// Whose action it was.
    pub role: AgentRole,
    /// What was decided.
    pub decision: Decision,
    /// Why the proposed action was rejected, if it was.
    pub rejection: Option<Abort>,
    /// What was observed.
    pub observation: &'a [f32],
    /// The proposed action.
    pub proposed: &'a [f32],
    /// The action executed before; `None` after a hard reset.
    pub previous: Option<&'a [f32]>,
    /// What is executed; `None` where the episode ended.
    pub executed: Option<&'a [f32]>,
    /// What the rules were told of the proposed action, and what they compared.
    pub judgement: &'a Judgement,
    /// The environment's state before the action, where it is kept.
    pub state: Option<&'a [u8]>,
}

impl<'a> DecisionEvent<'a> {
    /// The intervention that it is, if it is one; `reason` says why, for a person.
    pub fn intervention(&self, reason: &'a str) -> Option<Intervention<'a>> {
        let Self { step, role, proposed, executed, decision, .. } = *self;
        let abort = self.rejection?;
        Some(Intervention {
            step,
            role,
            proposed,
            executed,
            abort,
            projection: decision.projection(),
            reason,
        })
    }

    /// `allow`, `warm_up`, `project`, `abort`, or `replace` where the reset agent's exploration gave way to its greedy action.
    pub fn verdict(&self) -> &'static str {
        match self.decision {
            Decision::Allow | Decision::Resetting => "allow",
            Decision::WarmUp => "warm_up",
            Decision::Project(_) => "project",
            Decision::Abort(_) if self.executed.is_some() => "replace",
            Decision::Abort(_) => "abort",
        }
    }
}

/// One evaluation.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct EvaluationEvent {
    /// Training steps before it.
    pub step: u64,
    /// What it came to: with the shield, if it was evaluated with one.
    pub figures: EvaluationFigures,
    /// What episodes from the same seeds came to without the shield; `None` if the figures above are without one.
    pub without_shield: Option<EvaluationFigures>,
}

/// What the episodes of an evaluation came to.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct EvaluationFigures {
    /// Mean return of its episodes.
    pub mean_return: f64,
    /// Share of its episodes that achieved the task.
    pub success_rate: f64,
    /// Entries into irreversible states, all episodes together.
    pub irreversible_entries: u64,
    /// Steps of all episodes together; not part of the budget.
    pub steps: u64,
}

/// Everything that a run counts.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Counters {
    /// Environment steps of both phases.
    pub steps: u64,
    /// Those of forward episodes.
    pub forward_steps: u64,
    /// Sum of the forward rewards of all steps, of both phases: what the lifetime was worth to the task.
    pub lifetime_return: f64,
    /// Forward episodes.
    pub forward_episodes: u64,
    /// Reset episodes.
    pub reset_episodes: u64,
    /// Forward episodes that the shield aborted.
    pub early_aborts: u64,
    /// Of these, aborts because something failed rather than because a rule rejected.
    pub failed_closed: u64,
    /// Forward actions that were altered instead of aborted.
    pub projections: u64,
    /// Forward actions that passed unjudged because of `warm_up_steps`.
    pub warm_up_decisions: u64,
    /// Exploratory actions of the reset agent that were replaced by its greedy one.
    pub exploration_replaced: u64,
    /// Hard resets, the initial one excluded.
    pub hard_resets: u64,
    /// Their costs, summed.
    pub hard_reset_cost: f64,
    /// Times that an irreversible state was entered.
    pub irreversible_entries: u64,
    /// Times that another process took the place of the environment's.
    pub worker_restarts: u64,
}

/// Adds up the steps of an episode.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
pub struct Tally {
    /// Its steps.
    pub length: u64,
    /// Sum of forward rewards.
    pub forward_return: f64,
    /// Sum of reset rewards.
    pub reset_return: f64,
    /// The task was achieved at some step.
    pub success: bool,
    /// Some state was in the reset set.
    pub visited_reset_set: bool,
    /// The last state is.
    pub is_in_reset_set: bool,
    /// At the start of a reset episode.
    pub reset_value: Option<f32>,
}

impl AddAssign<&shield_api::StepOutcome> for Tally {
    fn add_assign(&mut self, outcome: &shield_api::StepOutcome) {
        self.length += 1;
        self.forward_return += f64::from(outcome.forward_reward);
        self.reset_return += f64::from(outcome.reset_reward);
        self.success |= outcome.success;
        self.visited_reset_set |= outcome.in_reset_set;
        self.is_in_reset_set = outcome.in_reset_set;
    }
}
