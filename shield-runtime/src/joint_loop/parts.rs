//! What a run of the joint loop is made of.

use crate::{
    agent::{Agent, ForwardAgent},
    evaluation::Evaluator,
    experience::Experience,
    settings::{BetweenAttempts, Endings, Mode, OnAbort, RecordConfig, ResetTest, Updates},
    shield::Ladder,
    world::World,
};

/// Settings of the loop, as the experiment gives them.
#[derive(Debug, Clone)]
pub struct LoopSettings {
    /// Who acts, and when the world is reset.
    pub mode: Mode,
    /// Environment steps of the run, both phases.
    pub steps: u64,
    /// N; `None` forbids hard resets.
    pub reset_attempts: Option<u32>,
    /// Which states of a reset episode count.
    pub reset_test: ResetTest,
    /// What lies between two attempts.
    pub between_attempts: BetweenAttempts,
    /// A reset episode ends as soon as the reset set is reached.
    pub stop_on_reset: bool,
    /// The rules judge the reset agent's exploratory actions too.
    pub shield_exploration: bool,
    /// What the forward agent learns from an abort.
    pub on_abort: OnAbort,
    /// A factor to the costs of hard resets.
    pub hard_reset_cost: f64,
    /// How much of a hard reset's cost the reset agent loses.
    pub cost_weight: f32,
    /// Which decisions the observer hears of.
    pub record: RecordConfig,
    /// Who learns after a step.
    pub updates: Updates,
    /// Updates after each step.
    pub updates_per_step: usize,
    /// How reset episodes end for the reset agent's values.
    pub endings: Endings,
    /// Steps between two evaluations.
    pub evaluate_every: Option<u64>,
    /// Steps between two checkpoints; `None` keeps none.
    pub checkpoint_every: Option<u64>,
}

/// Who takes part in a loop.
pub struct Participants {
    /// Environment and reset task.
    pub world: World,
    /// Does the task; `None` in `ResetOnly`.
    pub forward: Option<ForwardAgent>,
    /// Undoes it; `None` in `StatusQuo` and `ForwardOnly`.
    pub reset: Option<Agent>,
    /// Stands between; `Some` in `Shielded` only.
    pub shield: Option<Ladder>,
    /// Evaluates in a second instance of the environment.
    pub evaluator: Option<Evaluator>,
    /// What both agents learn from.
    pub experience: Experience,
}
