//! What must hold of every robot. A new robot is added to the list at the end.

use shield_api::{
    Checkpoint, Environment, Error, ErrorKind, Host, Plugin, PluginConfig, Setup, Space, StepOutcome,
};

use crate::task::{Robot, Task};

pub fn try_make<T: Task>(config: &str) -> Result<Robot<T>, Error> {
    Robot::create(T::Config::parse(config)?, &Setup::new(0, 1, Host::silent()))
}

pub fn make<T: Task>(config: &str) -> Robot<T> {
    try_make(config).unwrap()
}

/// Actions in [−1, 1], the same on every run.
pub fn pseudo_random_actions(dimensions: usize, count: usize) -> Vec<Vec<f32>> {
    let mut state = 1u64;
    let mut next = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f32 / (1u64 << 23) as f32 - 1.0
    };
    (0..count).map(|_| (0..dimensions).map(|_| next()).collect()).collect()
}

/// The reset value of staying for ever where the robot is, doing nothing, with γ = 0.99.
pub fn value_of_staying<T: Task>(robot: &mut Robot<T>) -> f32 {
    let spaces = robot.spec().spaces;
    let mut observation = vec![0.0; spaces.observation_len()];
    let idle = vec![0.0; spaces.action_len()];
    let mut weight = 1.0;
    (0..1_000).fold(0.0, |value, _| {
        let reward = robot.step(&idle, &mut observation).unwrap().reset_reward;
        let value = value + weight * reward;
        weight *= 0.99;
        value
    })
}

/// A robot with what surrounds a test of it.
struct Bench<T> {
    robot: Robot<T>,
    observation: Vec<f32>,
    actions: Vec<Vec<f32>>,
}

impl<T: Task> Bench<T> {
    fn new() -> Self {
        let robot: Robot<T> = make("()");
        let spaces = robot.spec().spaces;
        let observation = vec![f32::NAN; spaces.observation_len()];
        let mut bench = Self { robot, observation, actions: pseudo_random_actions(spaces.action_len(), 200) };
        bench.robot.reset(7, &mut bench.observation).unwrap();
        bench
    }

    fn step(&mut self, action: &[f32]) -> Result<StepOutcome, Error> {
        self.robot.step(action, &mut self.observation)
    }

    /// Everything seen while the actions in `range` are executed.
    fn run(&mut self, range: std::ops::Range<usize>) -> Vec<(Vec<u32>, StepOutcome)> {
        let actions = self.actions[range].to_vec();
        actions
            .iter()
            .map(|action| {
                let outcome = self.step(action).unwrap();
                (self.observation.iter().map(|value| value.to_bits()).collect(), outcome)
            })
            .collect()
    }

    fn saved(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        self.robot.save(&mut bytes).unwrap();
        bytes
    }
}

fn spaces_agree_with<T: Task>(observation: usize, action: usize, horizon: usize) {
    let spec = Bench::<T>::new().robot.spec();
    assert_eq!(spec.spaces.observation, Space::unbounded(observation));
    assert_eq!(spec.spaces.action, Space::uniform(action, -1.0, 1.0));
    assert_eq!(spec.episode_length, horizon);
    assert!(spec.brings_reset_reward);
}

fn the_seed_decides_everything<T: Task>() {
    let (mut one, mut same, mut other) = (Bench::<T>::new(), Bench::<T>::new(), Bench::<T>::new());
    other.robot.reset(8, &mut other.observation).unwrap();
    assert_ne!(one.observation, other.observation);
    let first = one.run(0..100);
    assert_eq!(first, same.run(0..100));
    // A used instance starts like a new one.
    one.robot.reset(7, &mut one.observation).unwrap();
    assert_eq!(first, one.run(0..100));
}

fn a_saved_state_continues_bit_for_bit<T: Task>() {
    let mut bench = Bench::<T>::new();
    bench.run(0..50);
    let bytes = bench.saved();
    let continued = bench.run(50..200);
    let mut fresh = Bench::<T>::new();
    fresh.robot.load(&bytes).unwrap();
    assert_eq!(fresh.saved(), bytes);
    assert_eq!(fresh.run(50..200), continued);
}

fn foreign_bytes_are_refused_and_nothing_changes<T: Task>() {
    let mut bench = Bench::<T>::new();
    bench.run(0..10);
    let bytes = bench.saved();
    let (mut longer, mut not_finite, mut of_another_model) = (bytes.clone(), bytes.clone(), bytes.clone());
    longer.push(0);
    let end = not_finite.len() - 8;
    not_finite[end..].copy_from_slice(&f64::NAN.to_le_bytes());
    of_another_model[9] ^= 1;
    for bad in [&b""[..], b"foreign", &bytes[..end], &bytes[1..], &longer, &not_finite, &of_another_model] {
        assert!(bench.robot.load(bad).is_err());
        assert_eq!(bench.saved(), bytes);
    }
}

fn a_bad_action_is_refused_and_nothing_changes<T: Task>() {
    let mut bench = Bench::<T>::new();
    bench.run(0..10);
    let (before, good) = (bench.saved(), bench.actions[0].clone());
    let with_last = |value: f32| {
        let mut action = good.clone();
        *action.last_mut().unwrap() = value;
        action
    };
    let longer = [good.as_slice(), &[0.0]].concat();
    let bad = [vec![], longer, with_last(f32::NAN), with_last(f32::INFINITY), with_last(f32::NEG_INFINITY)];
    for action in bad {
        assert_eq!(bench.step(&action).unwrap_err().kind(), ErrorKind::InvalidArgument, "{action:?}");
        assert_eq!(bench.saved(), before);
    }
    assert!(bench.robot.step(&good, &mut [0.0]).is_err());
    assert_eq!(bench.saved(), before);
}

