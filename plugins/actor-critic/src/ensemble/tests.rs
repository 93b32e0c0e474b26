use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::*;
use crate::{Activation, Adam, Initialisation, Loss};

const OBSERVATION: usize = 3;
const ACTION: usize = 2;
const SIZE: usize = 5;

fn random(length: usize, seed: u64) -> Vec<f64> {
    let mut rng = Pcg64::seed_from_u64(seed);
    (0..length).map(|_| rng.random_range(-1.0..1.0)).collect()
}

/// An ensemble whose last layer is not nearly zero, as a trained one's.
fn ensemble<T: Real>(architecture: Architecture, members: usize, threads: usize) -> Ensemble<T> {
    let mut ensemble = Ensemble::new(
        architecture,
        Initialisation::Lillicrap,
        members,
        threads,
        &mut Pcg64::seed_from_u64(7),
    )
    .unwrap();
    for (weight, value) in ensemble.state.weights.iter_mut().zip(random(1_000_000, 8)) {
        *weight = T::from_f64(0.7 * value);
    }
    ensemble
}

fn critic<T: Real>(hidden: &[usize], activation: Activation, members: usize, threads: usize) -> Ensemble<T> {
    ensemble(Architecture::critic(OBSERVATION, ACTION, hidden, 1, activation).unwrap(), members, threads)
}

/// (f(x + h) − f(x − h)) / 2h for each coordinate of x.
fn central_differences(x: &mut [f64], mut f: impl FnMut(&[f64]) -> f64) -> Vec<f64> {
    const H: f64 = 1e-6;
    (0..x.len())
        .map(|index| {
            let original = x[index];
            x[index] = original + H;
            let above = f(x);
            x[index] = original - H;
            let below = f(x);
            x[index] = original;
            (above - below) / (2.0 * H)
        })
        .collect()
}

fn assert_close(what: &str, found: &[f64], expected: &[f64]) {
    assert_eq!(found.len(), expected.len());
    assert!(expected.iter().any(|x| x.abs() > 1e-3), "{what}: nothing to compare");
    for (index, (a, b)) in found.iter().zip(expected).enumerate() {
        assert!((a - b).abs() < 1e-7 * (1.0 + b.abs()), "{what} {index}: {a} against {b}");
    }
}

fn check_gradients(architecture: &Architecture, loss: Loss) {
    let size = SIZE;
    let outputs = architecture.output_len();
    let observations = random(size * OBSERVATION, 1);
    let mut actions = random(size * architecture.action_len(), 2);
    // Errors on both sides of the Huber loss's bend.
    let targets: Vec<f64> = random(size * outputs, 3).iter().map(|x| 3.0 * x).collect();
    let masks: Vec<f64> = (0..size * outputs).map(|row| f64::from(row % 3 != 1)).collect();
    let mut ensemble: Ensemble<f64> = ensemble(architecture.clone(), 1, 1);

    let mut member = ensemble.member(0);
    member.observe(&observations);
    member.values(&actions);
    let (values, gradients) = member.outputs();
    loss.evaluate(values, &targets, &masks, gradients);
    member.backward(&observations, &actions);
    let found = member.workspace.gradients[..architecture.parameter_len()].to_vec();
    let mut found_actions = vec![0.0; actions.len()];
    if architecture.action_len() > 0 {
        member.values(&actions);
        member.action_gradients(&mut found_actions);
    }

    let value_of = |parameters: &[f64], actions: &[f64]| {
        let mut workspace = Workspace::default();
        architecture.trunk(parameters, &observations, &mut workspace);
        architecture.head(parameters, actions, &mut workspace);
        workspace.outputs(architecture).0.to_vec()
    };
    let mut parameters = ensemble.state.weights.clone();
    let expected = central_differences(&mut parameters, |parameters| {
        let mut unused = vec![0.0; targets.len()];
        loss.evaluate(&value_of(parameters, &actions), &targets, &masks, &mut unused)
    });
    assert_close("parameter", &found, &expected);
    if architecture.action_len() > 0 {
        let expected =
            central_differences(&mut actions, |actions| value_of(&parameters, actions).iter().sum());
        assert_close("action", &found_actions, &expected);
    }
}

