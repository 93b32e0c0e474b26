//! `mujoco/walker`: the planar walker on a plane with Gymnasium's reward, to judge learners by.

use shield_api::StepOutcome;

use crate::noise::Noise;
use crate::picture::View;
use crate::scenery::on_plane;
use crate::simulation::Simulation;
use crate::task::{Task, robot_config};
use crate::walker2d::{self, Walker2d};

robot_config! {
    /// Settings of the walker; the defaults are those of Gymnasium's Walker2d-v5.
    pub struct WalkerConfig {
        /// Steps of an episode, unless the walker falls.
        horizon: usize = 1000,
        /// A hard reset adds uniform noise of ± this to positions and velocities.
        start_noise: f64 = 0.005,
        /// Time steps of the model (0.002 s) that an action is held.
        control_step: usize = 4,
    }
}

/// Weight of the squared action in the reward.
const CONTROL_COST: f64 = 1e-3;

/// The task on the walker's model.
pub struct Walker;

impl Task for Walker {
    type Config = WalkerConfig;

    fn model(_config: &WalkerConfig) -> String {
        on_plane(walker2d::MODEL)
    }

    fn place(_start: Option<&str>, noise: &mut Noise<'_>, positions: &mut [f64], velocities: &mut [f64]) {
        walker2d::disturb(noise, positions, velocities);
    }

    /// Without x, on which the reward does not depend.
    fn observe(simulation: &Simulation) -> impl Iterator<Item = f64> {
        walker2d::observe(simulation).skip(1)
    }

    fn outcome(config: &WalkerConfig, simulation: &Simulation) -> StepOutcome {
        let walker = Walker2d(simulation);
        let healthy = if walker.stands() { 1.0 } else { 0.0 };
        let forward = simulation.mean_speed(config.control_step);
        StepOutcome {
            forward_reward: (healthy + forward - CONTROL_COST * simulation.squared_control()) as f32,
            reset_reward: walker.reset_reward() as f32,
            in_reset_set: walker.is_reset(),
            terminated: !walker.stands(),
            ..StepOutcome::default()
        }
    }

    fn view(simulation: &Simulation) -> View {
        Walker2d(simulation).view()
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
            scale: 1.0,
            steps: 19,
            terminated: true,
            total_reward: 2.823757088,
            last_observation: [
                1.074152663,
                -1.057520688,
                -0.933933750,
                -0.463788708,
                0.450117459,
                -0.943928326,
                -0.453086560,
                0.254910552,
                -1.037337643,
                -3.025910941,
                -10.000000000,
                -10.000000000,
                -9.216314028,
                5.750411855,
                -10.000000000,
                -4.717980788,
                10.000000000,
            ],
        };
        episode.agrees_with::<Walker>();
    }

    #[test]
    fn standing_at_the_start_has_a_reset_value_of_100_and_a_fall_leaves_the_reset_set() {
        let mut walker: Robot<Walker> = make("()");
        let mut observation = [0.0; 17];
        walker.reset(0, &mut observation).unwrap();
        let standing = walker.step(&[0.0; 6], &mut observation).unwrap();
        assert!(standing.in_reset_set && 100.0 * standing.reset_reward > 99.0, "{standing:?}");
        walker.simulation_mut().reset(|positions, _| positions[1..3].copy_from_slice(&[0.3, 1.5]));
        let fallen = walker.step(&[0.0; 6], &mut observation).unwrap();
        assert!(fallen.terminated && !fallen.in_reset_set, "{fallen:?}");
    }
}
