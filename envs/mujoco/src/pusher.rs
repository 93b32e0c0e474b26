//! `mujoco/pusher`: an arm that must push a puck to a goal without losing it (paper, section 6).

use shield_api::{Error, Result, StepOutcome};

use crate::noise::Noise;
use crate::picture::View;
use crate::reward::huber_closeness;
use crate::simulation::Simulation;
use crate::task::{Task, robot_config};

robot_config! {
    /// Settings of the pusher.
    pub struct PusherConfig {
        /// Steps of an episode.
        horizon: usize = 100,
        /// A hard reset draws the puck's place uniformly from its start ± this (m), and the arm's speeds from ± a tenth of it (rad/s).
        start_noise: f64 = 0.05,
        /// Time steps of the model (0.01 s) that an action is held.
        control_step: usize = 5,
        /// How far from its start (m) the puck may be in the reset set, beside a reset reward above 0.7. That alone, the paper's
        /// condition, is met up to 0.4 m away if the hand is near.
        reset_distance: f64 = f64::INFINITY => "inf",
        /// The reset reward as published: a lost puck beside the hand can be worth 70, so no Q_min tells it from safety. Otherwise it
        /// is 0 once the puck is lost.
        published_reward: bool = false,
    }
}

/// Where the puck starts, in the frame of the world.
const START: [f64; 3] = [0.35, -0.35, -0.275];
/// Where it shall be.
const GOAL: [f64; 3] = [-0.35, -0.35, -0.323];
/// The arm's shoulder.
const SHOULDER: [f64; 2] = [0.0, -0.6];
/// How far from the shoulder the middle of a finger can be: two links and, with the hand turned sideways, half its width.
const REACH: f64 = 0.4 + 0.321 + 0.03;
/// The puck's middle is level with the table's top.
const FALLEN: f64 = -0.05;

/// The model's only site.
const FINGERTIP: usize = 0;
/// Distances count up to that from start to goal.
const FARTHEST: f64 = 0.7;
/// The largest norm of an action: 2 for each of three joints.
const STRONGEST: f64 = 3.464;

/// The quantities of arm and puck that the task speaks of.
struct Scene<'a>(&'a Simulation);

impl Scene<'_> {
    fn puck(&self) -> [f64; 3] {
        let positions = self.0.positions();
        std::array::from_fn(|axis| START[axis] + positions[3 + axis])
    }

    fn fingertip(&self) -> [f64; 3] {
        self.0.site(FINGERTIP)
    }

    /// Fingers touch the puck without friction, so those that are nearer to the shoulder than the puck's middle can only push
    /// it further away. From the floor below the table nothing lifts it.
    fn is_puck_lost(&self) -> bool {
        let [x, y, _] = self.puck();
        (x - SHOULDER[0]).hypot(y - SHOULDER[1]) > REACH || self.0.positions()[5] < FALLEN
    }

    /// Half for the puck's nearness to `place`, 0.375 for its nearness to the hand, 0.125 for small actions. In [0, 1].
    fn reward(&self, place: [f64; 3]) -> f64 {
        let puck = self.puck();
        let control = self.0.squared_control().sqrt();
        0.5 * huber_closeness(distance(puck, place), FARTHEST)
            + 0.375 * huber_closeness(distance(puck, self.fingertip()), FARTHEST)
            + 0.125 * huber_closeness(control, STRONGEST)
    }
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

/// The task on the pusher's model.
pub struct Pusher;

impl Task for Pusher {
    type Config = PusherConfig;

    fn check(config: &PusherConfig) -> Result<()> {
        if config.reset_distance.is_nan() || config.reset_distance <= 0.0 {
            let value = config.reset_distance;
            let message = format!("reset_distance is {value}; it must be positive");
            return Err(Error::invalid_config(message).in_field("reset_distance"));
        }
        Ok(())
    }

    fn model(_config: &PusherConfig) -> String {
        include_str!("pusher.xml").to_owned()
    }

    fn place(_start: Option<&str>, noise: &mut Noise<'_>, positions: &mut [f64], velocities: &mut [f64]) {
        for position in &mut positions[3..5] {
            *position = noise.uniform();
        }
        for velocity in &mut velocities[..3] {
            *velocity = 0.1 * noise.uniform();
        }
    }

    /// Angles, the puck's displacement from its start, the arm's speeds, and where the fingertips are.
    fn observe(simulation: &Simulation) -> impl Iterator<Item = f64> {
        let fingertip = Scene(simulation).fingertip();
        let (positions, velocities) = (&simulation.positions()[..5], &simulation.velocities()[..3]);
        positions.iter().chain(velocities).copied().chain([fingertip[0], fingertip[1]])
    }