#[test]
fn the_backward_pass_equals_finite_differences() {
    for activation in [Activation::Tanh, Activation::Relu] {
        for loss in [Loss::Squared, Loss::Huber] {
            for hidden in [&[7, 6][..], &[5], &[4, 6, 5]] {
                for action_layer in [0, 1, 2] {
                    let critic = Architecture::critic(OBSERVATION, ACTION, hidden, action_layer, activation);
                    check_gradients(&critic.unwrap(), loss);
                }
                check_gradients(&Architecture::actor(OBSERVATION, ACTION, hidden, activation).unwrap(), loss);
                check_gradients(
                    &Architecture::action_values(OBSERVATION, 4, hidden, activation).unwrap(),
                    loss,
                );
            }
        }
    }
}

/// Three updates with everything an update may contain; returns the state and the values of one (s, a).
fn train(ensemble: &mut Ensemble<f32>, seeds: std::ops::Range<u64>) -> Vec<f32> {
    let floats = |length, seed| random(length, seed).into_iter().map(|x| x as f32).collect::<Vec<_>>();
    for seed in seeds {
        let observations = floats(SIZE * OBSERVATION, 10 * seed);
        let next_observations = floats(SIZE * OBSERVATION, 10 * seed + 1);
        let actions = floats(SIZE * ACTION, 10 * seed + 2);
        let rewards = floats(SIZE, 10 * seed + 3);
        let mut targets = vec![vec![0.0; SIZE]; ensemble.members()];
        ensemble.for_each_member(&mut targets, |member, targets| {
            let next = member.target_values(&next_observations, &actions);
            for row in 0..SIZE {
                targets[row] = rewards[row] + 0.9 * next[row];
            }
            member.observe(&observations);
            member.values(&actions);
            let (values, gradients) = member.outputs();
            Loss::Huber.evaluate(values, targets, &[1.0; SIZE], gradients);
            member.backward(&observations, &actions);
            member.clip_gradient(0.5);
            member.step(&Adam::new(0.01), 0.1);
        });
        ensemble.count_step();
    }
    let mut values = vec![0.0; ensemble.members()];
    ensemble.for_each_member(&mut values, |member, value| {
        member.observe(&[0.1, 0.2, 0.3]);
        *value = member.values(&[0.4, 0.5])[0];
    });
    values
}

#[test]
fn the_number_of_threads_changes_no_bit() {
    let mut single = critic(&[40, 30], Activation::Tanh, 5, 1);
    let values = train(&mut single, 0..3);
    for threads in [2, 3, 8] {
        let mut several = critic(&[40, 30], Activation::Tanh, 5, threads);
        assert_eq!(values, train(&mut several, 0..3), "{threads} threads");
        assert_eq!(single.state(), several.state(), "{threads} threads");
    }
}

/// Four threads and three pairs: one thread remains without work.
#[test]
fn a_pair_is_two_successive_members_on_any_number_of_threads() {
    let values = |threads| {
        let mut ensemble: Ensemble<f32> = critic(&[40, 30], Activation::Tanh, 6, threads);
        let mut pairs = [(9, [0.0; 2], [9; 2]); 3];
        ensemble.for_each_group(2, &mut pairs, |pair, result| {
            result.0 = pair.index();
            for twin in 0..pair.size() {
                let mut member = pair.member(twin);
                member.observe(&[0.1, 0.2, 0.3]);
                (result.1[twin], result.2[twin]) = (member.values(&[0.4, 0.5])[0], member.index());
            }
        });
        pairs
    };
    let mut ensemble: Ensemble<f32> = critic(&[40, 30], Activation::Tanh, 6, 1);
    let expected: Vec<f32> = (0..6)
        .map(|index| {
            let mut member = ensemble.member(index);
            member.observe(&[0.1, 0.2, 0.3]);
            member.values(&[0.4, 0.5])[0]
        })
        .collect();
    for threads in [1, 2, 4] {
        for (index, pair) in values(threads).into_iter().enumerate() {
            let (first, second) = (2 * index, 2 * index + 1);
            assert_eq!(pair, (index, [expected[first], expected[second]], [first, second]));
        }
    }
}

