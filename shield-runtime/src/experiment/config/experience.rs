//! What is kept of the steps, and what is learned from it.

use serde::{Deserialize, Serialize};

/// The experience and what is learned from it.
#[derive(Debug, Clone, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct ExperienceConfig {
    /// How many transitions are kept; the oldest are overwritten.
    pub capacity: usize,
    /// Transitions per update. Lillicrap et al. 2015: 64.
    pub batch: usize,
    /// Updates after each environment step, of each agent that learns.
    pub updates_per_step: usize,
    /// Who learns after a step.
    pub updates: Updates,
    /// Probability that an ensemble member learns from a transition (Osband et al. 2016); 1 gives every member everything.
    pub bootstrap_probability: f64,
    /// Whether reaching the reset set ends the reset agent's task.
    pub on_reset_success: OnResetSuccess,
    /// Whether a failed reset episode ends it.
    pub on_reset_failure: OnResetFailure,
    /// How much of a hard reset's cost the reset agent loses in the reward of the step before it.
    pub cost_weight: f32,
}

impl Default for ExperienceConfig {
    fn default() -> Self {
        Self {
            capacity: 1_000_000,
            batch: 64,
            updates_per_step: 1,
            updates: Updates::default(),
            bootstrap_probability: 1.0,
            on_reset_success: OnResetSuccess::default(),
            on_reset_failure: OnResetFailure::default(),
            cost_weight: 0.0,
        }
    }
}

impl ExperienceConfig {
    /// The two endings of the reset agent's task.
    pub fn endings(&self) -> Endings {
        Endings { on_success: self.on_reset_success, on_failure: self.on_reset_failure }
    }
}

/// How reset episodes end for the reset agent's values.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Endings {
    /// In the reset set.
    pub on_success: OnResetSuccess,
    /// At the end of a failed reset episode.
    pub on_failure: OnResetFailure,
}

impl Endings {
    /// Whether the value of the state after a step counts for the reset agent. `has_failed`: it was the last step of a failed reset episode.
    pub fn reset_continues(self, in_reset_set: bool, terminated: bool, has_failed: bool) -> bool {
        let is_done = in_reset_set && self.on_success == OnResetSuccess::Terminal;
        let is_lost = has_failed && self.on_failure == OnResetFailure::Zero;
        !terminated && !is_done && !is_lost
    }
}

/// Who learns after a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, Serialize)]
pub enum Updates {
    /// The agent in charge (Algorithm 1).
    #[default]
    Active,
    /// Both agents, from the shared experience.
    Both,
}

/// What the reset set means for the reset agent's values.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, Serialize)]
pub enum OnResetSuccess {
    /// The task ends there: with a reset reward of 1 in the reset set and 0 elsewhere, the value is the probability to get there.
    Terminal,
    /// It goes on: values lie in [0, 1/(1 − γ)), as the paper's robots have it.
    #[default]
    Bootstrap,
}

/// What the last step of a failed reset episode means for the reset agent's values.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, Serialize)]
pub enum OnResetFailure {
    /// The value beyond it is 0, so that irreversible states do not live on their own estimate.
    Zero,
    /// A time-out like any other.
    #[default]
    Bootstrap,
}
