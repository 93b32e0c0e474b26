use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use shield_api::{
    ActMode, Batch, Checkpoint, ErrorKind, Host, Learner, Plugin, PluginConfig, Setup, Space, Spaces,
};

use crate::{Ddpg, DdpgConfig};

mod timing;

const OBSERVATION: usize = 3;
const ACTION: usize = 2;
const SIZE: usize = 8;

fn spaces() -> Spaces {
    let action = Space::Box { low: vec![-2.0, 0.0], high: vec![2.0, 1.0] };
    Spaces { observation: Space::unbounded(OBSERVATION), action }
}

fn learner(config: &str, seed: u64, threads: usize) -> Ddpg {
    let setup = Setup::with_spaces(seed, threads, Host::silent(), spaces());
    Ddpg::create(DdpgConfig::parse(config).unwrap(), &setup).unwrap()
}

const SMALL: &str = "(critics: 3, actor_hidden: [20, 15], critic_hidden: [20, 15], random_steps: 2)";

/// The small configuration with one more setting.
fn small_with(setting: &str) -> String {
    format!("(actor_hidden: [20, 15], critic_hidden: [20, 15], {setting})")
}

struct Transitions {
    members: usize,
    observations: Vec<f32>,
    actions: Vec<f32>,
    rewards: Vec<f32>,
    next_observations: Vec<f32>,
    continuations: Vec<f32>,
    masks: Vec<f32>,
}

impl Transitions {
    fn random(members: usize, seed: u64) -> Self {
        let mut rng = Pcg64::seed_from_u64(seed);
        let mut floats = |length, low, high| (0..length).map(|_| rng.random_range(low..high)).collect();
        Self {
            members,
            observations: floats(SIZE * OBSERVATION, -1.0, 1.0),
            actions: floats(SIZE * ACTION, 0.0, 1.0),
            rewards: floats(SIZE, -3.0, 3.0),
            next_observations: floats(SIZE * OBSERVATION, -1.0, 1.0),
            continuations: (0..SIZE).map(|row| if row == 3 { 0.0 } else { 1.0 }).collect(),
            masks: (0..SIZE * members).map(|index| if index % 5 == 1 { 0.0 } else { 1.0 }).collect(),
        }
    }

    fn batch(&self) -> Batch<'_> {
        assert_eq!(self.masks.len(), SIZE * self.members);
        Batch {
            size: SIZE,
            observations: &self.observations,
            actions: &self.actions,
            rewards: &self.rewards,
            next_observations: &self.next_observations,
            continuations: &self.continuations,
            masks: &self.masks,
        }
    }
}

fn train(learner: &mut Ddpg, seeds: std::ops::Range<u64>) {
    for seed in seeds {
        learner.update(&Transitions::random(learner.info().members, seed).batch()).unwrap();
    }
}

fn act(learner: &mut Ddpg, mode: ActMode) -> [f32; ACTION] {
    let mut action = [0.0; ACTION];
    learner.act(&[0.3, -0.2, 0.7], mode, &mut action).unwrap();
    action
}

fn values(learner: &mut Ddpg) -> Vec<f32> {
    let mut values = vec![0.0; learner.info().members];
    learner.q_values(&[0.3, -0.2, 0.7], &[0.5, 0.5], &mut values).unwrap();
    values
}

fn saved(learner: &Ddpg) -> Vec<u8> {
    let mut bytes = Vec::new();
    learner.save(&mut bytes).unwrap();
    bytes
}

/// Everything that can be seen of a learner: its answers before and after some updates.
fn behaviour(config: &str) -> Vec<u32> {
    let mut learner = learner(config, 5, 1);
    let mut seen = vec![learner.info().discount.to_bits()];
    for round in 0..3 {
        for _ in 0..3 {
            seen.extend(act(&mut learner, ActMode::Explore).map(f32::to_bits));
        }
        seen.extend(act(&mut learner, ActMode::Greedy).map(f32::to_bits));
        seen.extend(values(&mut learner).into_iter().map(f32::to_bits));
        train(&mut learner, 2 * round..2 * round + 2);
    }
    seen
}

