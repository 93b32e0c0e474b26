//! Random observations, actions and batches of given spaces.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use shield_api::{Space, Spaces};

use crate::environment_check::{Guarded, random_action};

/// Where what a plugin is asked comes from: the same seed asks the same.
pub struct Draw {
    pub spaces: Spaces,
    rng: Pcg64,
}

/// The arguments of one update.
pub struct DrawnBatch {
    pub size: usize,
    pub observations: Guarded,
    pub actions: Guarded,
    pub rewards: Guarded,
    pub next_observations: Guarded,
    pub continuations: Guarded,
    pub masks: Guarded,
    /// Of attempts, for a success critic; their weights are the rewards.
    pub outcomes: Guarded,
}

impl Draw {
    pub fn new(spaces: &Spaces, seed: u64) -> Self {
        Self { spaces: spaces.clone(), rng: Pcg64::seed_from_u64(seed) }
    }

    pub fn observation(&mut self) -> Vec<f32> {
        match self.spaces.observation {
            Space::Box { .. } => random_action(&self.spaces.observation, &mut self.rng),
            Space::Discrete { n } => {
                let mut one_hot = vec![0.0; n];
                one_hot[self.rng.random_range(0..n)] = 1.0;
                one_hot
            }
        }
    }

    pub fn action(&mut self) -> Vec<f32> {
        random_action(&self.spaces.action, &mut self.rng)
    }

    /// `count` values of an ensemble.
    pub fn values(&mut self, count: usize) -> Vec<f32> {
        (0..count).map(|_| self.rng.random_range(0.0..100.0)).collect()
    }

    /// `count` undo probabilities of an ensemble.
    pub fn probabilities(&mut self, count: usize) -> Vec<f32> {
        (0..count).map(|_| self.rng.random_range(0.0..=1.0)).collect()
    }

    pub fn batch(&mut self, size: usize, members: usize) -> DrawnBatch {
        let observations: Vec<f32> = (0..size).flat_map(|_| self.observation()).collect();
        let actions: Vec<f32> = (0..size).flat_map(|_| self.action()).collect();
        let next: Vec<f32> = (0..size).flat_map(|_| self.observation()).collect();
        let rewards: Vec<f32> = (0..size).map(|_| self.rng.random_range(0.0..1.0)).collect();
        let mut ones = |count: usize| -> Vec<f32> {
            (0..count).map(|_| if self.rng.random_range(0..10) > 0 { 1.0 } else { 0.0 }).collect()
        };
        DrawnBatch {
            size,
            continuations: Guarded::input("continuations", &ones(size)),
            masks: Guarded::input("masks", &ones(size * members)),
            outcomes: Guarded::input("outcomes", &ones(size)),
            observations: Guarded::input("observations", &observations),
            actions: Guarded::input("actions", &actions),
            rewards: Guarded::input("rewards", &rewards),
            next_observations: Guarded::input("next observations", &next),
        }
    }
}

impl DrawnBatch {
    pub fn view(&self) -> shield_api::Batch<'_> {
        shield_api::Batch {
            size: self.size,
            observations: self.observations.slice(),
            actions: self.actions.slice(),
            rewards: self.rewards.slice(),
            next_observations: self.next_observations.slice(),
            continuations: self.continuations.slice(),
            masks: self.masks.slice(),
        }
    }

    /// The same as a success critic is given it: what was rewarded is how much the outcome counts.
    pub fn attempts(&self) -> shield_api::AttemptBatch<'_> {
        shield_api::AttemptBatch {
            size: self.size,
            observations: self.observations.slice(),
            actions: self.actions.slice(),
            next_observations: self.next_observations.slice(),
            next_actions: self.actions.slice(),
            successes: self.outcomes.slice(),
            continuations: self.continuations.slice(),
            outcomes: self.outcomes.slice(),
            outcome_weights: self.rewards.slice(),
            masks: self.masks.slice(),
        }
    }

    /// Its parts, to put something wrong into one of them.
    pub fn parts_mut(&mut self) -> [&mut Guarded; 6] {
        [
            &mut self.observations,
            &mut self.actions,
            &mut self.rewards,
            &mut self.next_observations,
            &mut self.continuations,
            &mut self.outcomes,
        ]
    }

    pub fn checked(&self) -> Result<(), String> {
        let parts =
            [&self.observations, &self.actions, &self.rewards, &self.next_observations, &self.continuations];
        parts.into_iter().chain([&self.masks, &self.outcomes]).try_for_each(|part| part.checked().map(|_| ()))
    }
}
