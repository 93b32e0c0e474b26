//! `mujoco/inverted-pendulum`: a pole on a cart with Gymnasium's reward, to judge learners by.

use shield_api::StepOutcome;

use crate::noise::Noise;
use crate::picture::View;
use crate::reward::tolerance;
use crate::simulation::Simulation;
use crate::task::{Task, robot_config};

robot_config! {
    /// Settings of the pendulum; the defaults are those of Gymnasium's InvertedPendulum-v5.
    pub struct InvertedPendulumConfig {
        /// Steps of an episode, unless the pole falls.
        horizon: usize = 1000,
        /// A hard reset draws positions and velocities uniformly from ± this.
        start_noise: f64 = 0.01,
        /// Time steps of the model (0.02 s) that an action is held.
        control_step: usize = 2,
    }
}

/// The pole counts as fallen from here on (rad).
const FALLEN: f64 = 0.2;

/// The quantities of the pendulum that the task speaks of.
struct Pendulum<'a>(&'a Simulation);

impl Pendulum<'_> {
    fn position(&self) -> f64 {
        self.0.positions()[0]
    }

    fn angle(&self) -> f64 {
        self.0.positions()[1]
    }

    fn is_upright(&self) -> bool {
        self.angle().abs() <= FALLEN
    }

    /// 1 for an upright pole at the rail's middle. In [0, 1].
    fn reset_reward(&self) -> f64 {
        tolerance(self.position(), [-0.05, 0.05], 1.0) * tolerance(self.angle(), [-0.05, 0.05], FALLEN)
    }
}

/// The task on the pendulum's model.
pub struct InvertedPendulum;

impl Task for InvertedPendulum {
    type Config = InvertedPendulumConfig;

    fn model(_config: &InvertedPendulumConfig) -> String {
        include_str!("inverted_pendulum.xml").to_owned()
    }

    fn place(_start: Option<&str>, noise: &mut Noise<'_>, positions: &mut [f64], velocities: &mut [f64]) {
        for value in positions.iter_mut().chain(velocities) {
            *value = noise.uniform();
        }
    }

    fn outcome(_config: &InvertedPendulumConfig, simulation: &Simulation) -> StepOutcome {
        let pendulum = Pendulum(simulation);
        let is_upright = pendulum.is_upright();
        let reset_reward = pendulum.reset_reward();
        StepOutcome {
            forward_reward: if is_upright { 1.0 } else { 0.0 },
            reset_reward: reset_reward as f32,
            in_reset_set: is_upright && reset_reward > 0.7,
            terminated: !is_upright,
            success: is_upright,
            irreversible: false,
        }
    }

    fn view(_simulation: &Simulation) -> View {
        View::from_the_side([0.0, 0.0, 0.2], 2.5)
    }
}

#[cfg(test)]
mod tests {
    use shield_api::Environment;

    use super::*;
    use crate::task::Robot;
    use crate::testing::{GymnasiumEpisode, make};

    #[test]
    fn an_episode_matches_gymnasium() {
        let episode = GymnasiumEpisode {
            scale: 0.125,
            steps: 18,
            terminated: true,
            total_reward: 17.0,
            last_observation: [-0.039588810, 0.202142592, -0.161705195, 1.005138335],
        };
        episode.agrees_with::<InvertedPendulum>();
    }

    #[test]
    fn a_linear_controller_balances_for_a_whole_episode_in_the_reset_set() {
        let mut pendulum: Robot<InvertedPendulum> = make("()");
        let mut observation = [0.0; 4];
        let (mut value, mut weight) = (0.0, 1.0);
        pendulum.reset(0, &mut observation).unwrap();
        for step in 0..1_000 {
            let [x, angle, speed, turn] = observation;
            let outcome = pendulum.step(&[x + 10.0 * angle + speed + 2.0 * turn], &mut observation).unwrap();
            assert!(outcome.in_reset_set && !outcome.terminated, "step {step}: {observation:?}");
            value += weight * outcome.reset_reward;
            weight *= 0.99;
        }
        assert!(value > 95.0, "{value}");
    }

    #[test]
    fn a_fallen_pole_ends_the_episode() {
        let mut pendulum: Robot<InvertedPendulum> = make("()");
        pendulum.simulation_mut().reset(|positions, _| positions[1] = 0.25);
        let outcome = pendulum.step(&[0.0], &mut [0.0; 4]).unwrap();
        assert!(outcome.terminated && !outcome.in_reset_set && outcome.forward_reward == 0.0, "{outcome:?}");
    }
}
