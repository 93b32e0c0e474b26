//! The environment as the loop sees it: with the reset task applied, and every number checked.

use std::sync::{
    Arc,
    atomic::{AtomicBool, Ordering},
};

use serde::{Deserialize, Serialize};
use shield_api::{
    Environment, EnvironmentSpec, Error, Frame, ResetKind, ResetTask, Result, StepOutcome, check_finite,
    check_length,
};

use crate::plugin_state::PluginState;

/// Set when a failed step has put a new environment in the place of the old one. The world that reads it clears it.
pub type RestartFlag = Arc<AtomicBool>;

/// The state of a [`World`].
#[derive(Serialize, Deserialize)]
pub struct WorldState {
    /// The environment's.
    pub environment: PluginState,
    /// The reset task's, where there is one.
    pub reset_task: Option<PluginState>,
    observation: Vec<f32>,
}

/// An environment, the reset task that may replace its own, and the state in which it is.
pub struct World<E: ?Sized = dyn Environment> {
    environment: Box<E>,
    reset_task: Option<Box<dyn ResetTask>>,
    spec: EnvironmentSpec,
    reset_kinds: Vec<ResetKind>,
    observation: Vec<f32>,
    next_observation: Vec<f32>,
    restarts: Option<RestartFlag>,
}

/// What became of a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Stepped {
    /// It was made.
    Made(StepOutcome),
    /// The environment's process failed, and another took its place: there is no next observation, and a hard reset must follow.
    Lost,
}

impl World {
    /// Puts a reset task around any environment.
    ///
    /// # Errors
    /// Impossible spaces, or neither the environment nor a task says what "reset" means.
    pub fn new(environment: Box<dyn Environment>, reset_task: Option<Box<dyn ResetTask>>) -> Result<Self> {
        Self::around(environment, reset_task)
    }

    /// Width and height of the environment's picture, as it chooses them.
    pub fn frame_size(&self) -> [usize; 2] {
        self.environment.frame_size()
    }

    /// Draws the environment.
    ///
    /// # Errors
    /// It cannot be drawn.
    pub fn render(&mut self, frame: &mut Frame<'_>) -> Result<()> {
        self.environment.render(frame)
    }
}

impl<E: Environment + ?Sized> World<E> {
    /// Puts a reset task around an environment.
    ///
    /// # Errors
    /// Impossible spaces, or neither the environment nor a task says what "reset" means.
    pub fn around(environment: Box<E>, reset_task: Option<Box<dyn ResetTask>>) -> Result<Self> {
        let spec = environment.spec();
        spec.spaces.observation.validate("observation")?;
        spec.spaces.action.validate("action")?;
        if spec.episode_length == 0 {
            return Err(Error::failed("the environment's episodes have no steps"));
        }
        if reset_task.is_none() && !spec.brings_reset_reward {
            return Err(Error::failed(
                "neither the environment nor the experiment says what \"reset\" means: name a `reset_task`, for example \
                 Some(plugin: \"near-start\")",
            ));
        }
        let reset_kinds = environment.reset_kinds();
        for (index, ResetKind { name, cost }) in reset_kinds.iter().enumerate() {
            if reset_kinds[..index].iter().any(|kind| kind.name == *name) {
                return Err(Error::failed(format!("the environment names the hard reset {name:?} twice")));
            }
            let is_valid = cost.is_finite() && *cost >= 0.0;
            if !is_valid {
                return Err(Error::failed(format!(
                    "the environment's hard reset {name:?} costs {cost}; a cost must be finite and not negative"
                )));
            }
        }
        let observation = vec![0.0; spec.spaces.observation_len()];
        let next_observation = observation.clone();
        Ok(Self { environment, reset_task, spec, reset_kinds, observation, next_observation, restarts: None })
    }

    /// Tells this world of the flag that its environment sets when a failed step has put a new one in its place.
    #[must_use]
    pub fn restarted_by(mut self, flag: Option<RestartFlag>) -> Self {
        self.restarts = flag;
        self
    }

    /// What the environment is.
    pub fn spec(&self) -> &EnvironmentSpec {
        &self.spec
    }

    /// The present observation.
    pub fn observation(&self) -> &[f32] {
        &self.observation
    }

    /// The observation after the step that [`advance`](Self::advance) has not yet made the present.
    pub fn next_observation(&self) -> &[f32] {
        &self.next_observation
    }

    /// Puts the environment into a state that it had saved, in which `observation` was seen. The reset task is not told.
    ///
    /// # Errors
    /// The environment refuses the state, or the observation has another length.
    pub fn restore_environment(&mut self, state: &[u8], observation: &[f32]) -> Result<()> {
        check_length("the saved observation", observation, self.observation.len())?;
        self.environment.load(state)?;
        self.observation.copy_from_slice(observation);
        Ok(())
    }

