//! A loaded reset task.

use shield_api::{
    ResetSignal, ResetTask, Result,
    abi::{Floats, ResetSignalView, ResetTaskTable},
};

use super::handle::{Handle, checkpoint, wrapper};

wrapper! {
    /// A reset task behind the binary interface.
    LoadedResetTask, ResetTaskTable
}

impl ResetTask for LoadedResetTask {
    fn evaluate(
        &mut self,
        observation: &[f32],
        action: &[f32],
        next_observation: &[f32],
    ) -> Result<ResetSignal> {
        self.handle.require_step(&self.spaces, observation, action)?;
        self.handle.require_length("next_observation", next_observation, self.spaces.observation_len())?;
        let mut view = ResetSignalView { reward: f32::NAN, in_reset_set: 0 };
        // SAFETY: the instance is of this table; the slices are as long as said and live for the call.
        self.handle.call(|instance| unsafe {
            let (now, then) = (Floats::new(observation), Floats::new(next_observation));
            (self.table.evaluate)(instance, now, Floats::new(action), then, &mut view)
        })?;
        self.handle.require_finite("evaluate", "reward", &[view.reward])?;
        match view.in_reset_set {
            0 | 1 => Ok(ResetSignal { reward: view.reward, in_reset_set: view.in_reset_set == 1 }),
            other => Err(self.handle.broken(format!("`evaluate` gave {other} for in_reset_set, not 0 or 1"))),
        }
    }

    fn observe_start(&mut self, observation: &[f32]) -> Result<()> {
        self.handle.require_length("observation", observation, self.spaces.observation_len())?;
        // SAFETY: the instance is of this table; the slice lives for the call.
        self.handle.call(|instance| unsafe { (self.table.observe_start)(instance, Floats::new(observation)) })
    }
}