#[test]
fn every_configuration_field_changes_what_can_be_seen() {
    let base = "critics: 3, random_steps: 0, final_sigma: Some(0.1), sigma_steps: 7";
    let reference = behaviour(&small_with(base));
    assert_eq!(reference, behaviour(&small_with(base)));
    let changes = [
        ("critics", "(actor_hidden: [20, 15], critic_hidden: [20, 15], random_steps: 0, final_sigma: Some(0.1), sigma_steps: 7, critics: 4)"),
        ("actor_hidden", "(actor_hidden: [20, 16], critic_hidden: [20, 15], critics: 3, random_steps: 0, final_sigma: Some(0.1), sigma_steps: 7)"),
        ("critic_hidden", "(actor_hidden: [20, 15], critic_hidden: [20], critics: 3, random_steps: 0, final_sigma: Some(0.1), sigma_steps: 7)"),
        ("random_steps", "(actor_hidden: [20, 15], critic_hidden: [20, 15], critics: 3, random_steps: 2, final_sigma: Some(0.1), sigma_steps: 7)"),
        ("final_sigma", "(actor_hidden: [20, 15], critic_hidden: [20, 15], critics: 3, random_steps: 0, final_sigma: Some(0.05), sigma_steps: 7)"),
        ("sigma_steps", "(actor_hidden: [20, 15], critic_hidden: [20, 15], critics: 3, random_steps: 0, final_sigma: Some(0.1), sigma_steps: 5)"),
    ]
    .map(|(name, config)| (name, config.to_string()));
    let additions = [
        ("activation", "activation: Relu"),
        ("actor_rate", "actor_rate: 2e-4"),
        ("critic_rate", "critic_rate: 2e-3"),
        ("discount", "discount: 0.9"),
        ("tau", "tau: 0.5"),
        ("loss", "loss: Squared"),
        ("noise", "noise: OrnsteinUhlenbeck(theta: 0.5)"),
        ("sigma", "sigma: 0.3"),
        ("initial_value", "initial_value: Some(4.0)"),
        ("gradient_clip", "gradient_clip: Some(1e-8)"),
        ("normalise_observations", "normalise_observations: true"),
    ]
    .map(|(name, setting)| (name, small_with(&format!("{base}, {setting}"))));

    let tried: Vec<&str> = changes.iter().chain(&additions).map(|(name, _)| *name).collect();
    for field in DdpgConfig::FIELDS {
        assert!(tried.contains(&field.name), "{} is not tried", field.name);
    }
    for (name, config) in changes.iter().chain(&additions) {
        assert_ne!(reference, behaviour(config), "{name} changes nothing");
    }
}

#[test]
fn defaults_that_the_manifest_states_are_the_defaults() {
    let text: Vec<String> =
        DdpgConfig::FIELDS.iter().map(|field| format!("{}: {}", field.name, field.default)).collect();
    let parsed = DdpgConfig::parse(&format!("({})", text.join(", "))).unwrap();
    assert_eq!(format!("{parsed:?}"), format!("{:?}", DdpgConfig::default()));
}

#[test]
fn impossible_settings_and_spaces_are_refused() {
    let setup = Setup::with_spaces(0, 1, Host::silent(), spaces());
    for setting in [
        "critics: 0",
        "actor_hidden: []",
        "critic_hidden: [5, 0]",
        "actor_rate: 0.0",
        "critic_rate: NaN",
        "discount: 1.5",
        "tau: 0.0",
        "sigma: -1.0",
        "final_sigma: Some(NaN)",
        "noise: OrnsteinUhlenbeck(theta: 2.0)",
        "initial_value: Some(inf)",
        "gradient_clip: Some(0.0)",
    ] {
        let config = DdpgConfig::parse(&format!("({setting})")).unwrap();
        assert_eq!(Ddpg::create(config, &setup).unwrap_err().kind(), ErrorKind::InvalidConfig, "{setting}");
    }
    for action in [Space::Discrete { n: 4 }, Space::unbounded(2)] {
        let spaces = Spaces { observation: Space::unbounded(3), action };
        let setup = Setup::with_spaces(0, 1, Host::silent(), spaces);
        let error = Ddpg::create(DdpgConfig::default(), &setup).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::InvalidArgument);
    }
}