    fn outcome(config: &PusherConfig, simulation: &Simulation) -> StepOutcome {
        let scene = Scene(simulation);
        let irreversible = scene.is_puck_lost();
        let is_worthless = irreversible && !config.published_reward;
        let reset_reward = if is_worthless { 0.0 } else { scene.reward(START) };
        let [puck_x, puck_y, _] = scene.puck();
        StepOutcome {
            forward_reward: scene.reward(GOAL) as f32,
            reset_reward: reset_reward as f32,
            in_reset_set: reset_reward > 0.7
                && !irreversible
                && distance(scene.puck(), START) <= config.reset_distance,
            terminated: false,
            success: !irreversible && (puck_x - GOAL[0]).hypot(puck_y - GOAL[1]) < 0.08,
            irreversible,
        }
    }

    fn view(_simulation: &Simulation) -> View {
        // From beyond the table, so that the arm hides neither puck nor goal.
        View { target: [0.0, -0.3, -0.3], distance: 1.7, azimuth: 270.0, elevation: -50.0 }
    }
}

#[cfg(test)]
mod tests {
    use shield_api::Environment;

    use super::*;
    use crate::task::Robot;
    use crate::testing::{idle_step, make, pseudo_random_pushes, try_make, value_of_staying};

    type PusherRobot = Robot<Pusher>;

    const EAST: [f64; 3] = [0.0, 0.0, 0.0];
    /// The arm stretched from the shoulder over the puck's start.
    const OVER_START: [f64; 3] = [0.62, 0.0, 0.0];

    fn place(pusher: &mut PusherRobot, arm: [f64; 3], puck: [f64; 2]) {
        pusher.simulation_mut().reset(|positions, _| {
            positions[..3].copy_from_slice(&arm);
            positions[3] = puck[0] - START[0];
            positions[4] = puck[1] - START[1];
        });
    }

    #[test]
    fn the_start_is_in_the_reset_set_with_the_published_reward() {
        for config in ["(start_noise: 0.0)", "(start_noise: 0.0, published_reward: true)"] {
            let mut pusher: PusherRobot = make(config);
            pusher.reset(0, &mut [0.0; 10]).unwrap();
            let outcome = idle_step(&mut pusher);
            assert!(outcome.in_reset_set && (outcome.reset_reward - 0.782).abs() < 1e-3, "{outcome:?}");
        }
    }

    #[test]
    fn a_puck_at_rest_stays_at_rest() {
        let mut pusher: PusherRobot = make("(start_noise: 0.0)");
        pusher.reset(0, &mut [0.0; 10]).unwrap();
        let puck = |pusher: &mut PusherRobot| pusher.simulation_mut().positions()[3..].to_vec();
        for _ in 0..100 {
            idle_step(&mut pusher);
        }
        assert!(puck(&mut pusher).iter().all(|position| position.abs() < 1e-3), "{:?}", puck(&mut pusher));
    }

    #[test]
    fn the_observation_holds_the_places_of_puck_and_fingertips() {
        let mut pusher: PusherRobot = make("()");
        let mut observation = [0.0; 10];
        place(&mut pusher, [std::f64::consts::FRAC_PI_2, 0.0, 0.0], [-0.5, -0.1]);
        pusher.step(&[0.0; 3], &mut observation).unwrap();
        let expected = [std::f32::consts::FRAC_PI_2, 0.0, 0.0, -0.85, 0.25, 0.0, 0.0, 0.0, 0.0, 0.121];
        for (index, (seen, expected)) in observation.iter().zip(expected).enumerate() {
            assert!((seen - expected).abs() < 1e-3, "{index}: {observation:?}");
        }
    }

    /// How often the puck was lost in 60 episodes of 300 steps, full torques being held for 10 steps each.
    fn lost_pucks(each_step_after: impl Fn(StepOutcome)) -> usize {
        let mut pusher: PusherRobot = make("()");
        let mut lost = 0;
        for seed in 0..60 {
            pusher.reset(seed, &mut [0.0; 10]).unwrap();
            let mut is_lost = false;
            for push in pseudo_random_pushes(3, 30 * (seed as usize + 1)).split_off(30 * seed as usize) {
                let action: Vec<f32> = push.iter().map(|value| 2.0 * value).collect();
                for _ in 0..10 {
                    let outcome = pusher.step(&action, &mut [0.0; 10]).unwrap();
                    is_lost |= outcome.irreversible;
                    if is_lost {
                        each_step_after(outcome);
                    }
                }
            }
            lost += usize::from(is_lost);
        }
        lost
    }

    #[test]
    fn a_lost_puck_stays_lost_and_has_no_reset_reward() {
        let lost = lost_pucks(|outcome| {
            assert!(outcome.irreversible && !outcome.in_reset_set && !outcome.success, "{outcome:?}");
            assert_eq!(outcome.reset_reward, 0.0);
        });
        // It does happen: 11 times when this was written.
        assert!((3..60).contains(&lost), "{lost}");
    }

