//! Our side: the DDPG plugin with 20 critics 400-300 and the dimensions of the cheetah, through the binary interface.

use std::time::Instant;

use shield_api::{Batch, Learner, Setup, Space, Spaces};
use shield_runtime::plugin::{LoadedLearner, Registry, SearchPath, Selection, host};
use shield_tests::plugins_folder;

const CRITICS: usize = 20;
const OBSERVATION: usize = 18;
const ACTION: usize = 6;
const FIRST: usize = 400;
const SECOND: usize = 300;

/// A learner and a batch.
pub struct Ours {
    learner: LoadedLearner,
    size: usize,
    observations: Vec<f32>,
    actions: Vec<f32>,
    rewards: Vec<f32>,
    ones: Vec<f32>,
}

impl Ours {
    pub fn new(size: usize, threads: usize, config: &str) -> Self {
        let action = Space::uniform(ACTION, -1.0, 1.0);
        let spaces = Spaces { observation: Space::unbounded(OBSERVATION), action };
        let setup = Setup::with_spaces(0, threads, host(), spaces);
        let registry = Registry::scan(&SearchPath::new([plugins_folder()]));
        let learner = registry.learner(&Selection::new("ddpg"), config, &setup).expect("ddpg");
        let numbers = |length: usize| (0..length).map(|i| (i * 37 % 101) as f32 / 101.0).collect();
        Self {
            learner,
            size,
            observations: numbers(size * OBSERVATION),
            actions: numbers(size * ACTION),
            rewards: numbers(size),
            ones: vec![1.0; size * CRITICS],
        }
    }

    pub fn updates(&mut self, repeats: usize) -> Vec<f64> {
        let batch = Batch {
            size: self.size,
            observations: &self.observations,
            actions: &self.actions,
            rewards: &self.rewards,
            next_observations: &self.observations,
            continuations: &self.ones[..self.size],
            masks: &self.ones,
        };
        let learner = &mut self.learner;
        timed(repeats, || learner.update(&batch).expect("an update"))
    }

    pub fn valuations(&mut self, repeats: usize) -> Vec<f64> {
        let (observation, action) = (&self.observations[..OBSERVATION], &self.actions[..ACTION]);
        let (learner, mut values) = (&mut self.learner, [0.0; CRITICS]);
        timed(repeats, || learner.q_values(observation, action, &mut values).expect("values"))
    }
}

fn timed(repeats: usize, mut work: impl FnMut()) -> Vec<f64> {
    let time = |_| {
        let start = Instant::now();
        work();
        start.elapsed().as_secs_f64()
    };
    (0..repeats).map(time).collect()
}

fn critic_weights() -> usize {
    (OBSERVATION + 1) * FIRST + (FIRST + ACTION + 1) * SECOND + SECOND + 1
}

fn actor_weights() -> usize {
    (OBSERVATION + 1) * FIRST + (FIRST + 1) * SECOND + (SECOND + 1) * ACTION
}

/// Arithmetic of the matrix products of one update; a multiply-add counts as two.
pub fn update_flops(size: usize) -> f64 {
    // Forward of target and critic, gradient of the weights; for the second layer also that of its input.
    let critic = 3 * OBSERVATION * FIRST + 4 * FIRST * SECOND;
    // The action: targets, values, weights' gradient; π(s)'s values and the gradient with respect to it.
    let action = 5 * ACTION * SECOND;
    // The output: targets, values, both gradients; the same without the weights' at π(s).
    let output = 6 * SECOND;
    // Forward of π' and π, and π's gradients.
    let actor = 3 * OBSERVATION * FIRST + 4 * FIRST * SECOND + 4 * SECOND * ACTION;
    2.0 * (size * (CRITICS * (critic + action + output) + actor)) as f64
}

/// What an update must at least read and write: weights, target weights and both moments, once each way.
pub fn update_bytes() -> f64 {
    (2 * 4 * 4 * (CRITICS * critic_weights() + actor_weights())) as f64
}

/// What a valuation must read.
pub fn valued_bytes(bytes_per_weight: usize) -> f64 {
    (bytes_per_weight * CRITICS * critic_weights()) as f64
}
