//! What the tests of success critics share. Each plugin's own tests include this file, because a plugin is a cdylib and cannot be linked
//! into another test.

use shield_api::{AttemptBatch, Checkpoint};

/// The columns of a batch.
#[derive(Clone, Default)]
pub struct Attempts {
    pub size: usize,
    pub observations: Vec<f32>,
    pub actions: Vec<f32>,
    pub next_observations: Vec<f32>,
    pub next_actions: Vec<f32>,
    pub successes: Vec<f32>,
    pub continuations: Vec<f32>,
    pub outcomes: Vec<f32>,
    pub outcome_weights: Vec<f32>,
    pub masks: Vec<f32>,
}

impl Attempts {
    pub fn batch(&self) -> AttemptBatch<'_> {
        AttemptBatch {
            size: self.size,
            observations: &self.observations,
            actions: &self.actions,
            next_observations: &self.next_observations,
            next_actions: &self.next_actions,
            successes: &self.successes,
            continuations: &self.continuations,
            outcomes: &self.outcomes,
            outcome_weights: &self.outcome_weights,
            masks: &self.masks,
        }
    }
}

pub fn mean(values: &[f32]) -> f32 {
    values.iter().sum::<f32>() / values.len() as f32
}

/// The state of a critic.
pub fn saved(critic: &impl Checkpoint) -> Vec<u8> {
    let mut bytes = Vec::new();
    critic.save(&mut bytes).unwrap();
    bytes
}
