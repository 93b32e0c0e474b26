mod learning;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use shield_api::{
    AttemptBatch, Checkpoint, ErrorKind, Host, Plugin, PluginConfig, Result, Setup, Space, Spaces,
    SuccessCritic,
};

use crate::support::{Attempts, saved};
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

/// A small critic with further settings. It sees observations as they are, unless these say otherwise.
fn critic(settings: &str) -> CriticEnsemble {
    let plain = if settings.contains("normalise") { "" } else { "normalise_observations: false, " };
    create(&format!("{SMALL}, {plain}{settings}"), 3, boxed(), 5).unwrap()
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
}

fn train(critic: &mut CriticEnsemble, seeds: std::ops::Range<u64>) {
    seeds.for_each(|seed| critic.update(&Attempts::random(seed).batch()).unwrap());
}

fn probabilities(critic: &mut CriticEnsemble, observation: &[f32], action: &[f32]) -> Vec<f32> {
    let mut probabilities = vec![9.0; critic.info().members];
    critic.probabilities(observation, action, &mut probabilities).unwrap();
    probabilities
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
    let other_shape =
        saved(&create("members: 4, hidden: [20, 15], normalise_observations: false", 3, boxed(), 5).unwrap());
    let normalised = saved(&create("members: 3, hidden: [20, 15]", 3, boxed(), 5).unwrap());
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
        ("normalise_observations", "false"),
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
