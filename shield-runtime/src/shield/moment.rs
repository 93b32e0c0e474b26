//! What a decision is made from.

use shield_api::Learner;

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
}
