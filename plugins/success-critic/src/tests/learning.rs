//! What is learned, and what is answered of it.

use actor_critic::sigmoid;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use shield_api::{Checkpoint, ErrorKind, Space, SuccessCritic};

use super::{ACTION, End, MEMBERS, OBSERVATION, SIZE, create, critic, probabilities, train};
use crate::support::{Attempts, mean, saved};

#[test]
fn before_anything_was_learned_it_is_the_initial_probability_everywhere() {
    let mut rng = Pcg64::seed_from_u64(1);
    for (settings, expected) in [("", 0.88), ("initial_probability: 0.3", 0.3)] {
        let mut critic = critic(settings);
        for _ in 0..50 {
            let observation: [f32; 3] = std::array::from_fn(|_| rng.random_range(-100.0..100.0));
            let found = probabilities(&mut critic, &observation, &[rng.random_range(-2.0..2.0), 0.5]);
            assert!(found.iter().all(|value| (value - expected).abs() < 0.01), "{found:?}");
        }
    }
}

#[test]
fn each_member_learns_the_target_of_its_own_target_network() {
    let mut critic = critic("discount: 0.9, outcome_weight: 0.6, tau: 0.5, learning_rate: 1e-2");
    train(&mut critic, 0..20);
    let attempts = Attempts::random(99);
    // Actions in [-2, 2] × [0, 1], scaled to [-1, 1].
    let unit: Vec<f32> =
        attempts.next_actions.chunks(2).flat_map(|action| [action[0] / 2.0, 2.0 * action[1] - 1.0]).collect();
    let next: Vec<Vec<f32>> = (0..MEMBERS)
        .map(|member| {
            critic.critics.member(member).target_values(&attempts.next_observations, &unit).to_vec()
        })
        .collect();
    critic.update(&attempts.batch()).unwrap();
    for (step, next) in critic.steps.iter().zip(&next) {
        for (row, (target, next)) in step.targets.iter().zip(next).enumerate() {
            let weight = 0.6 * attempts.outcome_weights[row];
            let expected = match row {
                2 => 1.0,
                3 => 0.0,
                _ => weight * attempts.outcomes[row] + (1.0 - weight) * 0.9 * sigmoid(*next),
            };
            assert!((target - expected).abs() < 1e-6, "{row}");
        }
    }
    assert!(next[0] != next[1] && next[1] != next[2]);
}

/// Ten places in a row. From the left half the reset agent goes left, and the place 0 is the reset set. In the right half it goes back and forth
/// until its time is over, which ends nothing. Returns P in the middle of either half.
fn learn_two_halves(settings: &str) -> [f32; 2] {
    let mut critic = create(settings, 1, Space::uniform(1, -1.0, 1.0), 3).unwrap();
    let place = |index: i32| [index as f32 / 5.0 - 1.0];
    let mut attempts = Attempts::default();
    for _ in 0..6 {
        for index in 1..10_i32 {
            let is_left = index < 5;
            let next = if is_left { index - 1 } else { 5 + (index - 4) % 5 };
            let success = f32::from(next == 0);
            let end = End { success, continuation: 1.0 - success, outcome: f32::from(is_left) };
            attempts.push(&place(index), &place(next), &end, critic.info().members);
        }
    }
    (0..1_000).for_each(|_| critic.update(&attempts.batch()).unwrap());
    [2, 7].map(|index| mean(&probabilities(&mut critic, &place(index), &[0.0])))
}

#[test]
fn outcomes_separate_where_there_is_a_way_back_from_where_there_is_none() {
    let [left, right] = learn_two_halves("");
    assert!(left > 0.95 && right < 0.05, "{left} {right}");
}

#[test]
fn without_outcomes_a_place_without_a_way_back_lives_on_its_own_estimates() {
    let [left, right] = learn_two_halves("outcome_weight: 0.0");
    assert!(left > 0.9 && right > 0.7, "{left} {right}");
}

