//! What is kept of the steps, and what is learned from it.

use serde::{Deserialize, Serialize};

use super::{Endings, OnResetFailure, OnResetSuccess, Updates};
use shield_core::experience::{Kept, UndoSettings};

/// The experience and what is learned from it.
#[derive(Debug, Clone, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct ExperienceConfig {
    /// How many transitions are kept; the oldest are overwritten.
    pub capacity: usize,
    /// How observations are kept: as they are, or as bytes, where they are whole numbers from 0 to 255, as those of images.
    pub observations: Kept,
    /// Transitions per update. Lillicrap et al. 2015: 64.
    pub batch: usize,
    /// Updates after each environment step after which anything is learned, of each agent that learns.
    pub updates_per_step: usize,
    /// The same of the reset agent and the success critic alone. `None`: as many as the others.
    pub reset_updates_per_step: Option<usize>,
    /// Learning follows every n-th environment step only: 4 makes a quarter of an update per step.
    pub update_every: u64,
    /// Who learns after a step.
    pub updates: Updates,
    /// Probability that an ensemble member learns from a transition (Osband et al. 2016); 1 gives every member everything.
    pub bootstrap_probability: f64,
    /// Whether reaching the reset set ends the reset agent's task.
    pub on_reset_success: OnResetSuccess,
    /// Whether a failed reset episode ends it.
    pub on_reset_failure: OnResetFailure,
    /// Transitions after which the forward agent learns no more from an abort, of which the shield may think otherwise by then. `None`: it
    /// learns from aborts as long as they are kept.
    pub abort_lifetime: Option<u64>,
    /// The share of a success critic's batch that is drawn around the starts of failed attempts, so that rare failures are not diluted.
    pub failure_share: f64,
    /// The share that is drawn from the last steps of successful attempts.
    pub success_share: f64,
    /// Attempts after which the outcome of an earlier one counts half for a success critic: a reset agent that improves makes it stale.
    pub outcome_half_life: f64,
    /// How much of a hard reset's cost the reset agent loses in the reward of the step before it.
    pub cost_weight: f32,
}

impl Default for ExperienceConfig {
    fn default() -> Self {
        Self {
            capacity: 1_000_000,
            observations: Kept::default(),
            batch: 64,
            updates_per_step: 1,
            reset_updates_per_step: None,
            update_every: 1,
            updates: Updates::default(),
            bootstrap_probability: 1.0,
            on_reset_success: OnResetSuccess::default(),
            on_reset_failure: OnResetFailure::default(),
            abort_lifetime: None,
            failure_share: 0.5,
            success_share: 0.125,
            outcome_half_life: 15.0,
            cost_weight: 0.0,
        }
    }
}

impl ExperienceConfig {
    /// How batches are drawn for a success critic.
    pub fn undo(&self) -> UndoSettings {
        let Self { bootstrap_probability, failure_share, success_share, outcome_half_life, .. } = *self;
        UndoSettings { bootstrap_probability, failure_share, success_share, outcome_half_life }
    }

    /// The two endings of the reset agent's task.
    pub fn endings(&self) -> Endings {
        Endings { on_success: self.on_reset_success, on_failure: self.on_reset_failure }
    }
}
