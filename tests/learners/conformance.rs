//! Tests that every learner with networks passes. Each plugin's own tests include this file, because a plugin is a cdylib
//! and cannot be linked into another test; `conformance_tests!` makes a test of every function here.

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use shield_api::{ActMode, Batch, ErrorKind, Host, Learner, Plugin, PluginConfig, Setup, Space, Spaces};

/// Rows of a batch.
pub const SIZE: usize = 8;

/// What [`act`] and [`values`] are asked about.
pub const OBSERVATION: [f32; 3] = [0.3, -0.2, 0.7];

/// Fields of a configuration and their values.
pub type Settings = Vec<(&'static str, &'static str)>;

/// A learner under test.
pub trait Subject: Learner + Plugin {
    /// A configuration with three members and small networks.
    fn small() -> Settings;
    /// Every field once, with another value than that of `small` or the default; the number of members first.
    fn changes() -> Settings;
    /// Values that cannot be.
    fn impossible() -> Settings;
    /// Fields of which it has the default only, and refuses what `changes` has.
    fn refused() -> &'static [&'static str] {
        &[]
    }
    /// Its spaces: three values of observation, at least two of action or two alternatives.
    fn spaces() -> Spaces;
    /// Action spaces with which it cannot work.
    fn impossible_actions() -> Vec<Space>;
}

/// The small configuration with some settings replaced or added.
pub fn config<L: Subject>(changes: &[(&str, &str)]) -> String {
    let is_changed = |name: &str| changes.iter().any(|(changed, _)| *changed == name);
    let kept = L::small().into_iter().filter(|(name, _)| !is_changed(name));
    let all = kept.chain(changes.iter().copied());
    let fields: Vec<String> = all.map(|(name, value)| format!("{name}: {value}")).collect();
    format!("({})", fields.join(", "))
}

fn create<L: Subject>(changes: &[(&str, &str)], seed: u64, threads: usize) -> shield_api::Result<L> {
    let config = L::Config::parse(&config::<L>(changes)).unwrap();
    L::create(config, &Setup::with_spaces(seed, threads, Host::silent(), L::spaces()))
}

/// A small learner with some settings replaced or added.
pub fn learner<L: Subject>(changes: &[(&str, &str)]) -> L {
    create(changes, 5, 1).unwrap()
}

/// The columns of a batch.
pub struct Transitions {
    pub observations: Vec<f32>,
    pub actions: Vec<f32>,
    pub rewards: Vec<f32>,
    pub next_observations: Vec<f32>,
    pub continuations: Vec<f32>,
    pub masks: Vec<f32>,
}

impl Transitions {
    /// Random ones: one ends an episode, and each member lacks some.
    pub fn random<L: Subject>(members: usize, seed: u64) -> Self {
        let mut rng = Pcg64::seed_from_u64(seed);
        let action_space = L::spaces().action;
        let actions = (0..SIZE * action_space.action_len())
            .map(|_| match &action_space {
                Space::Discrete { n } => rng.random_range(0..*n) as f32,
                Space::Box { .. } => rng.random_range(0.0..1.0),
            })
            .collect();
        let mut floats = |length, bound: f32| (0..length).map(|_| rng.random_range(-bound..bound)).collect();
        Self {
            observations: floats(SIZE * OBSERVATION.len(), 1.0),
            actions,
            rewards: floats(SIZE, 3.0),
            next_observations: floats(SIZE * OBSERVATION.len(), 1.0),
            continuations: (0..SIZE).map(|row| f32::from(row != 3)).collect(),
            masks: (0..SIZE * members).map(|index| f32::from(index % 5 != 1)).collect(),
        }
    }

