//! A policy in a process of its own.

use std::cell::RefCell;

use shield_api::{Policy, Result, Setup, Spaces, check_finite, check_length};

use super::{
    Isolation,
    environment::recovered,
    host::{Isolated, checkpoint},
    protocol::{self, IsolatedKind, Operation},
};
use crate::plugin::{PluginError, Selection, ffi::spaces};

/// A policy behind shared memory.
#[derive(Debug)]
pub struct IsolatedPolicy {
    isolated: RefCell<Isolated>,
    spaces: Spaces,
}

impl IsolatedPolicy {
    pub(in crate::plugin) fn create(
        choice: &Selection,
        config: &str,
        setup: &Setup,
        isolation: Isolation,
    ) -> Result<Self, PluginError> {
        let spaces = spaces(&choice.id, setup)?;
        let isolated = Isolated::start(IsolatedKind::Policy, choice, config, setup, isolation)?;
        Ok(Self { isolated: isolated.into(), spaces })
    }
}

checkpoint!(IsolatedPolicy);

impl Policy for IsolatedPolicy {
    fn act(&mut self, observation: &[f32], action: &mut [f32]) -> Result<()> {
        check_length("observation", observation, self.spaces.observation_len())?;
        check_length("action", action, self.spaces.action_len())?;
        let isolated = self.isolated.get_mut();
        let offset = protocol::NUMBERS + size_of_val(action);
        loop {
            isolated.memory().write(offset, observation);
            match isolated.call(Operation::Act) {
                Ok(()) => break,
                Err(error) => recovered(isolated, error)?,
            }
        }
        isolated.memory().read(protocol::NUMBERS, action);
        check_finite("the isolated policy's action", action, action.len())
    }
}