#[test]
fn a_broken_batch_is_refused_and_nothing_has_changed() {
    let mut learner = learner(&small_with("critics: 3, normalise_observations: true"), 5, 1);
    train(&mut learner, 0..2);
    let before = saved(&learner);
    let breaks: [fn(&mut Transitions); 9] = [
        |t| t.observations[4] = f32::NAN,
        |t| t.actions[1] = f32::INFINITY,
        |t| t.rewards[7] = f32::NAN,
        |t| t.next_observations[0] = f32::NEG_INFINITY,
        |t| t.continuations[2] = f32::NAN,
        |t| t.continuations[2] = 2.0,
        |t| t.masks[5] = f32::NAN,
        |t| t.masks[5] = -1.0,
        |t| t.rewards.truncate(3),
    ];
    for (index, damage) in breaks.iter().enumerate() {
        let mut transitions = Transitions::random(3, 9);
        damage(&mut transitions);
        let error = learner.update(&transitions.batch()).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::InvalidArgument, "{index}");
        assert_eq!(before, saved(&learner), "{index}");
    }
    let whole = Transitions::random(3, 9);
    assert!(learner.update(&Batch { size: 0, ..whole.batch() }).is_err());
    assert_eq!(before, saved(&learner));
}

#[test]
fn values_that_are_not_finite_are_an_error() {
    let mut learner = learner(SMALL, 5, 1);
    let mut values = [0.0; 3];
    let mut gradients = [0.0; 6];
    assert!(learner.q_values(&[f32::NAN, 0.0, 0.0], &[0.0, 0.0], &mut values).is_err());
    assert!(learner.q_values(&[0.0; 3], &[0.0, f32::NAN], &mut values).is_err());
    assert!(learner.q_values(&[0.0; 2], &[0.0, 0.0], &mut values).is_err());
    assert!(learner.q_gradients(&[0.0; 3], &[0.0, 0.0], &mut values, &mut gradients[..5]).is_err());
    assert!(learner.act(&[f32::NAN, 0.0, 0.0], ActMode::Explore, &mut [0.0; 2]).is_err());
    assert!(learner.act(&[0.0; 3], ActMode::Greedy, &mut [0.0; 3]).is_err());
}

#[test]
fn a_loaded_learner_continues_bit_for_bit() {
    let config = small_with(
        "critics: 3, random_steps: 2, noise: OrnsteinUhlenbeck(theta: 0.15), normalise_observations: true",
    );
    let mut uninterrupted = learner(&config, 5, 1);
    for _ in 0..4 {
        act(&mut uninterrupted, ActMode::Explore);
    }
    train(&mut uninterrupted, 0..3);
    let mut continued = learner(&config, 77, 1);
    continued.load(&saved(&uninterrupted)).unwrap();
    for learner in [&mut uninterrupted, &mut continued] {
        act(learner, ActMode::Explore);
        train(learner, 3..6);
    }
    assert_eq!(act(&mut uninterrupted, ActMode::Explore), act(&mut continued, ActMode::Explore));
    assert_eq!(values(&mut uninterrupted), values(&mut continued));
    assert_eq!(saved(&uninterrupted), saved(&continued));
}