    pub fn batch(&self) -> Batch<'_> {
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

/// One update per seed, on random transitions.
pub fn train<L: Subject>(learner: &mut L, seeds: std::ops::Range<u64>) {
    for seed in seeds {
        learner.update(&Transitions::random::<L>(learner.info().members, seed).batch()).unwrap();
    }
}

/// An action for a fixed observation.
pub fn act<L: Subject>(learner: &mut L, mode: ActMode) -> Vec<f32> {
    let mut action = vec![9.0; L::spaces().action_len()];
    learner.act(&OBSERVATION, mode, &mut action).unwrap();
    action
}

/// The values of a fixed observation and the action whose components are all 1 (or the alternative 1).
pub fn values<L: Subject>(learner: &mut L) -> Vec<f32> {
    let mut values = vec![9.0; learner.info().members];
    learner.q_values(&OBSERVATION, &vec![1.0; L::spaces().action_len()], &mut values).unwrap();
    values
}

/// The learner's state as bytes.
pub fn saved<L: Subject>(learner: &L) -> Vec<u8> {
    let mut bytes = Vec::new();
    learner.save(&mut bytes).unwrap();
    bytes
}

/// Everything that can be seen of a learner: its answers before and after some updates.
fn behaviour<L: Subject>(changes: &[(&str, &str)]) -> Vec<u32> {
    let mut learner: L = learner(changes);
    let mut seen = vec![learner.info().discount];
    for round in 0..3 {
        (0..3).for_each(|_| seen.extend(act(&mut learner, ActMode::Explore)));
        seen.extend(act(&mut learner, ActMode::Greedy));
        seen.extend(values(&mut learner));
        train(&mut learner, 2 * round..2 * round + 2);
    }
    seen.extend((0..40).flat_map(|_| act(&mut learner, ActMode::Explore)));
    seen.into_iter().map(f32::to_bits).collect()
}

pub fn every_configuration_field_changes_the_behaviour<L: Subject>() {
    let reference = behaviour::<L>(&[]);
    assert_eq!(reference, behaviour::<L>(&[]));
    for field in L::Config::FIELDS {
        let tried = L::changes().into_iter().find(|(name, _)| *name == field.name);
        let change = tried.unwrap_or_else(|| panic!("{} is not tried", field.name));
        if L::refused().contains(&field.name) {
            let kind = create::<L>(&[change], 5, 1).err().map(|error| error.kind());
            assert_eq!(kind, Some(ErrorKind::InvalidConfig), "{change:?}");
            continue;
        }
        assert_ne!(reference, behaviour::<L>(&[change]), "{} changes nothing", field.name);
    }
}

pub fn the_manifest_states_the_defaults<L: Subject>()
where
    L::Config: std::fmt::Debug,
{
    let text: Vec<String> =
        L::Config::FIELDS.iter().map(|field| format!("{}: {}", field.name, field.default)).collect();
    let parsed = L::Config::parse(&format!("({})", text.join(", "))).unwrap();
    assert_eq!(format!("{parsed:?}"), format!("{:?}", L::Config::default()));
}

pub fn impossible_settings_and_spaces_are_refused<L: Subject>() {
    for setting in L::impossible() {
        let kind = create::<L>(&[setting], 5, 1).err().map(|error| error.kind());
        assert_eq!(kind, Some(ErrorKind::InvalidConfig), "{setting:?}");
    }
    for action in L::impossible_actions() {
        let spaces = Spaces { observation: Space::unbounded(3), action };
        let setup = Setup::with_spaces(0, 1, Host::silent(), spaces);
        let kind = L::create(L::Config::default(), &setup).err().map(|error| error.kind());
        assert_eq!(kind, Some(ErrorKind::InvalidArgument));
    }
}

pub fn a_broken_batch_is_refused_and_changes_nothing<L: Subject>() {
    let mut learner: L = learner(&[("normalise_observations", "true")]);
    train(&mut learner, 0..2);
    let before = saved(&learner);
    let breaks: [fn(&mut Transitions); 11] = [
        |t| t.observations[4] = f32::NAN,
        |t| t.actions[1] = f32::INFINITY,
        |t| t.actions[SIZE - 1] = f32::NAN,
        |t| t.rewards[7] = f32::NAN,
        |t| t.next_observations[0] = f32::NEG_INFINITY,
        |t| t.continuations[2] = f32::NAN,
        |t| t.continuations[2] = 2.0,
        |t| t.masks[5] = f32::NAN,
        |t| t.masks[5] = -1.0,
        |t| t.masks.truncate(SIZE),
        |t| t.rewards.truncate(3),
    ];
    for (index, damage) in breaks.iter().enumerate() {
        let mut transitions = Transitions::random::<L>(3, 9);
        damage(&mut transitions);
        let error = learner.update(&transitions.batch()).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::InvalidArgument, "{index}");
        assert_eq!(before, saved(&learner), "{index}");
    }
    let whole = Transitions::random::<L>(3, 9);
    assert!(learner.update(&Batch { size: 0, ..whole.batch() }).is_err());
    assert_eq!(before, saved(&learner));
}

