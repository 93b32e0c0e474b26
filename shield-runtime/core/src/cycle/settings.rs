//! What the reset cycle does, and what it teaches.

use crate::settings::{AttemptLength, BetweenAttempts, Endings, Mode, OnAbort, ResetTest, Updates};

/// Settings of a [`ResetCycle`](super::ResetCycle). The defaults are those of an experiment.
#[derive(Debug, Clone)]
pub struct CycleSettings {
    /// Who acts, and when the environment is reset.
    pub mode: Mode,
    /// Steps after which a forward episode is over; `None` where the caller ends it.
    pub forward_length: Option<u64>,
    /// Steps of an episode, as attempts are measured by it.
    pub episode_length: u64,
    /// When an attempt is over.
    pub attempt_length: AttemptLength,
    /// N: failed attempts in a row after which a hard reset is needed; `None` forbids hard resets.
    pub reset_attempts: Option<u32>,
    /// Which states of an attempt count for its success.
    pub reset_test: ResetTest,
    /// What lies between two attempts.
    pub between_attempts: BetweenAttempts,
    /// An attempt ends as soon as the reset set is reached.
    pub stop_on_reset: bool,
    /// Whether the reset agent explores; a reset controller never does.
    pub explores: bool,
    /// The rules judge the reset agent's exploratory actions; a rejected one gives way to its greedy one.
    pub shield_exploration: bool,
    /// The reset agent's values of the start of each attempt are reported; not those of a reset controller, which has none. An agent that
    /// fails to give them fails.
    pub values_attempts: bool,
    /// What the forward agent learns from an abort.
    pub on_abort: OnAbort,
    /// Whether the forward agent learns from the experience too; a caller's own agent keeps its own.
    pub stores_forward: bool,
    /// How attempts end for the reset agent's values.
    pub endings: Endings,
    /// Who learns after a step.
    pub updates: Updates,
    /// Updates after each step after which anything is learned.
    pub updates_per_step: usize,
    /// The same of the reset agent and the success critic alone; `None`: as many as the others.
    pub reset_updates_per_step: Option<usize>,
    /// Learning follows every n-th step only; 0 counts as 1.
    pub update_every: u64,
    /// A factor to the costs of hard resets.
    pub hard_reset_cost: f64,
    /// How much of a hard reset's cost the reset agent loses in the reward of the step before it.
    pub cost_weight: f32,
}

impl CycleSettings {
    /// Updates of the reset agent and the success critic after each step.
    pub fn reset_updates(&self) -> usize {
        self.reset_updates_per_step.unwrap_or(self.updates_per_step)
    }
}

impl Default for CycleSettings {
    fn default() -> Self {
        Self {
            mode: Mode::Shielded,
            forward_length: None,
            episode_length: 500,
            attempt_length: AttemptLength::default(),
            reset_attempts: Some(1),
            reset_test: ResetTest::default(),
            between_attempts: BetweenAttempts::default(),
            stop_on_reset: true,
            explores: true,
            shield_exploration: false,
            values_attempts: true,
            on_abort: OnAbort::default(),
            stores_forward: true,
            endings: Endings::default(),
            updates: Updates::default(),
            updates_per_step: 1,
            reset_updates_per_step: None,
            update_every: 1,
            hard_reset_cost: 1.0,
            cost_weight: 0.0,
        }
    }
}
