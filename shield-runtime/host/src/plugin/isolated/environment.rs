//! An environment in a process of its own.

use std::{
    cell::RefCell,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
};

use shield_api::{
    Environment, EnvironmentSpec, Error, ErrorKind, ResetKind, Result, Setup, StepOutcome, abi::StepView,
    check_length,
};

use super::{
    Isolation,
    host::{Isolated, checkpoint},
    protocol::{self, Created, IsolatedKind, Operation},
};
use crate::plugin::{PluginError, Selection};

/// An environment behind shared memory.
#[derive(Debug)]
pub struct IsolatedEnvironment {
    /// Saving a state leaves it as it is, but needs the channel.
    isolated: RefCell<Isolated>,
    spec: EnvironmentSpec,
    starts: Vec<String>,
    reset_kinds: Vec<ResetKind>,
    was_restarted: Arc<AtomicBool>,
}

impl IsolatedEnvironment {
    pub(in crate::plugin) fn create(
        choice: &Selection,
        config: &str,
        setup: &Setup,
        isolation: Isolation,
    ) -> Result<Self, PluginError> {
        let id = choice.id.as_str();
        let mut isolated = Isolated::start(IsolatedKind::Environment, choice, config, setup, isolation)?;
        let failed =
            |message: String| PluginError::Create { id: id.into(), kind: ErrorKind::Failed, message };
        let created: Created = ron::from_str(&protocol::read_text(isolated.memory()))
            .map_err(|error| failed(format!("its process describes it wrongly: {error}")))?;
        let Created { spaces, episode_length, brings_reset_reward, starts, reset_kinds } = created;
        let reset_kinds = reset_kinds.into_iter().map(|(name, cost)| ResetKind { name, cost }).collect();
        let spec = EnvironmentSpec { spaces: spaces.into(), episode_length, brings_reset_reward };
        let numbers = spec.spaces.observation_len().saturating_add(spec.spaces.action_len());
        if numbers > protocol::PIECE / size_of::<f32>() {
            return Err(failed(format!("its {numbers} numbers a step do not fit into the shared memory")));
        }
        Ok(Self { isolated: isolated.into(), spec, starts, reset_kinds, was_restarted: Arc::default() })
    }

    /// Set by a failed [`step`](Environment::step) where a new process has taken the place of the lost one: the world is gone, and
    /// a hard reset gives another. The reader clears it.
    pub fn was_restarted(&self) -> Arc<AtomicBool> {
        self.was_restarted.clone()
    }

    fn reset_by(
        &mut self,
        operation: Operation,
        start: &str,
        seed: u64,
        observation: &mut [f32],
    ) -> Result<()> {
        check_length("observation", observation, self.spec.spaces.observation_len())?;
        let isolated = self.isolated.get_mut();
        loop {
            protocol::write_text(isolated.memory(), start);
            isolated.memory().write(protocol::SEED, &[seed]);
            match isolated.call(operation) {
                Ok(()) => break,
                // A new world needs no other reset than this one.
                Err(error) => recovered(isolated, error)?,
            }
        }
        self.read_observation(observation);
        Ok(())
    }

    fn read_observation(&mut self, observation: &mut [f32]) {
        let offset = protocol::NUMBERS + size_of::<f32>() * self.spec.spaces.action_len();
        self.isolated.get_mut().memory().read(offset, observation);
    }
}

/// `Ok` if there is a new process; else the error that ended the old one.
pub(super) fn recovered(isolated: &mut Isolated, error: Error) -> Result<()> {
    match isolated.recover() {
        Ok(true) => {
            log::warn!("{error}; started again");
            Ok(())
        }
        Ok(false) => Err(error),
        Err(again) => Err(Error::failed(format!("{error}; started again, but: {again}"))),
    }
}

checkpoint!(IsolatedEnvironment);

impl Environment for IsolatedEnvironment {
    fn spec(&self) -> EnvironmentSpec {
        self.spec.clone()
    }

    fn reset(&mut self, seed: u64, observation: &mut [f32]) -> Result<()> {
        self.reset_by(Operation::Reset, "", seed, observation)
    }

    fn step(&mut self, action: &[f32], observation: &mut [f32]) -> Result<StepOutcome> {
        check_length("action", action, self.spec.spaces.action_len())?;
        check_length("observation", observation, self.spec.spaces.observation_len())?;
        let isolated = self.isolated.get_mut();
        isolated.memory().write(protocol::NUMBERS, action);
        if let Err(error) = isolated.call(Operation::Step) {
            let message = error.clone();
            recovered(isolated, error)?;
            self.was_restarted.store(true, Ordering::Relaxed);
            return Err(message);
        }
        self.read_observation(observation);
        let memory = self.isolated.get_mut().memory();
        let mut rewards = [0.0; 2];
        memory.read(protocol::REWARDS, &mut rewards);
        let [forward_reward, reset_reward] = rewards;
        let view = StepView { forward_reward, reset_reward, flags: memory.get(protocol::FLAGS) };
        StepOutcome::try_from(view)
            .map_err(|flags| Error::failed(format!("its process gave the unknown flags {flags:#x}")))
    }

    fn starts(&self) -> Vec<String> {
        self.starts.clone()
    }

    fn reset_to(&mut self, start: &str, seed: u64, observation: &mut [f32]) -> Result<()> {
        self.reset_by(Operation::ResetTo, start, seed, observation)
    }

    fn reset_kinds(&self) -> Vec<ResetKind> {
        self.reset_kinds.clone()
    }

    fn reset_kind(&self) -> Result<usize> {
        let mut isolated = self.isolated.borrow_mut();
        isolated.call(Operation::ResetKind)?;
        Ok(usize::try_from(isolated.memory().get::<u64>(protocol::STATE)).unwrap_or(usize::MAX))
    }
}
