use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use shield_api::{
    ActMode, Batch, Checkpoint, ErrorKind, Host, Learner, Plugin, PluginConfig, Setup, Space, Spaces,
};

use crate::{TabularQ, TabularQConfig};

const STATES: usize = 4;
const ACTIONS: usize = 3;

fn setup(seed: u64, observation: Space, action: Space) -> Setup {
    Setup::with_spaces(seed, 1, Host::silent(), Spaces { observation, action })
}

fn learner(config: &str, seed: u64) -> TabularQ {
    let setup = setup(seed, Space::Discrete { n: STATES }, Space::Discrete { n: ACTIONS });
    TabularQ::create(TabularQConfig::parse(config).unwrap(), &setup).unwrap()
}

fn one_hot(state: usize) -> Vec<f32> {
    (0..STATES).map(|index| f32::from(index == state)).collect()
}

/// Transitions as (state, action, reward, next state, continuation).
struct Transitions {
    size: usize,
    observations: Vec<f32>,
    actions: Vec<f32>,
    rewards: Vec<f32>,
    next_observations: Vec<f32>,
    continuations: Vec<f32>,
    masks: Vec<f32>,
}

impl Transitions {
    fn new(rows: &[(usize, usize, f32, usize, f32)], members: usize) -> Self {
        Self {
            size: rows.len(),
            observations: rows.iter().flat_map(|row| one_hot(row.0)).collect(),
            actions: rows.iter().map(|row| row.1 as f32).collect(),
            rewards: rows.iter().map(|row| row.2).collect(),
            next_observations: rows.iter().flat_map(|row| one_hot(row.3)).collect(),
            continuations: rows.iter().map(|row| row.4).collect(),
            masks: vec![1.0; rows.len() * members],
        }
    }

    fn random(seed: u64, members: usize) -> Self {
        let mut rng = Pcg64::seed_from_u64(seed);
        let rows: Vec<_> = (0..16)
            .map(|row| {
                let (state, action) = (rng.random_range(0..STATES), rng.random_range(0..ACTIONS));
                (state, action, rng.random::<f32>(), rng.random_range(0..STATES), f32::from(row != 3))
            })
            .collect();
        Self::new(&rows, members)
    }

    fn batch(&self) -> Batch<'_> {
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

fn act(learner: &mut TabularQ, state: usize, mode: ActMode) -> usize {
    let mut action = [9.0];
    learner.act(&one_hot(state), mode, &mut action).unwrap();
    Space::Discrete { n: ACTIONS }.action_index(&action).unwrap()
}

fn values(learner: &mut TabularQ, state: usize, action: usize) -> Vec<f32> {
    let mut values = vec![9.0; learner.info().members];
    learner.q_values(&one_hot(state), &[action as f32], &mut values).unwrap();
    values
}

fn saved(learner: &TabularQ) -> Vec<u8> {
    let mut bytes = Vec::new();
    learner.save(&mut bytes).unwrap();
    bytes
}

fn behaviour(config: &str) -> Vec<u32> {
    let mut learner = learner(config, 3);
    let members = learner.info().members;
    let mut seen = vec![learner.info().discount.to_bits()];
    for round in 0..3 {
        seen.extend((0..40).map(|step| act(&mut learner, step % STATES, ActMode::Explore) as u32));
        seen.extend(values(&mut learner, 1, 1).into_iter().map(f32::to_bits));
        learner.update(&Transitions::random(round, members).batch()).unwrap();
    }
    seen
}

#[test]
fn every_configuration_field_changes_the_behaviour() {
    let reference = behaviour("(epsilon_steps: 60)");
    assert_eq!(reference, behaviour("(epsilon_steps: 60)"));
    let changes = [
        ("members", "(epsilon_steps: 60, members: 4)"),
        ("learning_rate", "(epsilon_steps: 60, learning_rate: 0.4)"),
        ("discount", "(epsilon_steps: 60, discount: 0.9)"),
        ("initial_low", "(epsilon_steps: 60, initial_low: 0.5)"),
        ("initial_high", "(epsilon_steps: 60, initial_high: 2.0)"),
        ("epsilon", "(epsilon_steps: 60, epsilon: 0.9)"),
        ("final_epsilon", "(epsilon_steps: 60, final_epsilon: 0.9)"),
        ("epsilon_steps", "(epsilon_steps: 0)"),
    ];
    for field in TabularQConfig::FIELDS {
        assert!(changes.iter().any(|(name, _)| *name == field.name), "{} is not tried", field.name);
    }
    for (name, config) in changes {
        assert_ne!(reference, behaviour(config), "{name} changes nothing");
    }
}

#[test]
fn the_manifest_states_the_defaults() {
    let text: Vec<String> =
        TabularQConfig::FIELDS.iter().map(|field| format!("{}: {}", field.name, field.default)).collect();
    let parsed = TabularQConfig::parse(&format!("({})", text.join(", "))).unwrap();
    assert_eq!(format!("{parsed:?}"), format!("{:?}", TabularQConfig::default()));
}

#[test]
fn impossible_settings_and_spaces_are_refused() {
    let discrete = || Space::Discrete { n: 3 };
    for setting in [
        "members: 0",
        "learning_rate: 1.5",
        "discount: NaN",
        "epsilon: -0.1",
        "final_epsilon: 2.0",
        "initial_low: 2.0",
        "initial_high: inf",
        "initial_low: -inf",
        "initial_low: -3e38, initial_high: 3e38",
    ] {
        let config = TabularQConfig::parse(&format!("({setting})")).unwrap();
        let error = TabularQ::create(config, &setup(0, discrete(), discrete())).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::InvalidConfig, "{setting}");
    }
    let boxed = || Space::uniform(3, 0.0, 1.0);
    for (observation, action, named) in
        [(boxed(), discrete(), "observation"), (discrete(), boxed(), "action")]
    {
        let error = TabularQ::create(TabularQConfig::default(), &setup(0, observation, action)).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::InvalidArgument);
        assert!(error.message().contains(named), "{error}");
    }
}

