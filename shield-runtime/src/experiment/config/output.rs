//! What a run keeps, beside what it learns from: checkpoints, decisions, evaluations.

use serde::{Deserialize, Serialize};

use super::one;

/// When the state of a run is kept. At Ctrl-C and at its end it always is.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct CheckpointConfig {
    /// Environment steps between two checkpoints: what a run loses at most when it is killed.
    pub every: u64,
}

impl Default for CheckpointConfig {
    fn default() -> Self {
        Self { every: 10_000 }
    }
}

/// What is kept of the shield's decisions, to explain and replay them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct RecordConfig {
    /// The decisions of every n-th step are recorded, and every rejection; 0: none at all.
    pub decisions: u64,
    /// With the forward decision of every n-th step, the environment's state; 0: never.
    pub states_every: u64,
}

impl RecordConfig {
    /// Whether the decision at `step` is recorded.
    pub fn takes(&self, step: u64, is_rejection: bool) -> bool {
        self.decisions > 0 && (is_rejection || step.is_multiple_of(self.decisions) || self.takes_state(step))
    }

    /// Whether the state at `step` is.
    pub fn takes_state(&self, step: u64) -> bool {
        self.states_every > 0 && step.is_multiple_of(self.states_every)
    }
}

impl Default for RecordConfig {
    fn default() -> Self {
        Self { decisions: 1, states_every: 0 }
    }
}

/// Evaluation at fixed intervals; its steps do not count.
#[derive(Debug, Clone, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct EvaluationConfig {
    /// Steps between two evaluations.
    pub every: u64,
    /// Episodes of one evaluation.
    #[serde(default = "ten")]
    pub episodes: u32,
    /// Who is evaluated.
    #[serde(default)]
    pub agent: EvaluatedAgent,
    /// The named start of each episode; the usual one if `None`.
    #[serde(default)]
    pub start: Option<String>,
    /// Whether the shield stands between the agent and the world.
    #[serde(default)]
    pub shielded: bool,
    /// An evaluation has succeeded if at least this share of its episodes did; three in a row solve the task.
    #[serde(default = "one")]
    pub solved_at: f64,
}

fn ten() -> u32 {
    10
}

/// Who is evaluated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, Serialize)]
pub enum EvaluatedAgent {
    /// The forward agent or policy.
    #[default]
    Forward,
    /// The reset agent; returns are reset rewards, and success is reaching the reset set.
    Reset,
}
