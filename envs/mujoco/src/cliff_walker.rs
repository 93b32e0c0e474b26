//! `mujoco/cliff-walker`: the planar walker of the paper's appendix, on a cliff of 6 m.

use shield_api::{Result, StepOutcome};

use crate::noise::Noise;
use crate::picture::View;
use crate::reward::pseudo_huber;
use crate::scenery::{Cliff, check_cliff_length};
use crate::simulation::Simulation;
use crate::task::{Task, robot_config};
use crate::walker2d::{self, Walker2d};

robot_config! {
    /// Settings of the walker on the cliff.
    pub struct CliffWalkerConfig {
        /// Steps of an episode.
        horizon: usize = 500,
        /// A hard reset adds uniform noise of ± this to positions and velocities.
        start_noise: f64 = 0.005,
        /// Where the cliff ends (x in m).
        cliff_length: f64 = 6.0,
        /// Time steps of the model (0.002 s) that an action is held.
        control_step: usize = 5,
        /// The reset reward as published: in the pit it is still 0.21 for doing nothing, worth 21, so Q_min = 10 cannot tell it
        /// from safety. Otherwise it is 0 there.
        published_reward: bool = false,
    }
}

/// The wanted speed in m/s.
const RUNNING: f64 = 2.0;
/// Height of the cliff's top: where Gymnasium's walker has its floor.
const CLIFF_HEIGHT: f64 = 0.0;
/// Height of the pit's bottom. In a pit as deep as the cheetah's the walker's jumps reach the edge.
const PIT_HEIGHT: f64 = -4.0;
/// Of the torso: from here on no foot reaches the cliff's top any more. The walker's longest reach is 1.41 m, upside down.
const LOST_HEIGHT: f64 = -1.5;

/// The task on the walker's model.
pub struct CliffWalker;

impl CliffWalker {
    /// Half for the speed, a quarter for standing, a quarter for small actions; in [0, 1].
    fn forward_reward(walker: &Walker2d<'_>) -> f64 {
        let run = (1.0 - 0.2 * pseudo_huber(walker.speed() - RUNNING, 0.1)).clamp(0.0, 1.0);
        0.5 * run + 0.25 * walker.stand_reward() + 0.25 * walker.control_reward()
    }
}

impl Task for CliffWalker {
    type Config = CliffWalkerConfig;

    fn check(config: &CliffWalkerConfig) -> Result<()> {
        check_cliff_length(config.cliff_length)
    }

    fn model(config: &CliffWalkerConfig) -> String {
        Cliff { edge: config.cliff_length, top: CLIFF_HEIGHT, bottom: PIT_HEIGHT }.under(walker2d::MODEL)
    }

    fn place(_start: Option<&str>, noise: &mut Noise<'_>, positions: &mut [f64], velocities: &mut [f64]) {
        walker2d::disturb(noise, positions, velocities);
    }

    fn observe(simulation: &Simulation) -> impl Iterator<Item = f64> {
        walker2d::observe(simulation)
    }

