//! Reset tasks: what "undone" means, for environments that do not say it themselves.

use crate::{Checkpoint, Result};

/// How well a transition leads back to the start.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ResetSignal {
    /// r_r of the paper: large where initial states are likely. Within [0, 1], as [`StepOutcome::reset_reward`](crate::StepOutcome) is.
    pub reward: f32,
    /// The next state is in S_reset.
    pub in_reset_set: bool,
}

/// The reset reward and the reset set, from observations alone. Where an experiment names one, it replaces what the
/// environment itself says, so that nobody edits an environment to shield it.
///
/// ```standalone_crate
/// use shield_api::*;
///
/// shield_api::config! {
///     /// Reset means: the first observation is small.
///     pub struct UprightConfig {
///         /// The largest angle that counts as reset, in radians.
///         tolerance: f32 = 0.1,
///     }
/// }
///
/// struct Upright(f32);
///
/// impl Checkpoint for Upright {}
///
/// impl Plugin for Upright {
///     type Config = UprightConfig;
///
///     fn create(config: UprightConfig, _setup: &Setup) -> Result<Self> {
///         Ok(Self(config.tolerance))
///     }
/// }
///
/// impl ResetTask for Upright {
///     fn evaluate(&mut self, _observation: &[f32], _action: &[f32], next_observation: &[f32]) -> Result<ResetSignal> {
///         let angle = next_observation[0].abs();
///         Ok(ResetSignal { reward: (1.0 - angle).max(0.0), in_reset_set: angle < self.0 })
///     }
/// }
///
/// shield_api::export_plugin! {
///     reset_task "acme/upright" => Upright { description: "Reset is being upright", deterministic: true }
/// }
/// # assert!(Upright(0.1).evaluate(&[1.0], &[0.0], &[0.05]).unwrap().in_reset_set);
/// ```
#[allow(unused_variables, reason = "the defaults name their arguments for whoever writes others")]
pub trait ResetTask: Checkpoint {
    /// The reset reward of a transition, and whether it ends in the reset set. Allocates nothing.
    ///
    /// # Errors
    /// A wrong length, or a value that is not finite.
    fn evaluate(
        &mut self,
        observation: &[f32],
        action: &[f32],
        next_observation: &[f32],
    ) -> Result<ResetSignal>;

    /// The observation after each hard reset, for tasks that learn what a start looks like.
    ///
    /// # Errors
    /// A wrong length, or a value that is not finite.
    fn observe_start(&mut self, observation: &[f32]) -> Result<()> {
        Ok(())
    }
}
