//! An environment and a learner that the loop and the camera share. Both pass every call on.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use shield_api::{
    ActMode, Batch, Checkpoint, Environment, EnvironmentSpec, Frame, Learner, LearnerInfo, ResetKind, Result,
    StepOutcome,
};

/// An environment that also remembers what was last seen and done in it.
#[derive(Clone)]
pub struct SharedEnvironment(Arc<Mutex<Watched>>);

struct Watched {
    environment: Box<dyn Environment>,
    /// The present observation.
    observation: Vec<f32>,
    /// The last action and the observation at which it was taken; empty after a hard reset.
    last: (Vec<f32>, Vec<f32>),
}

fn lock<T>(shared: &Mutex<T>) -> MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

impl SharedEnvironment {
    /// Takes an environment over.
    pub fn new(environment: Box<dyn Environment>) -> Self {
        Self(Arc::new(Mutex::new(Watched { environment, observation: Vec::new(), last: Default::default() })))
    }

    /// The present observation; empty before the first reset.
    pub fn observation(&self) -> Vec<f32> {
        lock(&self.0).observation.clone()
    }

    /// The last action, behind the observation at which it was taken; both empty after a hard reset.
    pub fn last_decision(&self) -> (Vec<f32>, Vec<f32>) {
        lock(&self.0).last.clone()
    }
}

impl Watched {
    fn begin(&mut self, observation: &[f32]) {
        self.observation = observation.to_vec();
        self.last = Default::default();
    }
}

impl Checkpoint for SharedEnvironment {
    fn save(&self, bytes: &mut Vec<u8>) -> Result<()> {
        lock(&self.0).environment.save(bytes)
    }

    fn load(&mut self, bytes: &[u8]) -> Result<()> {
        lock(&self.0).environment.load(bytes)
    }
}

impl Environment for SharedEnvironment {
    fn spec(&self) -> EnvironmentSpec {
        lock(&self.0).environment.spec()
    }

    fn reset(&mut self, seed: u64, observation: &mut [f32]) -> Result<()> {
        let mut watched = lock(&self.0);
        watched.environment.reset(seed, observation)?;
        watched.begin(observation);
        Ok(())
    }

    fn step(&mut self, action: &[f32], observation: &mut [f32]) -> Result<StepOutcome> {
        let mut watched = lock(&self.0);
        let outcome = watched.environment.step(action, observation)?;
        let before = std::mem::replace(&mut watched.observation, observation.to_vec());
        watched.last = (before, action.to_vec());
        Ok(outcome)
    }

    fn starts(&self) -> Vec<String> {
        lock(&self.0).environment.starts()
    }

    fn reset_to(&mut self, start: &str, seed: u64, observation: &mut [f32]) -> Result<()> {
        let mut watched = lock(&self.0);
        watched.environment.reset_to(start, seed, observation)?;
        watched.begin(observation);
        Ok(())
    }

    fn reset_kinds(&self) -> Vec<ResetKind> {
        lock(&self.0).environment.reset_kinds()
    }

    fn reset_kind(&self) -> Result<usize> {
        lock(&self.0).environment.reset_kind()
    }

    fn frame_size(&self) -> [usize; 2] {
        lock(&self.0).environment.frame_size()
    }

    fn render(&mut self, frame: &mut Frame<'_>) -> Result<()> {
        lock(&self.0).environment.render(frame)
    }
}

/// A learner whose values can be asked from outside the loop.
#[derive(Clone)]
pub struct SharedLearner(Arc<Mutex<Box<dyn Learner>>>);

impl SharedLearner {
    /// Takes a learner over.
    pub fn new(learner: Box<dyn Learner>) -> Self {
        Self(Arc::new(Mutex::new(learner)))
    }
}

impl Checkpoint for SharedLearner {
    fn save(&self, bytes: &mut Vec<u8>) -> Result<()> {
        lock(&self.0).save(bytes)
    }

    fn load(&mut self, bytes: &[u8]) -> Result<()> {
        lock(&self.0).load(bytes)
    }
}

impl Learner for SharedLearner {
    fn info(&self) -> LearnerInfo {
        lock(&self.0).info()
    }

    fn act(&mut self, observation: &[f32], mode: ActMode, action: &mut [f32]) -> Result<()> {
        lock(&self.0).act(observation, mode, action)
    }

    fn q_values(&mut self, observation: &[f32], action: &[f32], values: &mut [f32]) -> Result<()> {
        lock(&self.0).q_values(observation, action, values)
    }

    fn q_gradients(
        &mut self,
        observation: &[f32],
        action: &[f32],
        values: &mut [f32],
        gradients: &mut [f32],
    ) -> Result<()> {
        lock(&self.0).q_gradients(observation, action, values, gradients)
    }

    fn weights(&self, bytes: &mut Vec<u8>) -> Result<()> {
        lock(&self.0).weights(bytes)
    }

    fn onnx(&self, bytes: &mut Vec<u8>) -> Result<()> {
        lock(&self.0).onnx(bytes)
    }

    fn update(&mut self, batch: &Batch<'_>) -> Result<()> {
        lock(&self.0).update(batch)
    }
}