#[test]
fn foreign_bytes_are_refused_and_nothing_has_changed() {
    let mut original = learner(SMALL, 5, 1);
    let before = saved(&original);
    let mut too_long = before.clone();
    too_long.push(0);
    let mut not_a_number = before.clone();
    not_a_number[20..24].fill(0xff);
    let other_shape = saved(&learner(&small_with("critics: 4"), 5, 1));
    let normalised = saved(&learner(&small_with("critics: 3, normalise_observations: true"), 5, 1));
    let cut = before[..before.len() / 2].to_vec();
    for bad in [Vec::new(), b"something else".to_vec(), cut, too_long, not_a_number, other_shape, normalised]
    {
        assert!(original.load(&bad).is_err(), "{} bytes", bad.len());
        assert_eq!(before, saved(&original));
    }
}

#[test]
fn a_greedy_action_draws_no_random_number() {
    let mut learner = learner(SMALL, 5, 1);
    let before = saved(&learner);
    assert_eq!(act(&mut learner, ActMode::Greedy), act(&mut learner, ActMode::Greedy));
    assert_eq!(before, saved(&learner));
    act(&mut learner, ActMode::Explore);
    assert_ne!(before, saved(&learner));
}

#[test]
fn actions_stay_in_their_box_however_loud_the_noise() {
    let mut learner = learner(&small_with("critics: 1, sigma: 5.0, random_steps: 50"), 5, 1);
    let actions: Vec<_> = (0..200).map(|_| act(&mut learner, ActMode::Explore)).collect();
    for action in &actions {
        spaces().action.check_action(action).unwrap();
    }
    let is_inside = |action: &&[f32; ACTION]| action[0].abs() < 2.0 && action[1] > 0.0 && action[1] < 1.0;
    assert_eq!(actions[..50].iter().filter(is_inside).count(), 50, "uniform actions reach the whole box");
    assert!(actions[50..].iter().filter(is_inside).count() < 50, "loud noise reaches the bounds");
}

#[test]
fn gradients_are_those_of_the_values() {
    let mut learner = learner(&small_with("critics: 3, critic_rate: 1e-2"), 5, 1);
    train(&mut learner, 0..60);
    let (observation, action) = ([0.3, -0.2, 0.7], [0.5, 0.6]);
    let (mut plain, mut valued, mut gradients) = ([0.0; 3], [0.0; 3], [0.0; 6]);
    learner.q_values(&observation, &action, &mut plain).unwrap();
    learner.q_gradients(&observation, &action, &mut valued, &mut gradients).unwrap();
    assert_eq!(plain, valued);
    assert!(gradients.iter().any(|x| x.abs() > 0.05), "{gradients:?}");
    for dimension in 0..ACTION {
        const H: f32 = 0.02;
        let mut at = |shift: f32| {
            let (mut moved, mut values) = (action, [0.0; 3]);
            moved[dimension] += shift;
            learner.q_values(&observation, &moved, &mut values).unwrap();
            values
        };
        let (above, below) = (at(H), at(-H));
        for member in 0..3 {
            let expected = (above[member] - below[member]) / (2.0 * H);
            let found = gradients[member * ACTION + dimension];
            assert!((found - expected).abs() < 2e-3 + 0.01 * expected.abs(), "{found} against {expected}");
        }
    }
}

#[test]
fn the_number_of_threads_changes_no_bit() {
    let mut single = learner(SMALL, 5, 1);
    let mut double = learner(SMALL, 5, 2);
    train(&mut single, 0..3);
    train(&mut double, 0..3);
    assert_eq!(saved(&single), saved(&double));
    assert_eq!(values(&mut single), values(&mut double));
}

#[test]
fn a_member_learns_only_what_its_mask_allows() {
    let mut masked = Transitions::random(3, 1);
    (0..SIZE).for_each(|row| masked.masks[row * 3 + 1] = 0.0);
    let mut learner = learner(SMALL, 5, 1);
    let before = values(&mut learner);
    learner.update(&masked.batch()).unwrap();
    let after = values(&mut learner);
    assert_eq!(before[1], after[1]);
    assert_ne!(before[0], after[0]);
    assert_ne!(before[2], after[2]);
}

