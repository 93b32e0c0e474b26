//! A loaded policy.

use shield_api::{
    Policy, Result, Setup, Spaces,
    abi::{Floats, PolicyTable},
};

use super::handle::{Handle, checkpoint, spaces};
use crate::plugin::PluginError;

/// A policy behind the binary interface.
#[derive(Debug)]
pub struct LoadedPolicy {
    handle: Handle,
    table: &'static PolicyTable,
    spaces: Spaces,
}

checkpoint!(LoadedPolicy);

impl LoadedPolicy {
    pub(in crate::plugin) fn create(
        id: &str,
        table: &'static PolicyTable,
        config: &str,
        setup: &Setup,
    ) -> Result<Self, PluginError> {
        let spaces = spaces(id, setup)?;
        let handle = Handle::create(id, &table.life, config, setup)?;
        Ok(Self { handle, table, spaces })
    }
}

impl Policy for LoadedPolicy {
    fn act(&mut self, observation: &[f32], action: &mut [f32]) -> Result<()> {
        self.handle.require_length("observation", observation, self.spaces.observation_len())?;
        self.handle.require_length("action", action, self.spaces.action_len())?;
        action.fill(f32::NAN);
        // SAFETY: the instance is of this table; the slices are as long as said and live for the call.
        self.handle.call(|instance| unsafe {
            (self.table.act)(instance, Floats::new(observation), action.as_mut_ptr(), action.len())
        })?;
        self.handle.require_finite("act", "action", action)
    }
}
