//! What must hold of every robot. A new robot is added to the list at the end.

use shield_api::{Checkpoint, Environment, Error, ErrorKind, Space, StepOutcome};

use crate::task::{Robot, Task};
use crate::testing::{make, pseudo_random_actions, try_make};

/// A robot with what surrounds a test of it.
struct Bench<T: Task> {
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

fn spaces_and_horizon_are<T: Task>(observation: usize, action: usize, bound: f32, horizon: usize) {
    let spec = Bench::<T>::new().robot.spec();
    assert_eq!(spec.spaces.observation, Space::unbounded(observation));
    assert_eq!(spec.spaces.action, Space::uniform(action, -bound, bound));
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

fn foreign_bytes_are_refused_and_change_nothing<T: Task>() {
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

fn an_invalid_action_is_refused_and_changes_nothing<T: Task>() {
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
    let Space::Box { high, .. } = far.robot.spec().spaces.action else {
        panic!("a motor's control is continuous")
    };
    for _ in 0..20 {
        far.step(&vec![f32::MAX; dimensions]).unwrap();
        at_bound.step(&high).unwrap();
    }
    assert_eq!(far.saved(), at_bound.saved());
}

/// Outcomes of 20 episodes of 200 random actions.
fn outcomes<T: Task>() -> impl Iterator<Item = StepOutcome> {
    let mut bench = Bench::<T>::new();
    (0..20).flat_map(move |seed| {
        bench.robot.reset(seed, &mut bench.observation).unwrap();
        bench.run(0..200).into_iter().map(|(_, outcome)| outcome)
    })
}

fn reset_rewards_stay_in_the_unit_interval<T: Task>() {
    for outcome in outcomes::<T>() {
        assert!((0.0..=1.0).contains(&outcome.reset_reward), "{outcome:?}");
        assert!(!(outcome.irreversible && outcome.in_reset_set), "{outcome:?}");
        assert!(!(outcome.terminated && outcome.in_reset_set), "{outcome:?}");
    }
}

/// Of the paper's robots only; those to judge learners by have Gymnasium's rewards and endings.
fn forward_rewards_stay_in_the_unit_interval_and_nothing_ends_an_episode<T: Task>() {
    for outcome in outcomes::<T>() {
        assert!((0.0..=1.0).contains(&outcome.forward_reward), "{outcome:?}");
        assert!(!outcome.terminated, "{outcome:?}");
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

fn named_starts_exist_and_unknown_ones_are_refused<T: Task>() {
    let mut bench = Bench::<T>::new();
    for start in bench.robot.starts() {
        bench.robot.reset_to(&start, 0, &mut bench.observation).unwrap();
    }
    let before = bench.saved();
    assert!(bench.robot.reset_to("nowhere", 0, &mut bench.observation).is_err());
    assert_eq!(bench.saved(), before);
}

fn each_common_field_of_the_configuration_takes_effect<T: Task>() {
    assert_eq!(make::<T>("(horizon: 7)").spec().episode_length, 7);
    let mut bench = Bench::<T>::new();
    let idle = vec![0.0; bench.actions[0].len()];
    let mut duration = |config| {
        let mut robot = make::<T>(config);
        robot.reset(0, &mut bench.observation).unwrap();
        robot.step(&idle, &mut bench.observation).unwrap();
        robot.simulation_mut().time()
    };
    let (one, three) = (duration("(control_step: 1)"), duration("(control_step: 3)"));
    assert!((three / one - 3.0).abs() < 1e-9, "{one} {three}");

    // Without noise all seeds start alike; a larger one starts further off.
    let starts = |config| {
        let mut robot = make::<T>(config);
        [1, 2].map(|seed| {
            let mut observation = vec![0.0; robot.spec().spaces.observation_len()];
            robot.reset(seed, &mut observation).unwrap();
            observation
        })
    };
    let ([still, same], [small, _], [large, _]) =
        (starts("(start_noise: 0.0)"), starts("(start_noise: 0.001)"), starts("(start_noise: 0.002)"));
    assert_eq!(still, same);
    let distance = |from: &[f32]| from.iter().zip(&still).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
    assert!(distance(&small) > 0.0 && distance(&large) > 1.5 * distance(&small));
}

fn impossible_configurations_are_refused<T: Task>() {
    for config in [
        "(horizon: 0)",
        "(control_step: 0)",
        "(start_noise: -0.1)",
        "(start_noise: inf)",
        "(start_noise: NaN)",
        "(start_noise: 101.0)",
        "(start_noise: 1e308)",
        "(nose: 1)",
    ] {
        let error = try_make::<T>(config).err().unwrap();
        assert_eq!(error.kind(), ErrorKind::InvalidConfig, "{config}");
    }
}

fn the_largest_start_noise_gives_finite_observations<T: Task>() {
    let mut robot = make::<T>("(start_noise: 100.0)");
    let mut observation = vec![f32::NAN; robot.spec().spaces.observation_len()];
    for seed in 0..20 {
        robot.reset(seed, &mut observation).unwrap();
        assert!(observation.iter().all(|value| value.is_finite()), "{observation:?}");
    }
}

macro_rules! suite {
    ($($robot:ident: $task:ty, observation $observation:literal, action $action:literal in $bound:literal, horizon $horizon:literal
        $(, $paper:ident)?;)+) => {$(
        mod $robot {
            #[test]
            fn spaces_and_horizon_are_the_declared_ones() {
                super::spaces_and_horizon_are::<$task>($observation, $action, $bound, $horizon);
            }

            suite!(@tests $task;
                the_seed_decides_everything,
                a_saved_state_continues_bit_for_bit,
                foreign_bytes_are_refused_and_change_nothing,
                an_invalid_action_is_refused_and_changes_nothing,
                an_action_out_of_range_acts_like_the_bound,
                reset_rewards_stay_in_the_unit_interval,
                a_diverged_simulation_is_an_error_until_the_next_reset,
                a_hard_reset_lies_in_the_reset_set,
                named_starts_exist_and_unknown_ones_are_refused,
                each_common_field_of_the_configuration_takes_effect,
                impossible_configurations_are_refused,
                the_largest_start_noise_gives_finite_observations);
            $(suite!(@$paper $task);)?
        }
    )+};
    (@continuing $task:ty) => {
        suite!(@tests $task; forward_rewards_stay_in_the_unit_interval_and_nothing_ends_an_episode);
    };
    (@tests $task:ty; $($name:ident),+) => {$(
        #[test]
        fn $name() {
            super::$name::<$task>();
        }
    )+};
}

suite! {
    ball_in_cup: crate::ball_in_cup::BallInCup, observation 8, action 2 in 1.0, horizon 50, continuing;
    cliff_cart: crate::cliff_cart::CliffCart, observation 6, action 1 in 1.0, horizon 100, continuing;
    cliff_cheetah: crate::cliff_cheetah::CliffCheetah, observation 18, action 6 in 1.0, horizon 500, continuing;
    cliff_walker: crate::cliff_walker::CliffWalker, observation 18, action 6 in 1.0, horizon 500, continuing;
    half_cheetah: crate::half_cheetah::HalfCheetah, observation 17, action 6 in 1.0, horizon 1000;
    inverted_pendulum: crate::inverted_pendulum::InvertedPendulum, observation 4, action 1 in 3.0, horizon 1000;
    peg_insertion: crate::peg_insertion::PegInsertion, observation 14, action 7 in 2.0, horizon 50, continuing;
    pusher: crate::pusher::Pusher, observation 10, action 3 in 2.0, horizon 100, continuing;
    walker: crate::walker::Walker, observation 17, action 6 in 1.0, horizon 1000;
}