pub fn wrong_arguments_are_refused<L: Subject>() {
    let mut learner: L = learner(&[]);
    let action = vec![1.0; L::spaces().action_len()];
    let not_a_number = vec![f32::NAN; action.len()];
    let refused = |result: shield_api::Result<()>| {
        assert_eq!(result.unwrap_err().kind(), ErrorKind::InvalidArgument);
    };
    let mut values = [0.0; 3];
    refused(learner.q_values(&[f32::NAN, 0.0, 0.0], &action, &mut values));
    refused(learner.q_values(&OBSERVATION, &not_a_number, &mut values));
    refused(learner.q_values(&OBSERVATION[..2], &action, &mut values));
    refused(learner.q_values(&OBSERVATION, &action, &mut values[..2]));
    let mut too_short = vec![0.0; 3 * action.len() - 1];
    assert!(learner.q_gradients(&OBSERVATION, &action, &mut values, &mut too_short).is_err());
    let mut too_long = vec![0.0; action.len() + 1];
    for mode in [ActMode::Explore, ActMode::Greedy] {
        refused(learner.act(&[f32::NAN, 0.0, 0.0], mode, &mut action.clone()));
        refused(learner.act(&OBSERVATION, mode, &mut too_long));
    }
}

pub fn a_loaded_learner_continues_bit_for_bit<L: Subject>() {
    let changes = [("normalise_observations", "true")];
    let mut uninterrupted: L = learner(&changes);
    (0..4).for_each(|_| drop(act(&mut uninterrupted, ActMode::Explore)));
    train(&mut uninterrupted, 0..3);
    let mut continued: L = create(&changes, 77, 1).unwrap();
    continued.load(&saved(&uninterrupted)).unwrap();
    for learner in [&mut uninterrupted, &mut continued] {
        act(learner, ActMode::Explore);
        train(learner, 3..6);
    }
    for _ in 0..20 {
        assert_eq!(act(&mut uninterrupted, ActMode::Explore), act(&mut continued, ActMode::Explore));
    }
    assert_eq!(values(&mut uninterrupted), values(&mut continued));
    assert_eq!(saved(&uninterrupted), saved(&continued));
}

pub fn foreign_bytes_are_refused_and_change_nothing<L: Subject>() {
    let mut original: L = learner(&[]);
    let before = saved(&original);
    let mut too_long = before.clone();
    too_long.push(0);
    let mut not_a_number = before.clone();
    not_a_number[20..24].fill(0xff);
    let other_shape = saved(&learner::<L>(&[L::changes()[0]]));
    let normalised = saved(&learner::<L>(&[("normalise_observations", "true")]));
    let cut = before[..before.len() / 2].to_vec();
    for bad in [Vec::new(), b"something else".to_vec(), cut, too_long, not_a_number, other_shape, normalised]
    {
        assert!(original.load(&bad).is_err(), "{} bytes", bad.len());
        assert_eq!(before, saved(&original));
    }
}

pub fn a_greedy_action_draws_no_random_number<L: Subject>() {
    let mut learner: L = learner(&[]);
    let before = saved(&learner);
    assert_eq!(act(&mut learner, ActMode::Greedy), act(&mut learner, ActMode::Greedy));
    assert_eq!(before, saved(&learner));
    act(&mut learner, ActMode::Explore);
    assert_ne!(before, saved(&learner));
}

pub fn the_number_of_threads_changes_no_bit<L: Subject>() {
    let mut single: L = learner(&[]);
    train(&mut single, 0..4);
    for threads in [2, 8] {
        let mut several: L = create(&[], 5, threads).unwrap();
        train(&mut several, 0..4);
        assert_eq!(saved(&single), saved(&several));
        assert_eq!(values(&mut single), values(&mut several));
        assert_eq!(act(&mut single, ActMode::Greedy), act(&mut several, ActMode::Greedy));
    }
}