#[test]
fn after_the_first_call_nothing_is_allocated() {
    let mut learner = learner(&small_with("critics: 3, normalise_observations: true, random_steps: 1"), 5, 1);
    let transitions = Transitions::random(3, 1);
    let mut round = || {
        let (mut values, mut gradients) = ([0.0; 3], [0.0; 6]);
        learner.update(&transitions.batch()).unwrap();
        learner.q_values(&[0.3, -0.2, 0.7], &[0.5, 0.5], &mut values).unwrap();
        learner.q_gradients(&[0.3, -0.2, 0.7], &[0.5, 0.5], &mut values, &mut gradients).unwrap();
        act(&mut learner, ActMode::Explore);
        act(&mut learner, ActMode::Greedy);
    };
    round();
    round();
    let counted = allocation_counter::measure(|| (0..20).for_each(|_| round()));
    assert_eq!(counted.count_total, 0);
}

/// rayon's queue is a list of blocks with room for 63 jobs each.
#[test]
fn with_two_threads_only_the_queue_of_jobs_allocates() {
    let mut learner = learner(SMALL, 5, 2);
    let transitions = Transitions::random(3, 1);
    (0..2).for_each(|_| learner.update(&transitions.batch()).unwrap());
    let updates = || (0..630).for_each(|_| learner.update(&transitions.batch()).unwrap());
    let counted = allocation_counter::measure(updates);
    assert!(counted.count_total <= 11, "{counted:?}");
}

/// One step, reward −(a − 0.3)²: the value has its maximum at 0.3, and the actor must find it.
#[test]
fn the_best_action_of_one_step_is_found() {
    let spaces = Spaces { observation: Space::unbounded(1), action: Space::uniform(1, -1.0, 1.0) };
    let config =
        "(critics: 2, actor_hidden: [20, 15], critic_hidden: [20, 15], actor_rate: 3e-3, critic_rate: 1e-2)";
    let setup = Setup::with_spaces(1, 1, Host::silent(), spaces);
    let mut learner = Ddpg::create(DdpgConfig::parse(config).unwrap(), &setup).unwrap();
    let mut rng = Pcg64::seed_from_u64(2);
    for _ in 0..600 {
        let actions: [f32; 32] = std::array::from_fn(|_| rng.random_range(-1.0..1.0));
        learner
            .update(&Batch {
                size: 32,
                observations: &[1.0; 32],
                actions: &actions,
                rewards: &actions.map(|a| -(a - 0.3).powi(2)),
                next_observations: &[1.0; 32],
                continuations: &[0.0; 32],
                masks: &[1.0; 64],
            })
            .unwrap();
    }
    let mut action = [9.0];
    learner.act(&[1.0], ActMode::Greedy, &mut action).unwrap();
    assert!((action[0] - 0.3).abs() < 0.1, "{action:?}");
    let mut values = [9.0; 2];
    learner.q_values(&[1.0], &[-0.7], &mut values).unwrap();
    assert!(values.iter().all(|value| (value + 1.0).abs() < 0.2), "{values:?} instead of −1");
}

#[test]
fn optimistic_critics_begin_at_the_given_value() {
    let mut learner = learner(&small_with("critics: 3, initial_value: Some(20.0)"), 5, 1);
    assert!(values(&mut learner).iter().all(|value| (value - 20.0).abs() < 0.2));
}

#[test]
fn a_loss_that_overflows_is_an_error_and_leaves_values_finite() {
    let mut learner = learner(&small_with("critics: 3, loss: Squared"), 5, 1);
    let mut transitions = Transitions::random(3, 1);
    transitions.rewards[0] = f32::MAX;
    let before = values(&mut learner);
    assert_eq!(learner.update(&transitions.batch()).unwrap_err().kind(), ErrorKind::Failed);
    let after = values(&mut learner);
    assert!(after.iter().all(|value| value.is_finite()));
    // Transition 0 is masked for member 1 alone; the others have taken no step.
    assert_eq!((before[0], before[2]), (after[0], after[2]));
}