#[test]
fn an_update_follows_watkins_rule_for_each_member() {
    let mut learner = learner("(learning_rate: 0.25, discount: 0.5)", 3);
    let mut expected = Vec::new();
    let best_next: Vec<f32> = (0..5)
        .map(|member| (0..ACTIONS).map(|a| values(&mut learner, 2, a)[member]).fold(0.0, f32::max))
        .collect();
    for (member, value) in values(&mut learner, 0, 1).into_iter().enumerate() {
        let target = 1.0 + 0.5 * best_next[member];
        expected.push(if member == 3 { value } else { value + 0.25 * (target - value) });
    }
    let mut transitions = Transitions::new(&[(0, 1, 1.0, 2, 1.0)], 5);
    transitions.masks[3] = 0.0;
    learner.update(&transitions.batch()).unwrap();
    let found = values(&mut learner, 0, 1);
    assert!(found.iter().zip(&expected).all(|(a, b)| (a - b).abs() < 1e-6), "{found:?} {expected:?}");
}

#[test]
fn a_terminal_transition_has_no_next_value() {
    let mut learner = learner("(learning_rate: 1.0, initial_low: 7.0, initial_high: 8.0)", 3);
    learner.update(&Transitions::new(&[(0, 1, 0.25, 2, 0.0)], 5).batch()).unwrap();
    assert_eq!(values(&mut learner, 0, 1), [0.25; 5]);
}

/// A corridor of four states; moving right from the last but one pays 1. Staying or moving left pays nothing.
#[test]
fn the_learner_finds_the_way_through_a_corridor() {
    let mut rows = Vec::new();
    for state in 0..STATES - 1 {
        rows.push((state, 0, 0.0, state.saturating_sub(1), 1.0));
        rows.push((state, 1, 0.0, state, 1.0));
        let is_last = state + 2 == STATES;
        rows.push((state, 2, f32::from(is_last), state + 1, f32::from(!is_last)));
    }
    let mut learner = learner("(discount: 0.9)", 3);
    let transitions = Transitions::new(&rows, 5);
    (0..200).for_each(|_| learner.update(&transitions.batch()).unwrap());
    for state in 0..STATES - 1 {
        assert_eq!(act(&mut learner, state, ActMode::Greedy), 2);
        let expected = 0.9_f32.powi((STATES - 2 - state) as i32);
        assert!(values(&mut learner, state, 2).iter().all(|value| (value - expected).abs() < 1e-3));
    }
}