/// Each update meets outcomes that are drawn anew, so that P fluctuates about the frequency for ever: what holds for one moment may be luck.
#[test]
fn probabilities_become_the_frequencies_of_random_outcomes() {
    let frequencies = [0.1, 0.5, 0.9];
    let place = |row: usize| -> [f32; 3] { std::array::from_fn(|index| f32::from(index == row % 3)) };
    for seed in 0..3 {
        let mut critic = create("", 3, Space::uniform(1, -1.0, 1.0), seed).unwrap();
        let mut rng = Pcg64::seed_from_u64(seed + 100);
        let mut errors = [const { Vec::new() }; 3];
        for update in 0..3_000 {
            let mut attempts = Attempts::default();
            for row in 0..64 {
                let outcome = f32::from(rng.random::<f32>() < frequencies[row % 3]);
                let end = End { success: 0.0, continuation: 1.0, outcome };
                attempts.push(&place(row), &place(row), &end, 5);
            }
            attempts.masks.fill_with(|| f32::from(rng.random::<f32>() < 0.8));
            critic.update(&attempts.batch()).unwrap();
            if update >= 1_500 && update % 10 == 0 {
                for (row, errors) in errors.iter_mut().enumerate() {
                    let found = mean(&probabilities(&mut critic, &place(row), &[0.0]));
                    errors.push(found - frequencies[row]);
                }
            }
        }
        for (errors, frequency) in errors.iter().zip(frequencies) {
            let squares: Vec<f32> = errors.iter().map(|error| error * error).collect();
            let (bias, deviation) = (mean(errors), mean(&squares).sqrt());
            assert!(bias.abs() < 0.02 && deviation < 0.05, "{frequency}: {bias} ± {deviation}");
        }
    }
}

#[test]
fn an_outcome_without_weight_is_ignored() {
    let learned = |outcome: f32| {
        let mut critic = critic("");
        let mut attempts = Attempts::random(1);
        attempts.outcome_weights.fill(0.0);
        attempts.outcomes.fill(outcome);
        (0..3).for_each(|_| critic.update(&attempts.batch()).unwrap());
        saved(&critic)
    };
    assert_eq!(learned(0.0), learned(1.0));
}

#[test]
fn discrete_actions_are_told_apart_and_have_no_gradient() {
    let mut critic = create("members: 2", 1, Space::Discrete { n: 3 }, 3).unwrap();
    let mut attempts = Attempts::default();
    for row in 0..60 {
        let outcome = f32::from(row % 3 == 1);
        attempts.push(&[1.0], &[1.0], &End { success: outcome, continuation: 0.0, outcome }, 2);
        attempts.actions[row] = (row % 3) as f32;
    }
    (0..400).for_each(|_| critic.update(&attempts.batch()).unwrap());
    let found = [0.0, 1.0, 2.0].map(|action| mean(&probabilities(&mut critic, &[1.0], &[action])));
    assert!(found[0] < 0.1 && found[1] > 0.9 && found[2] < 0.1, "{found:?}");
    let error = critic.gradients(&[1.0], &[1.0], &mut [0.0; 2], &mut [0.0; 2]).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Unsupported);
    for action in [3.0, 0.5, -1.0, f32::NAN] {
        assert!(critic.probabilities(&[1.0], &[action], &mut [0.0; 2]).is_err(), "{action}");
    }
}

#[test]
fn probabilities_stay_between_0_and_1() {
    let mut critic = critic("learning_rate: 10.0");
    for round in 0..20 {
        train(&mut critic, round..round + 1);
        for size in [0.0, 1.0, 1e10, f32::MAX] {
            let found = probabilities(&mut critic, &[size, -size, size], &[2.0, 0.0]);
            assert!(found.iter().all(|value| (0.0..=1.0).contains(value)), "{found:?}");
        }
    }
}

#[test]
fn a_member_learns_only_what_its_mask_allows() {
    let mut critic = critic("");
    train(&mut critic, 0..5);
    let before = saved(&critic);
    let after = |masked: bool| {
        let mut critic = super::critic("");
        critic.load(&before).unwrap();
        let mut attempts = Attempts::random(9);
        if masked {
            (0..SIZE).for_each(|row| attempts.masks[row * MEMBERS + 1] = 0.0);
        }
        critic.update(&attempts.batch()).unwrap();
        probabilities(&mut critic, &OBSERVATION, &ACTION)
    };
    let before = probabilities(&mut critic, &OBSERVATION, &ACTION);
    let (with_all, with_fewer) = (after(false), after(true));
    assert_eq!(before[1], with_fewer[1]);
    assert!(before.iter().zip(&with_all).all(|(before, after)| before != after));
    assert_eq!((with_all[0], with_all[2]), (with_fewer[0], with_fewer[2]), "members influence each other");
}