fn an_action_out_of_range_acts_like_the_bound<T: Task>() {
    let (mut far, mut at_bound) = (Bench::<T>::new(), Bench::<T>::new());
    let dimensions = far.actions[0].len();
    for _ in 0..20 {
        far.step(&vec![f32::MAX; dimensions]).unwrap();
        at_bound.step(&vec![1.0; dimensions]).unwrap();
    }
    assert_eq!(far.saved(), at_bound.saved());
}

fn rewards_stay_in_the_unit_interval<T: Task>() {
    let mut bench = Bench::<T>::new();
    for seed in 0..20 {
        bench.robot.reset(seed, &mut bench.observation).unwrap();
        for (_, outcome) in bench.run(0..200) {
            assert!((0.0..=1.0).contains(&outcome.forward_reward), "{outcome:?}");
            assert!((0.0..=1.0).contains(&outcome.reset_reward), "{outcome:?}");
            assert!(!outcome.terminated);
            assert!(!(outcome.irreversible && outcome.in_reset_set), "{outcome:?}");
        }
    }
}

/// A step of no action stands for the reset itself, which has no outcome.
fn a_hard_reset_lies_in_the_reset_set<T: Task>() {
    let mut bench = Bench::<T>::new();
    let idle = vec![0.0; bench.actions[0].len()];
    for seed in 0..200 {
        bench.robot.reset(seed, &mut bench.observation).unwrap();
        let outcome = bench.step(&idle).unwrap();
        assert!(outcome.in_reset_set && outcome.reset_reward > 0.7, "seed {seed}: {outcome:?}");
    }
}

fn a_diverged_simulation_is_an_error_until_the_next_reset<T: Task>() {
    let mut bench = Bench::<T>::new();
    let first = bench.run(0..10);
    bench.robot.simulation_mut().reset(|_, velocities| velocities.fill(1e200));
    let action = bench.actions[0].clone();
    for _ in 0..3 {
        assert_eq!(bench.step(&action).unwrap_err().kind(), ErrorKind::Failed);
    }
    bench.robot.reset(7, &mut bench.observation).unwrap();
    assert_eq!(bench.run(0..10), first);
    // MuJoCo reports it in the working folder as well; another robot's test may have removed that already.
    std::fs::remove_file("MUJOCO_LOG.TXT").ok();
}

fn named_starts_exist_and_others_do_not<T: Task>() {
    let mut bench = Bench::<T>::new();
    for start in bench.robot.starts() {
        bench.robot.reset_to(&start, 0, &mut bench.observation).unwrap();
    }
    let before = bench.saved();
    assert!(bench.robot.reset_to("nowhere", 0, &mut bench.observation).is_err());
    assert_eq!(bench.saved(), before);
}

fn impossible_configurations_are_refused<T: Task>() {
    for config in
        ["(horizon: 0)", "(start_noise: -0.1)", "(start_noise: inf)", "(start_noise: NaN)", "(nose: 1)"]
    {
        let error = try_make::<T>(config).err().unwrap();
        assert_eq!(error.kind(), ErrorKind::InvalidConfig, "{config}");
    }
}

/// Not a pass or fail of speed: prints what the README quotes.
/// `cargo test --release -p mujoco-robots -- --ignored --nocapture --test-threads 1`
fn steps_per_second<T: Task>() {
    let mut bench = Bench::<T>::new();
    let horizon = bench.robot.spec().episode_length;
    let actions = bench.actions.clone();
    let (count, begun) = (40_000, std::time::Instant::now());
    for step in 0..count {
        if step % horizon == 0 {
            bench.robot.reset(step as u64, &mut bench.observation).unwrap();
        }
        bench.step(&actions[step % actions.len()]).unwrap();
    }
    let rate = count as f64 / begun.elapsed().as_secs_f64();
    println!("{}: {rate:.0} steps/s", std::any::type_name::<T>());
}

macro_rules! suite {
    ($($robot:ident: $task:ty, observation $observation:literal, action $action:literal, horizon $horizon:literal;)+) => {$(
        mod $robot {
            #[test]
            fn spaces_agree() {
                super::spaces_agree_with::<$task>($observation, $action, $horizon);
            }

            #[test]
            #[ignore = "measures the speed, for the README"]
            fn steps_per_second() {
                super::steps_per_second::<$task>();
            }

            suite!(@tests $task;
                the_seed_decides_everything,
                a_saved_state_continues_bit_for_bit,
                foreign_bytes_are_refused_and_nothing_changes,
                a_bad_action_is_refused_and_nothing_changes,
                an_action_out_of_range_acts_like_the_bound,
                rewards_stay_in_the_unit_interval,
                a_diverged_simulation_is_an_error_until_the_next_reset,
                a_hard_reset_lies_in_the_reset_set,
                named_starts_exist_and_others_do_not,
                impossible_configurations_are_refused);
        }
    )+};
    (@tests $task:ty; $($name:ident),+) => {$(
        #[test]
        fn $name() {
            super::$name::<$task>();
        }
    )+};
}

suite! {
    cliff_cart: crate::cliff_cart::CliffCart, observation 6, action 1, horizon 100;
    cliff_cheetah: crate::cliff_cheetah::CliffCheetah, observation 18, action 6, horizon 500;
}
