//! `mujoco/half-cheetah`: the half-cheetah on a plane with Gymnasium's reward, to judge learners by.

use shield_api::StepOutcome;

use crate::cheetah::{self, Cheetah};
use crate::noise::Noise;
use crate::picture::View;
use crate::scenery::on_plane;
use crate::simulation::Simulation;
use crate::task::{Task, robot_config};

robot_config! {
    /// Settings of the half-cheetah; the defaults are those of Gymnasium's HalfCheetah-v5.
    pub struct HalfCheetahConfig {
        /// Steps of an episode.
        horizon: usize = 1000,
        /// A hard reset adds uniform noise of ± this to the positions, and normal noise of this deviation to the velocities.
        start_noise: f64 = 0.1,
        /// Time steps of the model (0.01 s) that an action is held.
        control_step: usize = 5,
    }
}

/// Weight of the squared action in the reward.
const CONTROL_COST: f64 = 0.1;

/// The task on the cheetah's model.
pub struct HalfCheetah;

impl Task for HalfCheetah {
    type Config = HalfCheetahConfig;

    fn model(_config: &HalfCheetahConfig) -> String {
        on_plane(cheetah::MODEL)
    }

    fn place(_start: Option<&str>, noise: &mut Noise<'_>, positions: &mut [f64], velocities: &mut [f64]) {
        cheetah::disturb(noise, positions, velocities);
    }

    /// Without x, on which the reward does not depend.
    fn observe(simulation: &Simulation) -> impl Iterator<Item = f64> {
        simulation.positions()[1..].iter().chain(simulation.velocities()).copied()
    }

    fn outcome(config: &HalfCheetahConfig, simulation: &Simulation) -> StepOutcome {
        let cheetah = Cheetah(simulation);
        let forward = simulation.mean_speed(config.control_step);
        StepOutcome {
            forward_reward: (forward - CONTROL_COST * simulation.squared_control()) as f32,
            reset_reward: cheetah.reset_reward() as f32,
            in_reset_set: cheetah.is_reset(),
            ..StepOutcome::default()
        }
    }

    fn view(simulation: &Simulation) -> View {
        Cheetah(simulation).view()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::task::Robot;
    use crate::testing::{GymnasiumEpisode, make, value_of_staying};

    #[test]
    fn an_episode_matches_gymnasium() {
        let episode = GymnasiumEpisode {
            scale: 1.0,
            steps: 40,
            terminated: false,
            total_reward: -12.310_66,
            last_observation: [
                -0.073976484,
                0.052268522,
                -0.148624510,
                -0.037828591,
                -0.233069645,
                -0.213773890,
                0.115847663,
                -0.243507921,
                -0.631475608,
                0.174894507,
                1.389916080,
                -5.001642874,
                -6.864590629,
                5.453403514,
                -0.928420009,
                -1.390704917,
                -2.822152780,
            ],
        };
        episode.agrees_with::<HalfCheetah>();
    }

    #[test]
    fn staying_at_the_start_has_a_reset_value_of_90() {
        let mut cheetah: Robot<HalfCheetah> = make("()");
        let safe = value_of_staying(&mut cheetah);
        assert!(safe > 89.0, "{safe}");
    }
}
