//! `mujoco/cliff-cheetah`: the half-cheetah of the paper's section 6, on a cliff of 14 m.

use shield_api::{Result, StepOutcome};

use crate::cheetah::{self, Cheetah};
use crate::noise::Noise;
use crate::picture::View;
use crate::reward::tolerance;
use crate::scenery::{Cliff, check_cliff_length};
use crate::simulation::Simulation;
use crate::task::{Task, robot_config};

robot_config! {
    /// Settings of the cheetah.
    pub struct CliffCheetahConfig {
        /// Steps of an episode.
        horizon: usize = 500,
        /// A hard reset adds uniform noise of ± this to the positions, and normal noise of this deviation to the velocities.
        start_noise: f64 = 0.1,
        /// Where the cliff ends (x in m).
        cliff_length: f64 = 14.0,
        /// Time steps of the model (0.01 s) that an action is held.
        control_step: usize = 5,
    }
}

/// The wanted running speeds in m/s.
const RUNNING: [f64; 2] = [9.0, 11.0];
/// Height of the cliff's top.
const CLIFF_HEIGHT: f64 = 0.05;
/// Height of the pit's bottom.
const PIT_HEIGHT: f64 = -1.9;

/// The task on the cheetah's model.
pub struct CliffCheetah;

impl Task for CliffCheetah {
    type Config = CliffCheetahConfig;

    fn check(config: &CliffCheetahConfig) -> Result<()> {
        check_cliff_length(config.cliff_length)
    }

    fn model(config: &CliffCheetahConfig) -> String {
        Cliff { edge: config.cliff_length, top: CLIFF_HEIGHT, bottom: PIT_HEIGHT }.under(cheetah::MODEL)
    }

    fn place(_start: Option<&str>, noise: &mut Noise<'_>, positions: &mut [f64], velocities: &mut [f64]) {
        cheetah::disturb(noise, positions, velocities);
    }

    fn outcome(_config: &CliffCheetahConfig, simulation: &Simulation) -> StepOutcome {
        let cheetah = Cheetah(simulation);
        StepOutcome {
            forward_reward: tolerance(cheetah.speed(), RUNNING, 7.0) as f32,
            reset_reward: cheetah.reset_reward() as f32,
            in_reset_set: cheetah.is_reset(),
            terminated: false,
            success: (RUNNING[0]..=RUNNING[1]).contains(&cheetah.speed()),
            // On the cliff the torso's middle is above its top, in every pose.
            irreversible: cheetah.height() < CLIFF_HEIGHT,
        }
    }

    fn view(simulation: &Simulation) -> View {
        Cheetah(simulation).view()
    }
}

#[cfg(test)]
mod tests {
    use shield_api::Environment;

    use super::*;
    use crate::task::Robot;
    use crate::testing::{
        a_shorter_cliff_ends_before, make, no_pose_at_counts_as_irreversible, place, pseudo_random_pushes,
        value_of_staying,
    };

    type CheetahRobot = Robot<CliffCheetah>;

    #[test]
    fn a_cheetah_that_runs_off_the_cliff_stays_in_the_pit() {
        let mut cheetah: CheetahRobot = make("()");
        let mut observation = [0.0; 18];
        place(&mut cheetah, &[15.0, -0.3]);
        let mut entered = 0;
        for action in pseudo_random_pushes(6, 400) {
            let outcome = (0..3).map(|_| cheetah.step(&action, &mut observation).unwrap()).last().unwrap();
            assert!(!outcome.in_reset_set && outcome.reset_reward == 0.0, "{outcome:?}");
            assert!(outcome.irreversible || entered == 0, "it came out: {observation:?}");
            entered += usize::from(outcome.irreversible);
        }
        assert!(entered > 350, "{entered}");
    }

    #[test]
    fn no_pose_on_the_cliff_counts_as_irreversible() {
        no_pose_at_counts_as_irreversible::<CliffCheetah>([5.0, 0.3], 100);
    }

    #[test]
    fn a_cheetah_on_its_back_at_the_origin_is_outside_the_reset_set() {
        let mut cheetah: CheetahRobot = make("()");
        let mut observation = [0.0; 18];
        place(&mut cheetah, &[0.0, 0.0, std::f64::consts::PI]);
        for step in 0..60 {
            let outcome = cheetah.step(&[0.0; 6], &mut observation).unwrap();
            assert!(!outcome.in_reset_set, "{step}: {observation:?}");
        }
    }

    #[test]
    fn a_cheetah_that_stands_still_stays_in_the_reset_set() {
        let mut cheetah: CheetahRobot = make("()");
        let mut observation = [0.0; 18];
        for seed in 0..20 {
            cheetah.reset(seed, &mut observation).unwrap();
            for step in 0..100 {
                let outcome = cheetah.step(&[0.0; 6], &mut observation).unwrap();
                assert!(outcome.in_reset_set, "seed {seed}, step {step}: {observation:?}");
            }
        }
    }

    #[test]
    fn the_reset_value_separates_the_reset_set_from_the_pit() {
        let mut cheetah: CheetahRobot = make("()");
        cheetah.reset(0, &mut [0.0; 18]).unwrap();
        let safe = value_of_staying(&mut cheetah);
        place(&mut cheetah, &[15.0, -1.9]);
        let lost = value_of_staying(&mut cheetah);
        assert!(safe > 89.0 && lost == 0.0, "{safe} {lost}");
    }

    #[test]
    fn a_shorter_cliff_ends_sooner() {
        a_shorter_cliff_ends_before::<CliffCheetah>([4.0, 0.0], 3.0, 30);
    }
}
