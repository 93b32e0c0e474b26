//! What a run keeps, beside what it learns from: checkpoints, decisions, evaluations.

use serde::{Deserialize, Serialize};

use super::{EvaluatedAgent, one};

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
    /// The forward agent of a mode with a shield is evaluated with it, and again from the same seeds without it. `false`: only without.
    #[serde(default = "yes")]
    pub shielded: bool,
    /// An evaluation has succeeded if at least this share of its episodes did; three in a row solve the task.
    #[serde(default = "one")]
    pub solved_at: f64,
}

fn yes() -> bool {
    true
}

fn ten() -> u32 {
    10
}
