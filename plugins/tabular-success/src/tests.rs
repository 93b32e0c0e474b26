use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use shield_api::{
    AttemptBatch, Checkpoint, ErrorKind, Host, Plugin, PluginConfig, Result, Setup, Space, Spaces,
    SuccessCritic,
};

use crate::support::{Attempts, mean, saved};
use crate::{SuccessTables, TabularSuccessConfig};

const STATES: usize = 10;
const ACTIONS: usize = 3;

fn create(config: &str, observation: Space, action: Space) -> Result<SuccessTables> {
    let config = TabularSuccessConfig::parse(config).unwrap();
    let spaces = Spaces { observation, action };
    SuccessTables::create(config, &Setup::with_spaces(0, 1, Host::silent(), spaces))
}

fn critic(config: &str) -> SuccessTables {
    create(config, Space::Discrete { n: STATES }, Space::Discrete { n: ACTIONS }).unwrap()
}

fn one_hot(state: usize) -> Vec<f32> {
    (0..STATES).map(|index| f32::from(index == state)).collect()
}

/// A transition with a counted outcome.
#[derive(Clone, Copy)]
struct Row {
    from: (usize, usize),
    to: (usize, usize),
    success: f32,
    continuation: f32,
    outcome: f32,
}

impl Attempts {
    fn new(rows: &[Row], members: usize) -> Self {
        Self {
            size: rows.len(),
            observations: rows.iter().flat_map(|row| one_hot(row.from.0)).collect(),
            actions: rows.iter().map(|row| row.from.1 as f32).collect(),
            next_observations: rows.iter().flat_map(|row| one_hot(row.to.0)).collect(),
            next_actions: rows.iter().map(|row| row.to.1 as f32).collect(),
            successes: rows.iter().map(|row| row.success).collect(),
            continuations: rows.iter().map(|row| row.continuation).collect(),
            outcomes: rows.iter().map(|row| row.outcome).collect(),
            outcome_weights: vec![1.0; rows.len()],
            masks: vec![1.0; rows.len() * members],
        }
    }

    /// Random transitions: one succeeds, one ends.
    fn random(seed: u64, members: usize) -> Self {
        let mut rng = Pcg64::seed_from_u64(seed);
        let rows: Vec<Row> = (0..16)
            .map(|row| {
                let mut place = || (rng.random_range(0..STATES), rng.random_range(0..ACTIONS));
                let (from, to) = (place(), place());
                let (success, continuation) = (f32::from(row == 2), f32::from(row != 3));
                Row { from, to, success, continuation, outcome: f32::from(row % 2 == 0) }
            })
            .collect();
        Self::new(&rows, members)
    }
}

fn probabilities(critic: &mut SuccessTables, state: usize, action: usize) -> Vec<f32> {
    let mut probabilities = vec![9.0; critic.info().members];
    critic.probabilities(&one_hot(state), &[action as f32], &mut probabilities).unwrap();
    probabilities
}

#[test]
fn before_anything_was_learned_it_is_the_initial_probability_everywhere() {
    assert_eq!(probabilities(&mut critic("()"), 3, 2), [0.88; 5]);
    assert_eq!(probabilities(&mut critic("(initial_probability: 0.3, members: 2)"), 0, 0), [0.3; 2]);
}

