//! Policies: finished controllers that do not learn here.

use crate::{Checkpoint, Result};

/// An existing policy: it acts, and nothing else. Here a trained network, a hand-written controller or a planner enters.
///
/// ```standalone_crate
/// use shield_api::*;
///
/// shield_api::config! {
///     /// Always pushes equally hard.
///     pub struct ConstantConfig {
///         /// The value of every dimension of the action.
///         value: f32 = 1.0,
///     }
/// }
///
/// struct Constant(f32);
///
/// impl Checkpoint for Constant {}
///
/// impl Plugin for Constant {
///     type Config = ConstantConfig;
///
///     fn create(config: ConstantConfig, _setup: &Setup) -> Result<Self> {
///         Ok(Self(config.value))
///     }
/// }
///
/// impl Policy for Constant {
///     fn act(&mut self, _observation: &[f32], action: &mut [f32]) -> Result<()> {
///         action.fill(self.0);
///         Ok(())
///     }
/// }
///
/// shield_api::export_plugin! {
///     policy "acme/constant" => Constant { description: "The same action for ever", deterministic: true }
/// }
/// # let mut policy = Constant(0.5);
/// # let mut action = [0.0];
/// # policy.act(&[0.0], &mut action).unwrap();
/// # assert_eq!(action, [0.5]);
/// ```
pub trait Policy: Checkpoint {
    /// Writes an action for `observation`. The shield checks it: an action outside the space is not executed.
    ///
    /// # Errors
    /// A wrong length, or a value that is not finite.
    fn act(&mut self, observation: &[f32], action: &mut [f32]) -> Result<()>;
}