#[test]
fn members_do_not_influence_each_other() {
    let mut together: Ensemble<f32> = critic(&[40, 30], Activation::Relu, 3, 2);
    let length = together.architecture().parameter_len();
    let mut alone: Vec<Ensemble<f32>> = (0..3)
        .map(|index| {
            let mut one = critic(&[40, 30], Activation::Relu, 1, 1);
            let range = index * length..(index + 1) * length;
            one.state.weights.copy_from_slice(&together.state.weights[range.clone()]);
            one.state.targets.copy_from_slice(&together.state.targets[range]);
            one
        })
        .collect();
    let values = train(&mut together, 0..3);
    for (index, one) in alone.iter_mut().enumerate() {
        assert_eq!(train(one, 0..3), values[index..=index]);
        let range = index * length..(index + 1) * length;
        assert_eq!(one.state.weights, together.state.weights[range.clone()]);
        assert_eq!(one.state.second_moments, together.state.second_moments[range]);
    }
}

#[test]
fn a_restored_ensemble_continues_bit_for_bit() {
    let mut original: Ensemble<f32> = critic(&[40, 30], Activation::Tanh, 3, 1);
    train(&mut original, 0..2);
    let mut restored: Ensemble<f32> = critic(&[40, 30], Activation::Tanh, 3, 1);
    restored.restore(original.state().clone()).unwrap();
    assert_eq!(train(&mut original, 2..4), train(&mut restored, 2..4));
    assert_eq!(original.state(), restored.state());
}

#[test]
fn a_foreign_state_is_refused() {
    let mut ensemble: Ensemble<f32> = critic(&[4, 3], Activation::Tanh, 2, 1);
    let other: Ensemble<f32> = critic(&[4, 3], Activation::Tanh, 3, 1);
    assert!(matches!(ensemble.restore(other.state().clone()), Err(Error::StateLength { .. })));
    let mut broken = ensemble.state().clone();
    broken.targets[3] = f32::NAN;
    assert_eq!(ensemble.restore(broken), Err(Error::StateNotFinite));
}

#[test]
fn initial_weights_have_the_published_bounds() {
    let architecture = Architecture::critic(OBSERVATION, ACTION, &[40, 30], 1, Activation::Tanh).unwrap();
    let mut ensemble: Ensemble<f32> =
        Ensemble::new(architecture.clone(), Initialisation::Lillicrap, 2, 1, &mut Pcg64::seed_from_u64(0))
            .unwrap();
    let bounds = [1.0 / 3.0_f32.sqrt(), 1.0 / 42.0_f32.sqrt(), 3e-3];
    for member in ensemble.state.weights.chunks_exact(architecture.parameter_len()) {
        for (layer, bound) in architecture.layers.iter().zip(bounds) {
            let largest = layer.parts(member).weights.iter().fold(0.0_f32, |a, b| a.max(b.abs()));
            assert!(largest <= bound && largest > 0.8 * bound, "{largest} against {bound}");
        }
    }
    let before = ensemble.state.clone();
    ensemble.raise_outputs(5.0);
    let last = architecture.parameter_len() - 1;
    assert_eq!(ensemble.state.weights[last], before.weights[last] + 5.0);
    assert_eq!(ensemble.state.targets[last], before.targets[last] + 5.0);
    assert_eq!(ensemble.state.weights[..last], before.weights[..last]);
}

#[test]
fn an_ensemble_without_members_is_refused() {
    let architecture = Architecture::critic(OBSERVATION, ACTION, &[4], 1, Activation::Tanh).unwrap();
    assert!(matches!(
        Ensemble::<f32>::new(architecture, Initialisation::Lillicrap, 0, 1, &mut Pcg64::seed_from_u64(0)),
        Err(Error::NoMembers)
    ));
}