#[test]
fn each_member_goes_its_step_towards_its_target() {
    let mut critic = critic("(initial_probability: 0.5, discount: 0.9, outcome_weight: 0.6, members: 2)");
    // The second member has another estimate of (1, 1) than the first: half of the way from 0.5 to 1.
    let success = Row { from: (1, 1), to: (0, 0), success: 1.0, continuation: 0.0, outcome: 1.0 };
    let mut attempts = Attempts::new(&[success], 2);
    attempts.masks[0] = 0.0;
    critic.update(&attempts.batch()).unwrap();
    assert_eq!(probabilities(&mut critic, 1, 1), [0.5, 0.75]);

    let step = Row { from: (2, 0), to: (1, 1), success: 0.0, continuation: 1.0, outcome: 1.0 };
    let mut attempts = Attempts::new(&[step], 2);
    attempts.outcome_weights[0] = 0.5;
    let check = |found: Vec<f32>, expected: [f32; 2]| {
        assert!(found.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-6), "{found:?} {expected:?}");
    };
    let targets = [0.3 + 0.7 * 0.9 * 0.5, 0.3 + 0.7 * 0.9 * 0.75];
    // What a value begins with counts as a visit: the mean of 0.5 and the targets so far.
    critic.update(&attempts.batch()).unwrap();
    check(probabilities(&mut critic, 2, 0), targets.map(|target| (0.5 + target) / 2.0));
    critic.update(&attempts.batch()).unwrap();
    check(probabilities(&mut critic, 2, 0), targets.map(|target| (0.5 + 2.0 * target) / 3.0));

    let end = Row { from: (3, 0), to: (1, 1), success: 0.0, continuation: 0.0, outcome: 0.0 };
    critic.update(&Attempts::new(&[end], 2).batch()).unwrap();
    assert_eq!(probabilities(&mut critic, 3, 0), [0.25; 2]);
}

/// Ten places in a row. From the left half the reset agent goes left, and the place 0 is the reset set. In the right half it goes back and forth
/// until its time is over, which ends nothing. Returns P in the middle of either half.
fn learn_two_halves(config: &str) -> [f32; 2] {
    let mut critic = critic(config);
    let row = |index: usize| {
        let is_left = index < 5;
        let next = if is_left { index - 1 } else { 5 + (index - 4) % 5 };
        let success = f32::from(next == 0);
        let outcome = f32::from(is_left);
        Row { from: (index, 0), to: (next, 0), success, continuation: 1.0 - success, outcome }
    };
    let attempts = Attempts::new(&(1..STATES).map(row).collect::<Vec<_>>(), 5);
    (0..1_000).for_each(|_| critic.update(&attempts.batch()).unwrap());
    [2, 7].map(|index| mean(&probabilities(&mut critic, index, 0)))
}

#[test]
fn outcomes_separate_where_there_is_a_way_back_from_where_there_is_none() {
    let [left, right] = learn_two_halves("()");
    assert!(left > 0.95 && right < 0.05, "{left} {right}");
}

#[test]
fn without_outcomes_a_place_without_a_way_back_lives_on_its_own_estimates() {
    let [left, right] = learn_two_halves("(outcome_weight: 0.0)");
    assert!(left > 0.9 && right > 0.8, "{left} {right}");
}

#[test]
fn probabilities_become_the_frequencies_of_random_outcomes() {
    let frequencies = [0.1, 0.3, 0.5, 0.7, 0.9];
    for seed in 0..5 {
        let mut rng = Pcg64::seed_from_u64(seed);
        let mut critic = critic("()");
        for _ in 0..1_000 {
            let rows: Vec<Row> = (0..20)
                .map(|row| {
                    let place = (row % 5, 1);
                    let outcome = f32::from(rng.random::<f32>() < frequencies[row % 5]);
                    Row { from: place, to: place, success: 0.0, continuation: 1.0, outcome }
                })
                .collect();
            let mut attempts = Attempts::new(&rows, 5);
            attempts.masks.fill_with(|| f32::from(rng.random::<f32>() < 0.8));
            critic.update(&attempts.batch()).unwrap();
        }
        for (state, frequency) in frequencies.into_iter().enumerate() {
            let found = probabilities(&mut critic, state, 1);
            assert!((mean(&found) - frequency).abs() < 0.05, "{found:?} instead of {frequency}");
            assert!(found.windows(2).any(|pair| pair[0] != pair[1]), "masks make the members differ");
        }
    }
}

#[test]
fn a_better_reset_agent_is_noticed_however_long_it_failed() {
    let mut critic = critic("()");
    let ends = [0.0, 1.0].map(|outcome| {
        let row = Row { from: (4, 0), to: (4, 0), success: 0.0, continuation: 1.0, outcome };
        Attempts::new(&[row], 5)
    });
    (0..20_000).for_each(|_| critic.update(&ends[0].batch()).unwrap());
    assert!(mean(&probabilities(&mut critic, 4, 0)) < 0.01);
    (0..600).for_each(|_| critic.update(&ends[1].batch()).unwrap());
    assert!(mean(&probabilities(&mut critic, 4, 0)) > 0.8);
}