pub fn a_member_learns_only_what_its_mask_allows<L: Subject>() {
    let whole = Transitions::random::<L>(3, 1);
    let mut masked = Transitions::random::<L>(3, 1);
    (0..SIZE).for_each(|row| masked.masks[row * 3 + 1] = 0.0);
    let before = values(&mut learner::<L>(&[]));
    let after = |transitions: &Transitions| {
        let mut learner: L = learner(&[]);
        learner.update(&transitions.batch()).unwrap();
        values(&mut learner)
    };
    let (with_all, with_fewer) = (after(&whole), after(&masked));
    assert_eq!(before[1], with_fewer[1]);
    for member in 0..3 {
        assert_ne!(before[member], with_all[member]);
    }
    assert_eq!((with_all[0], with_all[2]), (with_fewer[0], with_fewer[2]), "members influence each other");
}

pub fn after_the_first_call_nothing_is_allocated<L: Subject>() {
    let mut learner: L = learner(&[("normalise_observations", "true")]);
    let transitions = Transitions::random::<L>(3, 1);
    let mut action = vec![1.0; L::spaces().action_len()];
    let mut gradients = vec![0.0; 3 * action.len()];
    let is_box = matches!(L::spaces().action, Space::Box { .. });
    let mut round = || {
        let mut values = [0.0; 3];
        learner.update(&transitions.batch()).unwrap();
        learner.act(&OBSERVATION, ActMode::Explore, &mut action).unwrap();
        learner.act(&OBSERVATION, ActMode::Greedy, &mut action).unwrap();
        learner.q_values(&OBSERVATION, &action, &mut values).unwrap();
        if is_box {
            learner.q_gradients(&OBSERVATION, &action, &mut values, &mut gradients).unwrap();
        }
    };
    (0..4).for_each(|_| round());
    let counted = allocation_counter::measure(|| (0..20).for_each(|_| round()));
    assert_eq!(counted.count_total, 0);
}

/// rayon's queue is a list of blocks with room for 63 jobs each.
pub fn with_two_threads_only_the_queue_of_jobs_allocates<L: Subject>() {
    let mut learner: L = create(&[], 5, 2).unwrap();
    let transitions = Transitions::random::<L>(3, 1);
    (0..4).for_each(|_| learner.update(&transitions.batch()).unwrap());
    let updates = || (0..630).for_each(|_| learner.update(&transitions.batch()).unwrap());
    let counted = allocation_counter::measure(updates);
    assert!(counted.count_total <= 11, "{counted:?}");
}

pub fn values_begin_at_the_configured_one<L: Subject>() {
    let values = values(&mut learner::<L>(&[("initial_value", "Some(20.0)")]));
    assert!(values.iter().all(|value| (value - 20.0).abs() < 0.2), "{values:?}");
}

pub fn a_loss_that_overflows_is_an_error_and_leaves_values_finite<L: Subject>() {
    let mut learner: L = learner(&[("loss", "Squared")]);
    let mut transitions = Transitions::random::<L>(3, 1);
    transitions.rewards[0] = f32::MAX;
    let before = values(&mut learner);
    assert_eq!(learner.update(&transitions.batch()).unwrap_err().kind(), ErrorKind::Failed);
    let after = values(&mut learner);
    assert!(after.iter().all(|value| value.is_finite()));
    // Transition 0 is masked for member 1 alone; the others have taken no step.
    assert_eq!((before[0], before[2]), (after[0], after[2]));
}

/// A test for each function of this file.
macro_rules! conformance_tests {
    ($learner:ty) => {
        conformance_tests! { $learner, conformance:
            every_configuration_field_changes_the_behaviour,
            the_manifest_states_the_defaults,
            impossible_settings_and_spaces_are_refused,
            a_broken_batch_is_refused_and_changes_nothing,
            wrong_arguments_are_refused,
            a_loaded_learner_continues_bit_for_bit,
            foreign_bytes_are_refused_and_change_nothing,
            a_greedy_action_draws_no_random_number,
            the_number_of_threads_changes_no_bit,
            a_member_learns_only_what_its_mask_allows,
            after_the_first_call_nothing_is_allocated,
            with_two_threads_only_the_queue_of_jobs_allocates,
            values_begin_at_the_configured_one,
            a_loss_that_overflows_is_an_error_and_leaves_values_finite,
        }
    };
    ($learner:ty, $module:ident: $($name:ident,)*) => {
        $(
            #[test]
            fn $name() {
                $module::$name::<$learner>();
            }
        )*
    };
}
