//! A loaded policy.

use shield_api::{
    Policy, Result,
    abi::{Floats, PolicyTable},
};

use super::handle::{Handle, checkpoint, wrapper};

wrapper! {
    /// A policy behind the binary interface.
    LoadedPolicy, PolicyTable
}

impl Policy for LoadedPolicy {
    fn act(&mut self, observation: &[f32], action: &mut [f32]) -> Result<()> {
        self.handle.require_step(&self.spaces, observation, action)?;
        action.fill(f32::NAN);
        // SAFETY: the instance is of this table; the slices are as long as said and live for the call.
        self.handle.call(|instance| unsafe {
            (self.table.act)(instance, Floats::new(observation), action.as_mut_ptr(), action.len())
        })?;
        self.handle.require_finite("act", "action", action)
    }
}
