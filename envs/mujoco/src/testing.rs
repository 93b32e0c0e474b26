//! What tests of robots share: making and placing a robot, actions, and published episodes to compare with.

use shield_api::{Environment, Error, Host, Plugin, PluginConfig, Setup, StepOutcome};

use crate::simulation::Simulation;
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

/// The same with full force, forwards or backwards in each dimension.
pub fn pseudo_random_pushes(dimensions: usize, count: usize) -> Vec<Vec<f32>> {
    let actions = pseudo_random_actions(dimensions, count).into_iter();
    actions.map(|action| action.iter().map(|value| value.signum()).collect()).collect()
}

/// Places the robot at rest; `positions` are those of its first joints.
pub fn place<T: Task>(robot: &mut Robot<T>, positions: &[f64]) {
    robot.simulation_mut().reset(|all, _| all[..positions.len()].copy_from_slice(positions));
}

/// What follows from doing nothing for a control step.
pub fn idle_step<T: Task>(robot: &mut Robot<T>) -> StepOutcome {
    let spaces = robot.spec().spaces;
    robot.step(&vec![0.0; spaces.action_len()], &mut vec![0.0; spaces.observation_len()]).unwrap()
}

/// The reset value of staying for ever where the robot is, doing nothing, with γ = 0.99.
pub fn value_of_staying<T: Task>(robot: &mut Robot<T>) -> f32 {
    let mut weight = 1.0;
    (0..1_000).fold(0.0, |value, _| {
        let reward = idle_step(robot).reset_reward;
        let value = value + weight * reward;
        weight *= 0.99;
        value
    })
}

/// Whatever the robot does from a place `x`, `z` on its cliff, at any pitch.
pub fn no_pose_at_counts_as_irreversible<T: Task>([x, z]: [f64; 2], steps: usize) {
    let mut robot = make::<T>("()");
    let spaces = robot.spec().spaces;
    let mut observation = vec![0.0; spaces.observation_len()];
    for pitch in [0.0, 1.5, 3.1, -1.5] {
        place(&mut robot, &[x, z, pitch]);
        for action in pseudo_random_actions(spaces.action_len(), steps) {
            let outcome = robot.step(&action, &mut observation).unwrap();
            assert!(!outcome.irreversible, "{pitch}: {observation:?}");
        }
    }
}

/// A robot that does nothing from a place `x`, `z` on: on the cliff of usual length it stays up, on one of `shorter` it falls.
pub fn a_shorter_cliff_ends_before<T: Task>([x, z]: [f64; 2], shorter: f64, steps: usize) {
    for (config, falls) in [("()", false), (&*format!("(cliff_length: {shorter:?})"), true)] {
        let mut robot = make::<T>(config);
        place(&mut robot, &[x, z, 0.0]);
        let outcome = (0..steps).map(|_| idle_step(&mut robot)).last().unwrap();
        assert_eq!(outcome.irreversible, falls, "{config}");
    }
    for length in ["0.4", "NaN", "inf"] {
        assert!(try_make::<T>(&format!("(cliff_length: {length})")).is_err(), "{length}");
    }
}

/// The action of step k in published episodes, where `phase` is 7k: it differs in every dimension.
pub fn wave(phase: usize, dimension: usize) -> f32 {
    ((phase + 3 * dimension) % 16) as f32 / 8.0 - 1.0
}

/// Holds positions and velocities against those that another model had.
pub fn assert_state(simulation: &Simulation, published: &[f64]) {
    let state = simulation.positions().iter().chain(simulation.velocities());
    for (index, (ours, theirs)) in state.zip(published).enumerate() {
        assert!((ours - theirs).abs() < 1e-6, "{index}: {ours} {theirs}");
    }
}

/// Holds the bodies' masses against those of another model.
pub fn assert_masses(simulation: &Simulation, published: &[f64]) {
    for (mass, published) in simulation.model().body_mass()[1..].iter().zip(published) {
        assert!((mass - published).abs() < 1e-8, "{mass} {published}");
    }
}

/// What Gymnasium's environment of the same kind did (Gymnasium 1.4.0, MuJoCo 3.17.0): from its default pose at rest, action i of
/// step k being `scale` · ((7k + 3i) mod 16 / 8 − 1), until it ended or for so many steps.
pub struct GymnasiumEpisode<const N: usize> {
    pub scale: f32,
    pub steps: usize,
    pub terminated: bool,
    pub total_reward: f64,
    pub last_observation: [f64; N],
}

impl<const N: usize> GymnasiumEpisode<N> {
    pub fn agrees_with<T: Task>(&self) {
        let mut robot = make::<T>("(start_noise: 0.0)");
        let mut observation = [0.0; N];
        robot.reset(0, &mut observation).unwrap();
        let dimensions = robot.spec().spaces.action_len();
        let mut total_reward = 0.0;
        for step in 0..self.steps {
            let action: Vec<f32> = (0..dimensions).map(|index| self.scale * wave(7 * step, index)).collect();
            let outcome = robot.step(&action, &mut observation).unwrap();
            total_reward += f64::from(outcome.forward_reward);
            assert_eq!(outcome.terminated, self.terminated && step + 1 == self.steps, "step {step}");
        }
        assert!((total_reward - self.total_reward).abs() < 1e-5, "{total_reward} {}", self.total_reward);
        for (index, (ours, theirs)) in observation.iter().zip(self.last_observation).enumerate() {
            assert!(
                (f64::from(*ours) - theirs).abs() < 2e-6 * theirs.abs().max(1.0),
                "{index}: {ours} {theirs}"
            );
        }
    }
}