    #[test]
    fn a_puck_over_the_edge_falls() {
        let mut pusher: PusherRobot = make("()");
        place(&mut pusher, EAST, [0.0, -0.82]);
        assert!(!idle_step(&mut pusher).irreversible, "half of it is on the table");
        place(&mut pusher, EAST, [0.0, -0.86]);
        let outcome = (0..10).map(|_| idle_step(&mut pusher)).last().unwrap();
        assert!(outcome.irreversible);
        for _ in 0..1_000 {
            idle_step(&mut pusher);
        }
        assert!(pusher.simulation_mut().positions()[5] > -0.6);
    }

    #[test]
    fn the_reset_value_separates_the_reset_set_from_lost_pucks() {
        let mut pusher: PusherRobot = make("(start_noise: 0.0)");
        pusher.reset(0, &mut [0.0; 10]).unwrap();
        let safe = value_of_staying(&mut pusher);
        place(&mut pusher, EAST, [0.95, 0.15]);
        let out_of_reach = value_of_staying(&mut pusher);
        place(&mut pusher, OVER_START, [0.64, -0.15]);
        let beside_the_hand = value_of_staying(&mut pusher);
        assert!(
            safe > 78.0 && out_of_reach == 0.0 && beside_the_hand == 0.0,
            "{safe} {out_of_reach} {beside_the_hand}"
        );
    }

    #[test]
    fn the_published_reward_values_some_lost_pucks_as_highly_as_safe_ones() {
        let mut pusher: PusherRobot = make("(published_reward: true)");
        place(&mut pusher, EAST, [-0.95, 0.15]);
        let out_of_reach = value_of_staying(&mut pusher);
        place(&mut pusher, OVER_START, [0.64, -0.15]);
        assert!(idle_step(&mut pusher).irreversible);
        let beside_the_hand = value_of_staying(&mut pusher);
        assert!(
            (12.4..12.6).contains(&out_of_reach) && beside_the_hand > 60.0,
            "{out_of_reach} {beside_the_hand}"
        );
    }

    #[test]
    fn the_goal_is_a_success_and_rewards_a_hand_beside_it() {
        let mut pusher: PusherRobot = make("()");
        place(&mut pusher, [2.5, 0.0, 0.0], [GOAL[0], GOAL[1]]);
        let beside = idle_step(&mut pusher);
        place(&mut pusher, EAST, [GOAL[0], GOAL[1]]);
        let far = idle_step(&mut pusher);
        assert!(beside.success && far.success && beside.forward_reward > far.forward_reward);
        // 0.5 for the puck, whose middle is 0.048 above the goal's, and 0.125 for no action.
        assert!((far.forward_reward - 0.62).abs() < 0.01, "{far:?}");
    }

    #[test]
    fn a_sweep_of_the_bent_arm_brings_the_puck_to_the_goal() {
        let mut pusher: PusherRobot = make("(start_noise: 0.0)");
        let mut observation = [0.0; 10];
        pusher.reset(0, &mut observation).unwrap();
        let mut outcome = StepOutcome::default();
        for step in 0..100 {
            // Bent, the hand is as far from the shoulder as the puck, one finger nearer and one further than its middle.
            let shoulder = if step < 20 { -0.7 } else { (-0.7 + 0.05 * (step - 20) as f32).min(1.63) };
            let wanted = [shoulder, 1.88, 0.47];
            let torque: [f32; 3] = std::array::from_fn(|joint| {
                let (stiffness, damping) = ([20.0, 8.0, 3.0][joint], [4.0, 1.5, 0.4][joint]);
                stiffness * (wanted[joint] - observation[joint]) - damping * observation[5 + joint]
            });
            outcome = pusher.step(&torque, &mut observation).unwrap();
            if outcome.success {
                break;
            }
        }
        assert!(outcome.success, "{observation:?}");
    }

    #[test]
    fn the_reset_set_can_be_narrowed_to_pucks_near_the_start() {
        for (config, expected) in
            [("()", true), ("(reset_distance: 0.1)", false), ("(reset_distance: 0.3)", true)]
        {
            let mut pusher: PusherRobot = make(config);
            // 0.2 m from the start, the hand near.
            place(&mut pusher, OVER_START, [0.5, -0.48]);
            assert_eq!(idle_step(&mut pusher).in_reset_set, expected, "{config}");
        }
        for config in ["(reset_distance: 0.0)", "(reset_distance: NaN)"] {
            assert!(try_make::<Pusher>(config).is_err(), "{config}");
        }
    }
}
