//! What a decision is made from.

use shield_api::{Learner, SuccessCritic};

/// What the ladder is told of the moment in which an action is proposed.
#[derive(Debug, Clone, Copy)]
pub struct Moment<'a> {
    /// Environment steps so far, both phases.
    pub step: u64,
    /// The present observation.
    pub observation: &'a [f32],
    /// The action executed before; `None` after a hard reset.
    pub previous: Option<&'a [f32]>,
}

/// Whom the ladder asks for values.
pub struct Agents<'a> {
    /// Values how well an action can be undone.
    pub reset: &'a mut dyn Learner,
    /// Values the task; `None` where the forward agent is a policy.
    pub forward: Option<&'a mut dyn Learner>,
    /// Estimates how likely an action can be undone; `None` where no rule needs it.
    pub success: Option<&'a mut dyn SuccessCritic>,
}

/// Values of an action that were computed before, for [`Ladder::judge_given`](super::Ladder::judge_given); empty where they were not.
#[derive(Debug, Clone, Copy, Default)]
pub struct GivenValues<'a> {
    /// The reset ensemble's values of the action.
    pub values: &'a [f32],
    /// The reset ensemble's values of the reset agent's own action.
    pub greedy_values: &'a [f32],
    /// The forward ensemble's values of the action.
    pub forward_values: &'a [f32],
    /// The success critic's estimates for the action.
    pub probabilities: &'a [f32],
    /// The same for the reset agent's own action.
    pub greedy_probabilities: &'a [f32],
    /// The same where the last reset ended.
    pub start_probabilities: &'a [f32],
}