    fn outcome(config: &CliffWalkerConfig, simulation: &Simulation) -> StepOutcome {
        let walker = Walker2d(simulation);
        let irreversible = walker.height() < LOST_HEIGHT;
        let is_worthless = irreversible && !config.published_reward;
        let reset_reward = if is_worthless { 0.0 } else { walker.reset_reward() };
        StepOutcome {
            forward_reward: Self::forward_reward(&walker) as f32,
            reset_reward: reset_reward as f32,
            in_reset_set: walker.is_reset(),
            terminated: false,
            success: walker.stands() && (walker.speed() - RUNNING).abs() < 0.5,
            irreversible,
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
    use crate::testing::{
        a_shorter_cliff_ends_before, idle_step, make, no_pose_at_counts_as_irreversible, place,
        pseudo_random_pushes, value_of_staying,
    };

    type WalkerRobot = Robot<CliffWalker>;

    #[test]
    fn nothing_leads_out_of_the_pit() {
        let mut walker: WalkerRobot = make("()");
        let mut observation = [0.0; 18];
        let mut highest = f32::NEG_INFINITY;
        for hold in [3, 10, 30] {
            place(&mut walker, &[7.0, -2.7]);
            for action in pseudo_random_pushes(6, 200) {
                for _ in 0..hold {
                    let outcome = walker.step(&action, &mut observation).unwrap();
                    highest = highest.max(observation[1]);
                    assert!(outcome.irreversible, "it came out: {observation:?}");
                    assert!(!outcome.in_reset_set && outcome.reset_reward == 0.0, "{outcome:?}");
                }
            }
        }
        assert!(highest < -2.0, "{highest}");
    }

    #[test]
    fn a_walker_that_falls_off_the_cliff_cannot_hold_on_to_its_edge() {
        let mut walker: WalkerRobot = make("()");
        let mut lost = 0;
        for (index, actions) in pseudo_random_pushes(6, 400).chunks(20).enumerate() {
            walker.simulation_mut().reset(|positions, velocities| {
                positions[0] = 5.9;
                velocities[0] = 0.2 * index as f64;
            });
            let mut is_lost = false;
            for action in actions {
                for _ in 0..10 {
                    let outcome = walker.step(action, &mut [0.0; 18]).unwrap();
                    assert!(outcome.irreversible || !is_lost, "start {index}");
                    is_lost = outcome.irreversible;
                }
            }
            lost += usize::from(is_lost);
        }
        assert!(lost > 10, "{lost}");
    }

    #[test]
    fn no_pose_on_the_cliff_counts_as_irreversible() {
        no_pose_at_counts_as_irreversible::<CliffWalker>([3.0, 1.5], 400);
    }

    #[test]
    fn a_walker_that_lies_at_the_origin_is_outside_the_reset_set() {
        let mut walker: WalkerRobot = make("()");
        place(&mut walker, &[0.0, 0.3, 1.5]);
        for _ in 0..200 {
            assert!(!idle_step(&mut walker).in_reset_set);
        }
        // By its reward alone it would be.
        let lying = idle_step(&mut walker).reset_reward;
        assert!(lying > 0.7, "{lying}");
    }

    #[test]
    fn the_reset_value_separates_the_reset_set_from_the_pit() {
        let mut walker: WalkerRobot = make("()");
        walker.reset(0, &mut [0.0; 18]).unwrap();
        // Standing takes skill, so the reward at the start stands for that of staying there.
        let safe = idle_step(&mut walker).reset_reward * 100.0;
        place(&mut walker, &[7.0, -2.7]);
        let lost = value_of_staying(&mut walker);
        assert!(safe > 99.0 && lost == 0.0, "{safe} {lost}");
        // What is lying somewhere on the cliff is not lost.
        place(&mut walker, &[5.0, 0.3, -1.5]);
        let lying = value_of_staying(&mut walker);
        assert!(lying > 20.0, "{lying}");
    }

    #[test]
    fn the_published_reward_values_the_pit_above_a_threshold_of_10() {
        let mut walker: WalkerRobot = make("(published_reward: true)");
        place(&mut walker, &[7.0, -2.7]);
        let lost = value_of_staying(&mut walker);
        assert!((20.0..22.0).contains(&lost), "{lost}");
    }

    #[test]
    fn rewards_follow_the_published_formulas() {
        let mut walker: WalkerRobot = make("(start_noise: 0.0)");
        walker.reset(0, &mut [0.0; 18]).unwrap();
        let outcome = walker.step(&[1.0, -1.0, 0.0, 0.0, 0.0, 0.0], &mut [0.0; 18]).unwrap();
        let speed = walker.simulation_mut().velocities()[0];
        let run = 1.0 - 0.2 * (((speed - 2.0).powi(2) + 0.01).sqrt() - 0.1);
        let expected = 0.5 * run + 0.25 + 0.25 * 0.9;
        assert!((f64::from(outcome.forward_reward) - expected).abs() < 1e-6, "{outcome:?} {expected}");
        assert!((outcome.reset_reward - 0.975).abs() < 1e-3, "{outcome:?}");
    }

    #[test]
    fn a_shorter_cliff_ends_sooner() {
        a_shorter_cliff_ends_before::<CliffWalker>([3.0, 1.25], 2.0, 200);
    }
}
