use actor_critic::sigmoid;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use shield_api::{
    AttemptBatch, Checkpoint, ErrorKind, Host, Plugin, PluginConfig, Result, Setup, Space, Spaces,
    SuccessCritic,
};

use crate::{CriticEnsemble, SuccessCriticConfig};

/// Rows of a random batch.
const SIZE: usize = 8;
const MEMBERS: usize = 3;
const SMALL: &str = "members: 3, hidden: [20, 15]";
const OBSERVATION: [f32; 3] = [0.3, -0.2, 0.7];
const ACTION: [f32; 2] = [0.5, 0.6];

/// A box of actions that is neither symmetric nor square.
fn boxed() -> Space {
    Space::Box { low: vec![-2.0, 0.0], high: vec![2.0, 1.0] }
}

fn create(settings: &str, observation_len: usize, action: Space, seed: u64) -> Result<CriticEnsemble> {
    let spaces = Spaces { observation: Space::unbounded(observation_len), action };
    let config = SuccessCriticConfig::parse(&format!("({settings})")).unwrap();
    CriticEnsemble::create(config, &Setup::with_spaces(seed, 1, Host::silent(), spaces))
}

/// A small critic with further settings.
fn critic(settings: &str) -> CriticEnsemble {
    create(&format!("{SMALL}, {settings}"), 3, boxed(), 5).unwrap()
}

/// The columns of a batch.
#[derive(Clone, Default)]
struct Attempts {
    size: usize,
    observations: Vec<f32>,
    actions: Vec<f32>,
    next_observations: Vec<f32>,
    next_actions: Vec<f32>,
    successes: Vec<f32>,
    continuations: Vec<f32>,
    outcomes: Vec<f32>,
    outcome_weights: Vec<f32>,
    masks: Vec<f32>,
}

/// What became of one transition.
struct End {
    success: f32,
    continuation: f32,
    outcome: f32,
}

impl Attempts {
    /// Random transitions: one succeeds, one ends, and each member lacks some.
    fn random(seed: u64) -> Self {
        let mut rng = Pcg64::seed_from_u64(seed);
        let mut floats =
            |length, low: f32| -> Vec<f32> { (0..length).map(|_| rng.random_range(low..1.0)).collect() };
        Self {
            size: SIZE,
            observations: floats(SIZE * 3, -1.0),
            actions: floats(SIZE * 2, 0.0),
            next_observations: floats(SIZE * 3, -1.0),
            next_actions: floats(SIZE * 2, 0.0),
            successes: (0..SIZE).map(|row| f32::from(row == 2)).collect(),
            continuations: (0..SIZE).map(|row| f32::from(row != 3)).collect(),
            outcomes: (0..SIZE).map(|row| f32::from(row % 2 == 0)).collect(),
            outcome_weights: floats(SIZE, 0.0),
            masks: (0..SIZE * MEMBERS).map(|index| f32::from(index % 5 != 1)).collect(),
        }
    }

    /// Adds a transition with the action 0 and a counted outcome, for every one of `members`.
    fn push(&mut self, observation: &[f32], next_observation: &[f32], end: &End, members: usize) {
        self.size += 1;
        self.observations.extend(observation);
        self.actions.push(0.0);
        self.next_observations.extend(next_observation);
        self.next_actions.push(0.0);
        self.successes.push(end.success);
        self.continuations.push(end.continuation);
        self.outcomes.push(end.outcome);
        self.outcome_weights.push(1.0);
        self.masks.resize(self.size * members, 1.0);
    }

    fn batch(&self) -> AttemptBatch<'_> {
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

fn train(critic: &mut CriticEnsemble, seeds: std::ops::Range<u64>) {
    seeds.for_each(|seed| critic.update(&Attempts::random(seed).batch()).unwrap());
}

fn probabilities(critic: &mut CriticEnsemble, observation: &[f32], action: &[f32]) -> Vec<f32> {
    let mut probabilities = vec![9.0; critic.info().members];
    critic.probabilities(observation, action, &mut probabilities).unwrap();
    probabilities
}

fn mean(values: &[f32]) -> f32 {
    values.iter().sum::<f32>() / values.len() as f32
}

fn saved(critic: &CriticEnsemble) -> Vec<u8> {
    let mut bytes = Vec::new();
    critic.save(&mut bytes).unwrap();
    bytes
}

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
    assert!(left > 0.9 && right > 0.4, "{left} {right}");
}

