//! One update of an ensemble in the shape of DDPG: 20 critics 400-300, 18 observations, 6 actions, batch 64.

use actor_critic::{Activation, Adam, Architecture, Ensemble, Initialisation, Loss};
use criterion::{Criterion, criterion_group, criterion_main};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

const OBSERVATION: usize = 18;
const ACTION: usize = 6;
const CRITICS: usize = 20;

struct Scratch {
    targets: Vec<f32>,
    action_gradients: Vec<f32>,
}

fn random(length: usize, rng: &mut Pcg64) -> Vec<f32> {
    (0..length).map(|_| rng.random_range(-1.0..1.0)).collect()
}

fn critics(threads: usize, rng: &mut Pcg64) -> Ensemble<f32> {
    let architecture =
        Architecture::critic(OBSERVATION, ACTION, &[400, 300], 1, Activation::Tanh).expect("a shape");
    Ensemble::new(architecture, Initialisation::Lillicrap, CRITICS, threads, rng).expect("threads")
}

fn update(criterion: &mut Criterion) {
    for (size, threads) in [(64, 1), (64, 2), (256, 1), (256, 2)] {
        let mut rng = Pcg64::seed_from_u64(0);
        let mut ensemble = critics(threads, &mut rng);
        let observations = random(size * OBSERVATION, &mut rng);
        let next_observations = random(size * OBSERVATION, &mut rng);
        let actions = random(size * ACTION, &mut rng);
        let rewards = random(size, &mut rng);
        let ones = vec![1.0; size];
        let mut scratch: Vec<Scratch> = (0..CRITICS)
            .map(|_| Scratch { targets: vec![0.0; size], action_gradients: vec![0.0; size * ACTION] })
            .collect();
        let adam = Adam::new(1e-3);
        criterion.bench_function(&format!("critics, batch {size}, threads {threads}"), |bencher| {
            bencher.iter(|| {
                ensemble.for_each_member(&mut scratch, |member, scratch| {
                    let next_values = member.target_values(&next_observations, &actions);
                    for (row, target) in scratch.targets.iter_mut().enumerate() {
                        *target = rewards[row] + 0.99 * next_values[row];
                    }
                    member.observe(&observations);
                    member.values(&actions);
                    let (values, gradients) = member.outputs();
                    Loss::Huber.evaluate(values, &scratch.targets, &ones, gradients);
                    member.backward(&observations, &actions);
                    member.values(&actions);
                    member.action_gradients(&mut scratch.action_gradients);
                    member.step(&adam, 0.005);
                });
                ensemble.count_step();
            });
        });
    }
}

fn value(criterion: &mut Criterion) {
    for threads in [1, 2] {
        let mut rng = Pcg64::seed_from_u64(0);
        let mut ensemble = critics(threads, &mut rng);
        let (observation, action) = (random(OBSERVATION, &mut rng), random(ACTION, &mut rng));
        let mut values = vec![0.0; CRITICS];
        criterion.bench_function(&format!("value of one (s, a), threads {threads}"), |bencher| {
            bencher.iter(|| {
                ensemble.for_each_member(&mut values, |member, value| {
                    member.observe(&observation);
                    *value = member.values(&action)[0];
                });
            });
        });
    }
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(20);
    targets = update, value
}
criterion_main!(benches);
