//! The rows of the tables that only a run has.

use serde::Serialize;

use shield_decisions::tables::Row;

/// `evaluations.csv`.
#[derive(Serialize, Default)]
pub(super) struct EvaluationRow {
    pub step: u64,
    pub mean_return: f64,
    pub success_rate: f64,
    pub irreversible_entries: u64,
    pub steps: u64,
    pub lifetime_return: f64,
    pub hard_resets: u64,
    pub mean_return_without_shield: Option<f64>,
    pub success_rate_without_shield: Option<f64>,
    pub irreversible_entries_without_shield: Option<u64>,
    pub steps_without_shield: Option<u64>,
}

/// `timings.csv`.
#[derive(Serialize, Default)]
pub(super) struct TimingRow {
    pub step: u64,
    pub wall_seconds: f64,
}

impl Row for EvaluationRow {
    const FILE: &'static str = "evaluations.csv";
}
impl Row for TimingRow {
    const FILE: &'static str = "timings.csv";
}
