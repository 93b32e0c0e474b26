//! Memory that the learner keeps between calls, so that none is allocated after the first.

use actor_critic::{ActionScale, Normaliser};
use shield_api::Batch;

/// A batch as the networks see it, and the policy's actions for it. Row-major; exactly as long as the batch.
#[derive(Debug, Default)]
pub(crate) struct Buffers {
    pub(crate) observations: Vec<f32>,
    pub(crate) next_observations: Vec<f32>,
    /// Executed actions in [-1, 1].
    pub(crate) actions: Vec<f32>,
    /// π(s).
    pub(crate) policy_actions: Vec<f32>,
    /// π'(s').
    pub(crate) next_actions: Vec<f32>,
    /// One observation and one action in [-1, 1], for everything that is not an update.
    pub(crate) observation: Vec<f32>,
    pub(crate) action: Vec<f32>,
}

impl Buffers {
    pub(crate) fn take_batch(
        &mut self,
        batch: &Batch<'_>,
        scale: &ActionScale,
        normaliser: Option<&Normaliser>,
    ) {
        take_observations(&mut self.observations, batch.observations, normaliser);
        take_observations(&mut self.next_observations, batch.next_observations, normaliser);
        for actions in [&mut self.actions, &mut self.policy_actions, &mut self.next_actions] {
            actions.resize(batch.actions.len(), 0.0);
        }
        scale.to_unit(batch.actions, &mut self.actions);
    }

    pub(crate) fn take_observation(&mut self, observation: &[f32], normaliser: Option<&Normaliser>) {
        take_observations(&mut self.observation, observation, normaliser);
    }

    pub(crate) fn take_action(&mut self, action: &[f32], scale: &ActionScale) {
        self.action.resize(action.len(), 0.0);
        scale.to_unit(action, &mut self.action);
    }
}

fn take_observations(destination: &mut Vec<f32>, rows: &[f32], normaliser: Option<&Normaliser>) {
    destination.resize(rows.len(), 0.0);
    match normaliser {
        Some(normaliser) => normaliser.normalise(rows, destination),
        None => destination.copy_from_slice(rows),
    }
}

/// What one critic needs and returns in an update.
#[derive(Debug, Clone, Default)]
pub(crate) struct CriticStep {
    /// Values to learn.
    pub(crate) targets: Vec<f32>,
    /// The critic's column of the bootstrap masks.
    pub(crate) weights: Vec<f32>,
    /// ∂Q/∂a at the policy's actions.
    pub(crate) action_gradients: Vec<f32>,
    pub(crate) loss: f32,
    pub(crate) mean_value: f32,
}

impl CriticStep {
    pub(crate) fn resize(&mut self, size: usize, action_len: usize) {
        self.targets.resize(size, 0.0);
        self.weights.resize(size, 0.0);
        self.action_gradients.resize(size * action_len, 0.0);
    }
}

/// One critic's value of one (s, a), and its gradient with respect to the action.
#[derive(Debug, Clone)]
pub(crate) struct Valuation {
    pub(crate) value: f32,
    pub(crate) gradient: Vec<f32>,
}

impl Valuation {
    pub(crate) fn new(action_len: usize) -> Self {
        Self { value: 0.0, gradient: vec![0.0; action_len] }
    }
}