#[test]
fn an_outcome_without_weight_is_ignored() {
    let learned = |outcome: f32| {
        let mut critic = critic("()");
        let mut attempts = Attempts::random(1, 5);
        attempts.outcome_weights.fill(0.0);
        attempts.outcomes.fill(outcome);
        (0..3).for_each(|_| critic.update(&attempts.batch()).unwrap());
        saved(&critic)
    };
    assert_eq!(learned(0.0), learned(1.0));
}

#[test]
fn a_member_learns_only_what_its_mask_allows() {
    let update = |masked: bool| {
        let mut critic = critic("()");
        let mut attempts = Attempts::random(1, 5);
        if masked {
            (0..attempts.size).for_each(|row| attempts.masks[row * 5 + 1] = 0.0);
        }
        critic.update(&attempts.batch()).unwrap();
        critic
    };
    let (mut whole, mut masked) = (update(false), update(true));
    let cells = STATES * ACTIONS;
    assert!(masked.tables[cells..2 * cells].iter().all(|value| *value == 0.88));
    assert!(masked.visits[cells..2 * cells].iter().all(|count| *count == 0.0));
    masked.tables[cells..2 * cells].copy_from_slice(&whole.tables[cells..2 * cells]);
    assert_eq!(whole.tables, masked.tables, "members influence each other");
    let attempts = Attempts::random(1, 5);
    let (state, action) =
        (attempts.observations[..STATES].iter().position(|x| *x == 1.0), attempts.actions[0]);
    assert!(probabilities(&mut whole, state.unwrap(), action as usize).iter().all(|value| *value != 0.88));
}

#[test]
fn probabilities_stay_between_0_and_1() {
    for config in ["()", "(least_step: 1.0, discount: 1.0, outcome_weight: 0.3, initial_probability: 1.0)"] {
        let mut critic = critic(config);
        for seed in 0..500 {
            critic.update(&Attempts::random(seed, 5).batch()).unwrap();
            assert!(critic.tables.iter().all(|value| (0.0..=1.0).contains(value)));
        }
    }
}

#[test]
fn it_has_no_gradient() {
    let error = critic("()").gradients(&one_hot(0), &[0.0], &mut [0.0; 5], &mut [0.0; 5]).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Unsupported);
}

#[test]
fn a_broken_batch_is_refused_and_changes_nothing() {
    let mut critic = critic("()");
    critic.update(&Attempts::random(2, 5).batch()).unwrap();
    let before = saved(&critic);
    let breaks: [fn(&mut Attempts); 15] = [
        |a| a.observations[STATES * 9] = f32::NAN,
        |a| a.observations[..STATES].fill(0.0),
        |a| a.next_observations[..STATES].fill(1.0),
        |a| a.actions[15] = 3.0,
        |a| a.actions[15] = f32::NAN,
        |a| a.next_actions[15] = 0.5,
        |a| a.next_actions.truncate(3),
        |a| a.successes[1] = f32::NAN,
        |a| a.continuations[2] = 2.0,
        |a| a.outcomes[7] = f32::NAN,
        |a| a.outcomes[7] = -1.0,
        |a| a.outcome_weights[7] = f32::NAN,
        |a| a.outcome_weights[7] = 1.5,
        |a| a.masks[3] = f32::NAN,
        |a| a.masks.truncate(16),
    ];
    for (index, damage) in breaks.iter().enumerate() {
        let mut attempts = Attempts::random(1, 5);
        damage(&mut attempts);
        let error = critic.update(&attempts.batch()).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::InvalidArgument, "{index}");
        assert_eq!(before, saved(&critic), "{index}");
    }
    assert!(critic.update(&AttemptBatch { size: 0, ..Attempts::random(1, 5).batch() }).is_err());
    assert!(critic.probabilities(&[f32::NAN; STATES], &[1.0], &mut [0.0; 5]).is_err());
    assert!(critic.probabilities(&one_hot(1), &[f32::NAN], &mut [0.0; 5]).is_err());
    assert!(critic.probabilities(&one_hot(1), &[1.0], &mut [0.0; 4]).is_err());
    assert_eq!(before, saved(&critic));
}

