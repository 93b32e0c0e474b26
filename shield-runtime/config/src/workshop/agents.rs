//! The agents and the success critic.

use shield_api::{Learner, Policy, Setup, Spaces};

use super::{Stream, Workshop};
use crate::experiment::{InputError, PluginChoice, Reset, ShieldConfig};
use shield_core::{controller::Controller, critic::Critic};

impl Workshop<'_> {
    /// Makes the learner at `path`.
    ///
    /// # Errors
    /// It is missing or refuses its configuration.
    pub fn learner(
        &self,
        path: &str,
        choice: &PluginChoice,
        setup: &Setup,
    ) -> Result<Box<dyn Learner>, InputError> {
        let learner = self.registry.learner(&self.selection(choice), choice.config.get_ron(), setup);
        Ok(Box::new(learner.map_err(|error| self.input_error(path, error))?))
    }

    /// Makes the policy at `path`, in a process of its own if that is chosen.
    ///
    /// # Errors
    /// It is missing or refuses its configuration, or its process does not start.
    pub fn policy(
        &self,
        path: &str,
        choice: &PluginChoice,
        setup: &Setup,
    ) -> Result<Box<dyn Policy>, InputError> {
        let (selection, config) = (self.selection(choice), choice.config.get_ron());
        let policy: Result<Box<dyn Policy>, _> = match choice.isolation() {
            None => self.registry.policy(&selection, config, setup).map(|policy| Box::new(policy) as _),
            Some(isolation) => self
                .registry
                .isolated_policy(&selection, config, setup, isolation)
                .map(|policy| Box::new(policy) as _),
        };
        policy.map_err(|error| self.input_error(path, error))
    }

    /// Makes the reset agent: a learner, or a [`Controller`] around a policy.
    ///
    /// # Errors
    /// As for [`policy`](Self::policy).
    pub fn reset_agent(&self, reset: &Reset, spaces: &Spaces) -> Result<Box<dyn Learner>, InputError> {
        let setup = self.setup(Stream::Reset, spaces);
        match reset {
            Reset::Learner(choice) => self.learner("reset", choice, &setup),
            Reset::Policy(choice) => Ok(Box::new(Controller::new(self.policy("reset", choice, &setup)?))),
        }
    }

    /// Makes the success critic, if there is one.
    ///
    /// # Errors
    /// It is missing or refuses its configuration.
    pub fn success_critic(
        &self,
        config: &ShieldConfig,
        batch: usize,
        spaces: &Spaces,
    ) -> Result<Option<Critic>, InputError> {
        let Some(choice) = config.critic() else { return Ok(None) };
        let setup = self.setup(Stream::Success, spaces);
        let critic = self.registry.success_critic(&self.selection(choice), choice.config.get_ron(), &setup);
        let critic = critic.map_err(|error| self.input_error("shield.success_critic", error))?;
        let sampler = self.generator(Stream::SuccessBatches);
        Ok(Some(Critic::new(Box::new(critic), batch, spaces, sampler)))
    }
}