    /// Appends the environment's state.
    ///
    /// # Errors
    /// It cannot be saved.
    pub fn save_environment(&self, bytes: &mut Vec<u8>) -> Result<()> {
        self.environment.save(bytes)
    }

    /// Names of the environment's other starts.
    pub fn starts(&self) -> Vec<String> {
        self.environment.starts()
    }

    /// The environment's kinds of hard resets; empty where all are alike.
    pub fn reset_kinds(&self) -> &[ResetKind] {
        &self.reset_kinds
    }

    /// The kind of a hard reset from the present state, as an index into [`reset_kinds`](Self::reset_kinds), and its cost; 1 where all are alike.
    ///
    /// # Errors
    /// The environment cannot tell.
    pub fn hard_reset_due(&self) -> Result<(Option<usize>, f64)> {
        if self.reset_kinds.is_empty() {
            return Ok((None, 1.0));
        }
        let kind = self.environment.reset_kind()?;
        let Some(ResetKind { cost, .. }) = self.reset_kinds.get(kind) else {
            let known = self.reset_kinds.len();
            let message = format!("the environment names the hard reset {kind}, but has {known} kinds");
            return Err(Error::failed(message));
        };
        Ok((Some(kind), *cost))
    }

    /// A hard reset, to the usual start or to a named one.
    ///
    /// # Errors
    /// The environment could not be reset, or its observation is not finite.
    pub fn hard_reset(&mut self, start: Option<&str>, seed: u64) -> Result<()> {
        match start {
            None => self.environment.reset(seed, &mut self.observation)?,
            Some(start) => self.environment.reset_to(start, seed, &mut self.observation)?,
        }
        check_finite("the observation after a reset", &self.observation, self.observation.len())?;
        match &mut self.reset_task {
            None => Ok(()),
            Some(task) => task.observe_start(&self.observation),
        }
    }

    /// The task that says what "reset" means; `None` where the environment says it itself.
    pub fn reset_task(&mut self) -> Option<&mut (dyn ResetTask + 'static)> {
        self.reset_task.as_deref_mut()
    }

    /// Executes an action of the action space; refuses every other, whoever proposed it.
    ///
    /// # Errors
    /// The action is not one. The environment or the reset task failed, or gave a number that is not finite.
    pub fn step(&mut self, action: &[f32]) -> Result<Stepped> {
        self.spec.spaces.action.check_action(action)?;
        let mut outcome = match self.environment.step(action, &mut self.next_observation) {
            Ok(outcome) => outcome,
            Err(_) if self.was_restarted() => return Ok(Stepped::Lost),
            Err(error) => return Err(error),
        };
        check_finite("the observation after a step", &self.next_observation, self.observation.len())?;
        if let Some(task) = &mut self.reset_task {
            let signal = task.evaluate(&self.observation, action, &self.next_observation)?;
            outcome.reset_reward = signal.reward;
            outcome.in_reset_set = signal.in_reset_set;
        }
        check_finite("the rewards of a step", &[outcome.forward_reward, outcome.reset_reward], 2)?;
        Ok(Stepped::Made(outcome))
    }

    fn was_restarted(&self) -> bool {
        self.restarts.as_ref().is_some_and(|flag| flag.swap(false, Ordering::Relaxed))
    }

    /// The state between two steps.
    pub fn save(&self) -> Result<WorldState> {
        Ok(WorldState {
            environment: PluginState::of(&*self.environment)?,
            reset_task: self.save_reset_task()?,
            observation: self.observation.clone(),
        })
    }

    /// Becomes the world that was saved.
    pub fn restore(&mut self, state: &WorldState) -> Result<()> {
        check_length("the saved observation", &state.observation, self.observation.len())?;
        state.environment.restore(&mut *self.environment)?;
        self.restore_reset_task(state.reset_task.as_ref())?;
        self.observation.copy_from_slice(&state.observation);
        Ok(())
    }

    /// What the reset task has learned of the starts; a hard reset leaves it as it is.
    pub fn save_reset_task(&self) -> Result<Option<PluginState>> {
        self.reset_task.as_ref().map(|task| PluginState::of(&**task)).transpose()
    }

    /// Gives the reset task what it had learned of the starts.
    ///
    /// # Errors
    /// The plugin refuses its state.
    pub fn restore_reset_task(&mut self, state: Option<&PluginState>) -> Result<()> {
        match (&mut self.reset_task, state) {
            (Some(task), Some(state)) => state.restore(&mut **task),
            _ => Ok(()),
        }
    }

    /// Makes the observation after the last step the present one.
    pub fn advance(&mut self) {
        std::mem::swap(&mut self.observation, &mut self.next_observation);
    }
}