#[test]
fn probabilities_become_the_frequencies_of_random_outcomes() {
    let mut critic = create("", 3, Space::uniform(1, -1.0, 1.0), 3).unwrap();
    let mut rng = Pcg64::seed_from_u64(4);
    let frequencies = [0.1, 0.5, 0.9];
    for _ in 0..4_000 {
        let mut attempts = Attempts::default();
        for row in 0..64 {
            let here: [f32; 3] = std::array::from_fn(|index| f32::from(index == row % 3));
            let outcome = f32::from(rng.random::<f32>() < frequencies[row % 3]);
            attempts.push(&here, &here, &End { success: 0.0, continuation: 1.0, outcome }, 5);
        }
        attempts.masks.fill_with(|| f32::from(rng.random::<f32>() < 0.8));
        critic.update(&attempts.batch()).unwrap();
    }
    for (place, frequency) in frequencies.into_iter().enumerate() {
        let here: [f32; 3] = std::array::from_fn(|index| f32::from(index == place));
        let found = probabilities(&mut critic, &here, &[0.0]);
        assert!((mean(&found) - frequency).abs() < 0.05, "{found:?} instead of {frequency}");
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
fn gradients_match_finite_differences_of_the_probabilities() {
    let mut critic = critic("learning_rate: 1e-2");
    (0..100).for_each(|_| train(&mut critic, 1..2));
    let plain = probabilities(&mut critic, &OBSERVATION, &ACTION);
    let (mut valued, mut gradients) = ([0.0; MEMBERS], [0.0; 2 * MEMBERS]);
    critic.gradients(&OBSERVATION, &ACTION, &mut valued, &mut gradients).unwrap();
    assert_eq!(plain, valued);
    assert!(gradients.iter().any(|x| x.abs() > 0.05), "{gradients:?}");
    for dimension in 0..2 {
        const H: f32 = 0.02;
        let mut at = |shift: f32| {
            let mut moved = ACTION;
            moved[dimension] += shift;
            probabilities(&mut critic, &OBSERVATION, &moved)
        };
        let (above, below) = (at(H), at(-H));
        for member in 0..MEMBERS {
            let expected = (above[member] - below[member]) / (2.0 * H);
            let found = gradients[member * 2 + dimension];
            assert!((found - expected).abs() < 1e-3 + 0.01 * expected.abs(), "{found} against {expected}");
        }
    }
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
        let mut critic = self::critic("");
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

#[test]
fn a_broken_batch_is_refused_and_changes_nothing() {
    let mut critic = critic("normalise_observations: true");
    train(&mut critic, 0..2);
    let before = saved(&critic);
    let breaks: [fn(&mut Attempts); 15] = [
        |a| a.observations[4] = f32::NAN,
        |a| a.actions[1] = f32::INFINITY,
        |a| a.actions[SIZE - 1] = f32::NAN,
        |a| a.next_observations[0] = f32::NEG_INFINITY,
        |a| a.next_actions[0] = f32::NAN,
        |a| a.successes[1] = f32::NAN,
        |a| a.successes[1] = 1.5,
        |a| a.continuations[2] = 2.0,
        |a| a.outcomes[7] = f32::NAN,
        |a| a.outcomes[7] = -1.0,
        |a| a.outcome_weights[7] = f32::NAN,
        |a| a.outcome_weights[7] = 1.5,
        |a| a.masks[5] = f32::NAN,
        |a| a.masks.truncate(SIZE),
        |a| a.next_actions.truncate(3),
    ];
    for (index, damage) in breaks.iter().enumerate() {
        let mut attempts = Attempts::random(9);
        damage(&mut attempts);
        let error = critic.update(&attempts.batch()).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::InvalidArgument, "{index}");
        assert_eq!(before, saved(&critic), "{index}");
    }
    assert!(critic.update(&AttemptBatch { size: 0, ..Attempts::random(9).batch() }).is_err());
    assert_eq!(before, saved(&critic));
}

#[test]
fn wrong_arguments_are_refused() {
    let mut critic = critic("");
    let (mut place, mut gradients) = ([0.0; MEMBERS], [0.0; 2 * MEMBERS]);
    let refused = |result: Result<()>| {
        assert_eq!(result.unwrap_err().kind(), ErrorKind::InvalidArgument);
    };
    refused(critic.probabilities(&[f32::NAN, 0.0, 0.0], &ACTION, &mut place));
    refused(critic.probabilities(&OBSERVATION, &[0.0, f32::NAN], &mut place));
    refused(critic.probabilities(&OBSERVATION[..2], &ACTION, &mut place));
    refused(critic.probabilities(&OBSERVATION, &ACTION[..1], &mut place));
    refused(critic.probabilities(&OBSERVATION, &ACTION, &mut place[..2]));
    refused(critic.gradients(&OBSERVATION, &ACTION, &mut place, &mut gradients[..5]));
}

#[test]
fn logits_that_overflow_are_an_error_and_never_an_answer() {
    let mut critic = critic("learning_rate: 1e38");
    let error = (0..5).find_map(|seed| critic.update(&Attempts::random(seed).batch()).err());
    assert_eq!(error.map(|error| error.kind()), Some(ErrorKind::Failed));
    let error = critic.probabilities(&OBSERVATION, &ACTION, &mut [0.0; MEMBERS]).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Failed);
}

#[test]
fn a_loaded_critic_continues_bit_for_bit() {
    let mut uninterrupted = critic("normalise_observations: true");
    train(&mut uninterrupted, 0..3);
    let settings = format!("{SMALL}, normalise_observations: true");
    let mut continued = create(&settings, 3, boxed(), 77).unwrap();
    continued.load(&saved(&uninterrupted)).unwrap();
    for critic in [&mut uninterrupted, &mut continued] {
        train(critic, 3..6);
    }
    assert_eq!(
        probabilities(&mut uninterrupted, &OBSERVATION, &ACTION),
        probabilities(&mut continued, &OBSERVATION, &ACTION)
    );
    assert_eq!(saved(&uninterrupted), saved(&continued));
}

#[test]
fn foreign_bytes_are_refused_and_change_nothing() {
    let mut original = critic("");
    let before = saved(&original);
    let mut too_long = before.clone();
    too_long.push(0);
    let cut = before[..before.len() / 2].to_vec();
    let mut not_a_number = before.clone();
    not_a_number[40..44].fill(0xff);
    let other_shape = saved(&create("members: 4, hidden: [20, 15]", 3, boxed(), 5).unwrap());
    let normalised = saved(&critic("normalise_observations: true"));
    for bad in [Vec::new(), b"something else".to_vec(), cut, too_long, not_a_number, other_shape, normalised]
    {
        assert!(original.load(&bad).is_err(), "{} bytes", bad.len());
        assert_eq!(before, saved(&original));
    }
}

#[test]
fn every_configuration_field_changes_the_behaviour() {
    let behaviour = |changed: &str, value: &str| {
        let small =
            [("members", "3"), ("hidden", "[20, 15]")].into_iter().filter(|(name, _)| *name != changed);
        let fields = small.chain([(changed, value)]).filter(|(name, _)| !name.is_empty());
        let settings: Vec<String> = fields.map(|(name, value)| format!("{name}: {value}")).collect();
        let mut critic = create(&settings.join(", "), 3, boxed(), 5).unwrap();
        let mut seen = Vec::new();
        for seed in 0..4 {
            seen.extend(probabilities(&mut critic, &OBSERVATION, &ACTION).into_iter().map(f32::to_bits));
            let mut attempts = Attempts::random(seed);
            attempts.masks.resize(SIZE * critic.info().members, 1.0);
            critic.update(&attempts.batch()).unwrap();
        }
        seen
    };
    let reference = behaviour("", "");
    assert_eq!(reference, behaviour("", ""));
    let changes = [
        ("members", "4"),
        ("hidden", "[20]"),
        ("learning_rate", "2e-3"),
        ("discount", "0.9"),
        ("outcome_weight", "0.3"),
        ("tau", "0.5"),
        ("initial_probability", "0.5"),
        ("normalise_observations", "true"),
    ];
    for field in SuccessCriticConfig::FIELDS {
        let tried = changes.iter().find(|(name, _)| *name == field.name);
        let (name, value) = tried.unwrap_or_else(|| panic!("{} is not tried", field.name));
        assert_ne!(reference, behaviour(name, value), "{name} changes nothing");
    }
}

#[test]
fn the_manifest_states_the_defaults() {
    let text: Vec<String> = SuccessCriticConfig::FIELDS
        .iter()
        .map(|field| format!("{}: {}", field.name, field.default))
        .collect();
    let parsed = SuccessCriticConfig::parse(&format!("({})", text.join(", "))).unwrap();
    assert_eq!(format!("{parsed:?}"), format!("{:?}", SuccessCriticConfig::default()));
}

#[test]
fn impossible_settings_and_spaces_are_refused() {
    for setting in [
        "members: 0",
        "hidden: []",
        "hidden: [5, 0]",
        "learning_rate: NaN",
        "discount: 1.5",
        "outcome_weight: -0.1",
        "tau: 0.0",
        "tau: 1.5",
        "initial_probability: 1.0",
        "initial_probability: 0.0",
        "initial_probability: NaN",
    ] {
        let error = create(setting, 3, boxed(), 5).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::InvalidConfig, "{setting}");
        assert_eq!(error.field(), setting.split(':').next(), "{setting}");
    }
    let error = create("", 3, Space::unbounded(2), 5).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::InvalidArgument);
}

#[test]
fn after_the_first_call_nothing_is_allocated() {
    let mut critic = critic("normalise_observations: true");
    let attempts = Attempts::random(1);
    let mut round = || {
        let (mut place, mut gradients) = ([0.0; MEMBERS], [0.0; 2 * MEMBERS]);
        critic.update(&attempts.batch()).unwrap();
        critic.probabilities(&OBSERVATION, &ACTION, &mut place).unwrap();
        critic.gradients(&OBSERVATION, &ACTION, &mut place, &mut gradients).unwrap();
    };
    (0..4).for_each(|_| round());
    let counted = allocation_counter::measure(|| (0..20).for_each(|_| round()));
    assert_eq!(counted.count_total, 0);
}
