use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::*;
use crate::{Activation, Adam, BatchRenorm, Initialisation, Loss, Regularisation};

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
    // Variances are positive.
    let length = ensemble.architecture.parameter_len();
    for member in ensemble.state.weights.chunks_exact_mut(length) {
        for layer in ensemble.architecture.layers.iter().filter(|layer| layer.batch_renorm.is_some()) {
            let [.., variance] = layer.batch_renorm();
            member[variance].iter_mut().for_each(|value| *value = *value * *value + T::ONE);
        }
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

/// How a pass treats what is regularised.
#[derive(Clone, Copy)]
enum Treatment {
    /// As outside an update.
    Values,
    /// Units are dropped.
    Dropping,
    /// By the statistics of the batch.
    Batch,
}

/// A whole forward pass; those of one treatment drop the same units.
fn forward(member: &mut Member<'_, f64>, observations: &[f64], actions: &[f64], treatment: Treatment) {
    member.workspace.begin(matches!(treatment, Treatment::Dropping).then_some(3), 0);
    if let Treatment::Batch = treatment {
        member.learn(observations, actions);
    } else {
        member.observe(observations);
        member.values(actions);
    }
}

fn check_gradients(architecture: &Architecture, loss: Loss, treatment: Treatment) {
    let size = SIZE;
    let outputs = architecture.output_len();
    let observations = random(size * OBSERVATION, 1);
    let mut actions = random(size * architecture.action_len(), 2);
    // Errors on both sides of the Huber loss's bend.
    let targets: Vec<f64> = random(size * outputs, 3).iter().map(|x| 3.0 * x).collect();
    let masks: Vec<f64> = (0..size * outputs).map(|row| f64::from(row % 3 != 1)).collect();
    let mut ensemble: Ensemble<f64> = ensemble(architecture.clone(), 1, 1);

    let mut member = ensemble.member(0);
    forward(&mut member, &observations, &actions, treatment);
    let (values, gradients) = member.outputs();
    loss.evaluate(values, &targets, &masks, gradients);
    member.backward(&observations, &actions);
    let found = member.workspace.gradients[..architecture.parameter_len()].to_vec();
    let mut found_actions = vec![0.0; actions.len()];
    if architecture.action_len() > 0 {
        forward(&mut member, &observations, &actions, treatment);
        member.action_gradients(&mut found_actions);
    }

    let mut moved =
        Ensemble::<f64>::new(architecture.clone(), Initialisation::He, 1, 1, &mut Pcg64::seed_from_u64(0))
            .unwrap();
    let mut value_of = |parameters: &[f64], actions: &[f64]| {
        moved.state.weights.copy_from_slice(parameters);
        let mut member = moved.member(0);
        forward(&mut member, &observations, actions, treatment);
        member.outputs().0.to_vec()
    };
    let mut parameters = ensemble.state.weights.clone();
    let mut expected = central_differences(&mut parameters, |parameters| {
        let mut unused = vec![0.0; targets.len()];
        loss.evaluate(&value_of(parameters, &actions), &targets, &masks, &mut unused)
    });
    // Running statistics are no weights.
    for layer in architecture.layers.iter().filter(|layer| layer.batch_renorm.is_some()) {
        layer.batch_renorm()[2..].iter().for_each(|range| expected[range.clone()].fill(0.0));
    }
    assert_close("parameter", &found, &expected);
    // The mean over a batch that was brought to a given mean depends on no action.
    if architecture.action_len() > 0 && !matches!(treatment, Treatment::Batch) {
        let expected =
            central_differences(&mut actions, |actions| value_of(&parameters, actions).iter().sum());
        assert_close("action", &found_actions, &expected);
    }
}

#[test]
fn the_backward_pass_equals_finite_differences() {
    let plain = (Regularisation::default(), Treatment::Values);
    for activation in [Activation::Tanh, Activation::Relu] {
        for loss in [Loss::Squared, Loss::Huber] {
            for hidden in [&[7, 6][..], &[5], &[4, 6, 5]] {
                check_networks(hidden, activation, loss, plain);
            }
        }
    }
}

#[test]
fn the_backward_pass_through_normalisations_and_dropout_equals_finite_differences() {
    let renormed = Regularisation { batch_renorm: Some(RENORM), ..Regularisation::default() };
    let all = Regularisation { layer_norm: true, dropout: 0.3, batch_renorm: Some(RENORM) };
    let treated = [
        (Regularisation { layer_norm: true, ..Regularisation::default() }, Treatment::Values),
        (Regularisation { dropout: 0.3, ..Regularisation::default() }, Treatment::Dropping),
        (Regularisation { layer_norm: true, dropout: 0.3, batch_renorm: None }, Treatment::Dropping),
        (renormed, Treatment::Values),
        (renormed, Treatment::Batch),
        (all, Treatment::Batch),
    ];
    for treated in treated {
        for activation in [Activation::Tanh, Activation::Relu] {
            check_networks(&[7, 6], activation, Loss::Squared, treated);
        }
    }
}

/// Batches are never warm here: what r and d are counted as constants for, finite differences see.
const RENORM: BatchRenorm = BatchRenorm { momentum: 0.99, warm_up: u64::MAX };

/// Critics in which the action enters everywhere, an actor, and values of discrete actions.
fn check_networks(
    hidden: &[usize],
    activation: Activation,
    loss: Loss,
    (regularisation, treatment): (Regularisation, Treatment),
) {
    for action_layer in [0, 1, 2] {
        let critic = Architecture::critic(OBSERVATION, ACTION, hidden, action_layer, activation).unwrap();
        check_gradients(&critic.regularised(regularisation), loss, treatment);
    }
    let actor = Architecture::actor(OBSERVATION, ACTION, hidden, activation).unwrap();
    check_gradients(&actor.regularised(regularisation), loss, treatment);
    let values = Architecture::action_values(OBSERVATION, 4, hidden, activation).unwrap();
    check_gradients(&values.regularised(regularisation), loss, treatment);
}

#[test]
fn a_regularised_network_keeps_its_values_in_half_precision_and_drops_units_in_updates_only() {
    let regularisation = Regularisation { layer_norm: true, dropout: 0.5, batch_renorm: Some(RENORM) };
    let shape = Architecture::critic(OBSERVATION, ACTION, &[40, 30], 1, Activation::Relu).unwrap();
    let mut networks: Ensemble<f32> = ensemble(shape.regularised(regularisation), 3, 1);
    networks.keep_halves();
    let (observation, action) = ([0.1, 0.2, 0.3], [0.4, 0.5]);
    let values = |networks: &mut Ensemble<f32>| {
        let mut values = [9.0; 3];
        networks.for_each_member(&mut values, |member, value| {
            member.observe(&observation);
            *value = member.values(&action)[0];
        });
        values
    };
    let exact = values(&mut networks);
    networks.begin_update(&mut Pcg64::seed_from_u64(1));
    assert_ne!(values(&mut networks), exact, "units are dropped in an update");
    let mut halves = [9.0; 3];
    networks.value_in_half(&observation, &action, &mut halves);
    for (half, exact) in halves.iter().zip(exact) {
        assert!((half - exact).abs() < 5e-3 * exact.abs().max(1.0), "{half} against {exact}");
    }
    networks.count_step();
    assert_eq!(values(&mut networks), exact);
}

#[test]
fn kept_passes_are_used_together() {
    let mut networks: Ensemble<f32> = critic(&[40, 30], Activation::Tanh, 4, 2);
    let train = |networks: &mut Ensemble<f32>, both_first: bool| {
        let mut pairs = [[0.0; 2]; 2];
        networks.for_each_group(2, &mut pairs, |pair, values| {
            if both_first {
                for twin in 0..2 {
                    pair.member(twin).learn(&[0.1, 0.2, 0.3], &[0.4, 0.5]);
                }
            }
            for (twin, value) in values.iter_mut().enumerate() {
                let mut member = pair.member(twin);
                if !both_first {
                    member.learn(&[0.1, 0.2, 0.3], &[0.4, 0.5]);
                }
                *value = member.outputs().0[0];
            }
        });
        pairs
    };
    let expected = train(&mut networks, false);
    networks.keep_passes(2);
    assert_eq!(train(&mut networks, true), expected);
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