#[test]
fn a_loaded_critic_continues_bit_for_bit() {
    let mut uninterrupted = critic("()");
    (0..3).for_each(|seed| uninterrupted.update(&Attempts::random(seed, 5).batch()).unwrap());
    let mut continued = critic("()");
    continued.load(&saved(&uninterrupted)).unwrap();
    for critic in [&mut uninterrupted, &mut continued] {
        (3..6).for_each(|seed| critic.update(&Attempts::random(seed, 5).batch()).unwrap());
    }
    assert_eq!(saved(&uninterrupted), saved(&continued));
}

#[test]
fn foreign_bytes_are_refused_and_change_nothing() {
    let mut original = critic("()");
    let before = saved(&original);
    let mut too_long = before.clone();
    too_long.push(0);
    let cut = before[..before.len() - 1].to_vec();
    let mut not_a_number = before.clone();
    not_a_number[40..44].fill(0xff);
    let other_shape = saved(&critic("(members: 4)"));
    for bad in [Vec::new(), b"something else".to_vec(), cut, too_long, not_a_number, other_shape] {
        assert!(original.load(&bad).is_err(), "{} bytes", bad.len());
        assert_eq!(before, saved(&original));
    }
}

#[test]
fn every_configuration_field_changes_the_behaviour() {
    let behaviour = |config: &str| {
        let mut critic = critic(config);
        let members = critic.info().members;
        (0..300).for_each(|round| critic.update(&Attempts::random(round % 3, members).batch()).unwrap());
        saved(&critic)
    };
    let reference = behaviour("()");
    assert_eq!(reference, behaviour("()"));
    let changes = [
        ("members", "4"),
        ("discount", "0.9"),
        ("outcome_weight", "0.3"),
        ("initial_probability", "0.5"),
        ("least_step", "0.1"),
    ];
    for field in TabularSuccessConfig::FIELDS {
        let tried = changes.iter().find(|(name, _)| *name == field.name);
        let (name, value) = tried.unwrap_or_else(|| panic!("{} is not tried", field.name));
        assert_ne!(reference, behaviour(&format!("({name}: {value})")), "{name} changes nothing");
    }
}

#[test]
fn the_manifest_states_the_defaults() {
    let text: Vec<String> = TabularSuccessConfig::FIELDS
        .iter()
        .map(|field| format!("{}: {}", field.name, field.default))
        .collect();
    let parsed = TabularSuccessConfig::parse(&format!("({})", text.join(", "))).unwrap();
    assert_eq!(format!("{parsed:?}"), format!("{:?}", TabularSuccessConfig::default()));
}

#[test]
fn impossible_settings_and_spaces_are_refused() {
    let discrete = || Space::Discrete { n: 3 };
    for setting in
        ["members: 0", "discount: NaN", "outcome_weight: 1.5", "initial_probability: -0.1", "least_step: 2.0"]
    {
        let error = create(&format!("({setting})"), discrete(), discrete()).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::InvalidConfig, "{setting}");
        assert_eq!(error.field(), setting.split(':').next(), "{setting}");
    }
    let boxed = || Space::uniform(3, 0.0, 1.0);
    for (observation, action, named) in
        [(boxed(), discrete(), "observation"), (discrete(), boxed(), "action")]
    {
        let error = create("()", observation, action).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::InvalidArgument);
        assert!(error.message().contains(named), "{error}");
    }
}

#[test]
fn after_the_first_call_nothing_is_allocated() {
    let mut critic = critic("()");
    let attempts = Attempts::random(1, 5);
    let (observation, mut place) = (one_hot(1), [0.0; 5]);
    let mut round = || {
        critic.update(&attempts.batch()).unwrap();
        critic.probabilities(&observation, &[1.0], &mut place).unwrap();
    };
    round();
    let counted = allocation_counter::measure(|| (0..20).for_each(|_| round()));
    assert_eq!(counted.count_total, 0);
}
