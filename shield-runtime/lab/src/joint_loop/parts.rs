//! What a run of the joint loop is made of.

use rand_pcg::Pcg64;

use crate::evaluation::Evaluator;
use shield_core::{
    cycle::{CycleParts, CycleSettings},
    settings::{Mode, RecordConfig},
    world::World,
};

/// Settings of the loop, as the experiment gives them.
#[derive(Debug, Clone)]
pub struct LoopSettings {
    /// Who acts, when the environment is reset, and what is learned. Episodes have the environment's length.
    pub cycle: CycleSettings,
    /// Starts that the reset tasks are shown before the first step.
    pub calibration_resets: u32,
    /// Environment steps of the run, both phases.
    pub steps: u64,
    /// Which decisions the observer hears of.
    pub record: RecordConfig,
    /// Steps between two evaluations.
    pub evaluate_every: Option<u64>,
    /// Steps between two checkpoints; `None` keeps none.
    pub checkpoint_every: Option<u64>,
}

impl LoopSettings {
    /// The named start to which hard resets of the mode lead; `None` is the usual one.
    pub(super) fn start(&self) -> Option<&str> {
        match &self.cycle.mode {
            Mode::ResetOnly { start } => start.as_deref(),
            Mode::Shielded | Mode::StatusQuo | Mode::ForwardOnly => None,
        }
    }
}

/// What a loop is made of before its first step.
pub struct LoopParts {
    /// When it does what.
    pub settings: LoopSettings,
    /// Environment and reset task.
    pub world: World,
    /// Both agents, what decides, and what they learn from.
    pub agents: CycleParts,
    /// Evaluates in a second instance of the environment.
    pub evaluator: Option<Evaluator>,
    /// Draws the seeds of hard resets.
    pub resets: Pcg64,
}
