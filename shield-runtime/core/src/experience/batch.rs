//! Where a batch is gathered.

use shield_api::{Batch, Spaces};

/// Where a batch is gathered; reused for every update.
#[derive(Debug)]
pub struct BatchBuffers {
    pub(super) size: usize,
    pub(super) observations: Vec<f32>,
    pub(super) actions: Vec<f32>,
    pub(super) rewards: Vec<f32>,
    pub(super) next_observations: Vec<f32>,
    pub(super) continuations: Vec<f32>,
    pub(super) masks: Vec<f32>,
}

impl BatchBuffers {
    /// Room for `size` transitions and the masks of `members`, which stay 1 where the experience draws none.
    pub fn new(size: usize, spaces: &Spaces, members: usize) -> Self {
        Self {
            size,
            observations: vec![0.0; size * spaces.observation_len()],
            actions: vec![0.0; size * spaces.action_len()],
            rewards: vec![0.0; size],
            next_observations: vec![0.0; size * spaces.observation_len()],
            continuations: vec![0.0; size],
            masks: vec![1.0; size * members],
        }
    }

    /// Transitions per batch.
    pub fn size(&self) -> usize {
        self.size
    }

    pub(super) fn as_batch(&self) -> Batch<'_> {
        Batch {
            size: self.size,
            observations: &self.observations,
            actions: &self.actions,
            rewards: &self.rewards,
            next_observations: &self.next_observations,
            continuations: &self.continuations,
            masks: &self.masks,
        }
    }
}