#[test]
fn a_broken_batch_is_refused_and_changes_nothing() {
    let mut learner = learner("()", 3);
    let before = saved(&learner);
    let breaks: [fn(&mut Transitions); 9] = [
        |t| t.observations[STATES * 9] = f32::NAN,
        |t| t.observations[..STATES].fill(0.0),
        |t| t.next_observations[..STATES].fill(1.0),
        |t| t.actions[15] = 3.0,
        |t| t.actions[15] = 0.5,
        |t| t.rewards[2] = f32::NAN,
        |t| t.continuations[2] = f32::NAN,
        |t| t.masks[3] = f32::NAN,
        |t| t.masks.truncate(16),
    ];
    for (index, damage) in breaks.iter().enumerate() {
        let mut transitions = Transitions::random(1, 5);
        damage(&mut transitions);
        let error = learner.update(&transitions.batch()).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::InvalidArgument, "{index}");
        assert_eq!(before, saved(&learner), "{index}");
    }
    assert!(learner.act(&[f32::NAN, 0.0, 0.0, 1.0], ActMode::Explore, &mut [0.0]).is_err());
    assert!(learner.q_values(&one_hot(1), &[f32::NAN], &mut [0.0; 5]).is_err());
    assert!(learner.q_values(&one_hot(1), &[1.0], &mut [0.0; 4]).is_err());
    assert_eq!(before, saved(&learner));
}

#[test]
fn a_loaded_learner_continues_bit_for_bit() {
    let mut uninterrupted = learner("(epsilon: 1.0)", 3);
    (0..10).for_each(|_| assert!(act(&mut uninterrupted, 0, ActMode::Explore) < ACTIONS));
    uninterrupted.update(&Transitions::random(1, 5).batch()).unwrap();
    let mut continued = learner("(epsilon: 1.0)", 4);
    continued.load(&saved(&uninterrupted)).unwrap();
    let go_on = |learner: &mut TabularQ| -> Vec<usize> {
        learner.update(&Transitions::random(2, 5).batch()).unwrap();
        (0..50).map(|_| act(learner, 1, ActMode::Explore)).collect()
    };
    assert_eq!(go_on(&mut uninterrupted), go_on(&mut continued));
    assert_eq!(saved(&uninterrupted), saved(&continued));
}

#[test]
fn foreign_bytes_are_refused_and_change_nothing() {
    let mut original = learner("()", 3);
    let before = saved(&original);
    let mut too_long = before.clone();
    too_long.push(0);
    let cut = before[..before.len() - 1].to_vec();
    let other_shape = saved(&learner("(members: 4)", 3));
    for bad in [Vec::new(), b"something else".to_vec(), cut, too_long, other_shape] {
        assert!(original.load(&bad).is_err(), "{} bytes", bad.len());
        assert_eq!(before, saved(&original));
    }
}

#[test]
fn a_greedy_action_draws_no_random_number_and_prefers_the_first_of_equals() {
    let mut learner = learner("(initial_low: 0.5, initial_high: 0.5)", 3);
    let before = saved(&learner);
    assert_eq!(act(&mut learner, 0, ActMode::Greedy), 0);
    assert_eq!(before, saved(&learner));
}

#[test]
fn exploration_is_as_frequent_as_epsilon_says() {
    let mut learner = learner("(epsilon: 0.6, final_epsilon: 0.15, epsilon_steps: 10000)", 3);
    let greedy = act(&mut learner, 0, ActMode::Greedy);
    let mut others = |steps: usize| {
        let count = (0..steps).filter(|_| act(&mut learner, 0, ActMode::Explore) != greedy).count();
        count as f64 / steps as f64
    };
    // Two of three uniform actions differ from the greedy one.
    assert!((others(10_000) - 2.0 / 3.0 * 0.375).abs() < 0.02);
    assert!((others(10_000) - 2.0 / 3.0 * 0.15).abs() < 0.02);
}

#[test]
fn after_the_first_call_nothing_is_allocated() {
    let mut learner = learner("()", 3);
    let transitions = Transitions::random(1, 5);
    let (observation, mut action, mut values) = (one_hot(1), [0.0], [0.0; 5]);
    let mut round = || {
        learner.update(&transitions.batch()).unwrap();
        learner.q_values(&observation, &[1.0], &mut values).unwrap();
        learner.act(&observation, ActMode::Explore, &mut action).unwrap();
        learner.act(&observation, ActMode::Greedy, &mut action).unwrap();
    };
    round();
    let counted = allocation_counter::measure(|| (0..20).for_each(|_| round()));
    assert_eq!(counted.count_total, 0);
}
