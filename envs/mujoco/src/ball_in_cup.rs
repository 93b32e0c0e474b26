//! `mujoco/ball-in-cup`: a ball on a string that must be swung into its cup (paper, section 6.1).

use shield_api::StepOutcome;

use crate::noise::Noise;
use crate::picture::View;
use crate::simulation::Simulation;
use crate::task::{Task, robot_config};

robot_config! {
    /// Settings of the ball in the cup.
    pub struct BallInCupConfig {
        /// Steps of an episode.
        horizon: usize = 50,
        /// A hard reset draws all speeds (m/s) uniformly from ± this.
        start_noise: f64 = 0.01,
        /// Time steps of the model (0.002 s) that an action is held.
        control_step: usize = 10,
    }
}

/// The model at rest, measured: how far its weight lowers the cup, and how far the ball on the taut string hangs below its place
/// in the model. Cup x and z, then ball x and z.
const RESTING: [f64; 4] = [0.0, -0.064_060_654, 0.0, -0.072_625_322];

/// Places of cup and ball in the model.
const CUP: [f64; 2] = [0.0, 0.6];
const BALL: [f64; 2] = [0.0, 0.2];
/// The middle of the cup's inside, from the cup, and its half-width and half-height less the ball's radius.
const INSIDE: [f64; 2] = [0.0, -0.05];
const ROOM: f64 = 0.05 - 0.025;

/// The quantities of cup and ball that the task speaks of.
struct Toy<'a>(&'a Simulation);

impl Toy<'_> {
    /// The whole ball is within the cup.
    fn is_ball_in_cup(&self) -> bool {
        let positions = self.0.positions();
        (0..2).all(|axis| {
            let cup = CUP[axis] + positions[axis] + INSIDE[axis];
            let ball = BALL[axis] + positions[2 + axis];
            (cup - ball).abs() < ROOM
        })
    }

    /// Euclidean, of positions (m) and velocities (m/s).
    fn distance_from_rest(&self) -> f64 {
        let positions = self.0.positions().iter().zip(RESTING).map(|(position, rest)| position - rest);
        let differences = positions.chain(self.0.velocities().iter().copied());
        differences.map(|difference| difference * difference).sum::<f64>().sqrt()
    }
}

/// The task on the model of cup and ball.
pub struct BallInCup;

impl Task for BallInCup {
    type Config = BallInCupConfig;

    fn model(_config: &BallInCupConfig) -> String {
        include_str!("ball_in_cup.xml").to_owned()
    }

    fn place(_start: Option<&str>, noise: &mut Noise<'_>, positions: &mut [f64], velocities: &mut [f64]) {
        positions.copy_from_slice(&RESTING);
        velocities.fill_with(|| noise.uniform());
    }

    fn outcome(_config: &BallInCupConfig, simulation: &Simulation) -> StepOutcome {
        let toy = Toy(simulation);
        let is_caught = toy.is_ball_in_cup();
        let reset_reward = (1.0 - 0.5 * toy.distance_from_rest()).clamp(0.0, 1.0);
        StepOutcome {
            forward_reward: if is_caught { 1.0 } else { 0.0 },
            reset_reward: reset_reward as f32,
            in_reset_set: reset_reward > 0.7,
            terminated: false,
            success: is_caught,
            // The ball never leaves its string.
            irreversible: false,
        }
    }

    fn view(_simulation: &Simulation) -> View {
        View::from_the_side([0.0, 0.0, 0.45], 1.4)
    }
}

#[cfg(test)]
mod tests {
    use shield_api::Environment;

    use super::*;
    use crate::task::Robot;
    use crate::testing::{
        assert_masses, assert_state, idle_step, make, place, pseudo_random_actions, value_of_staying, wave,
    };

    type BallRobot = Robot<BallInCup>;

    /// In the cup at rest, the cup lowered by both weights.
    const CAUGHT: [f64; 4] = [0.0, -0.064, 0.0, 0.28];

    #[test]
    fn a_ball_at_rest_stays_at_rest() {
        let mut ball: BallRobot = make("(start_noise: 0.0)");
        ball.reset(0, &mut [0.0; 8]).unwrap();
        for _ in 0..500 {
            let outcome = idle_step(&mut ball);
            assert!(outcome.in_reset_set && outcome.reset_reward > 0.9999, "{outcome:?}");
        }
    }

    #[test]
    fn a_swung_ball_comes_to_rest_again_by_itself() {
        let mut ball: BallRobot = make("()");
        ball.reset(0, &mut [0.0; 8]).unwrap();
        for action in pseudo_random_actions(2, 100) {
            ball.step(&action, &mut [0.0; 8]).unwrap();
        }
        let outcome = (0..3_000).map(|_| idle_step(&mut ball)).last().unwrap();
        assert!(outcome.in_reset_set, "{outcome:?}");
    }

    #[test]
    fn a_ball_in_the_cup_stays_and_is_a_success_and_one_below_is_not() {
        let mut ball: BallRobot = make("()");
        place(&mut ball, &CAUGHT);
        for step in 0..100 {
            let outcome = idle_step(&mut ball);
            assert!(step < 20 || (outcome.success && outcome.forward_reward == 1.0), "{step}: {outcome:?}");
        }
        ball.reset(0, &mut [0.0; 8]).unwrap();
        let outcome = idle_step(&mut ball);
        assert!(!outcome.success && outcome.forward_reward == 0.0);
    }

    #[test]
    fn a_resting_and_a_caught_ball_have_reset_values_above_the_default_threshold() {
        let mut ball: BallRobot = make("()");
        ball.reset(0, &mut [0.0; 8]).unwrap();
        let resting = value_of_staying(&mut ball);
        place(&mut ball, &CAUGHT);
        let caught = value_of_staying(&mut ball);
        assert!(resting > 99.0 && caught > 75.0, "{resting} {caught}");
    }

    #[test]
    fn the_ball_can_be_caught_within_an_episode() {
        let mut ball: BallRobot = make("(start_noise: 0.0)");
        ball.reset(0, &mut [0.0; 8]).unwrap();
        let held = [[1.0, 0.0], [-1.0, 1.0], [0.0, -1.0], [1.0, 1.0], [1.0, -1.0]];
        let caught = (0..50).any(|step| ball.step(&held[step / 10], &mut [0.0; 8]).unwrap().success);
        assert!(caught);
    }

    #[test]
    fn a_swing_matches_the_control_suite() {
        // dm_control 1.0.50, MuJoCo 3.17.0, ball-in-cup: 60 steps from `RESTING`, control i of step k being (floor(7k/4) + 3i) mod 16 / 8 − 1.
        let published = [
            -0.04734968,
            -0.081214862,
            -0.04245331,
            -0.040599206,
            -0.210918643,
            0.506680904,
            -0.457334202,
            -0.268803647,
        ];
        let mut ball: BallRobot = make("(start_noise: 0.0)");
        ball.reset(0, &mut [0.0; 8]).unwrap();
        for step in 0..60 {
            let action = [0, 1].map(|dimension| wave(7 * step / 4, dimension));
            ball.step(&action, &mut [0.0; 8]).unwrap();
        }
        assert_state(ball.simulation_mut(), &published);
        assert_masses(ball.simulation_mut(), &[0.06515291, 0.06544985]);
    }
}
