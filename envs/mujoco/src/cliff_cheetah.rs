//! `mujoco/cliff-cheetah`: the half-cheetah of the paper's section 6, on a cliff of 14 m.

use rand::RngExt;
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;
use shield_api::{Result, StepOutcome};

use crate::reward::{tolerance, wrapped};
use crate::simulation::Simulation;
use crate::task::{Task, check_start_noise};

shield_api::config! {
    /// Settings of the cheetah.
    pub struct CliffCheetahConfig {
        /// Steps of an episode, of 0.05 s each.
        horizon: usize = 500,
        /// A hard reset adds uniform noise of ± this to the positions, and normal noise of this deviation to the velocities.
        start_noise: f64 = 0.1,
    }
}

/// The wanted running speeds in m/s.
const RUNNING: [f64; 2] = [9.0, 11.0];
/// Height of the torso in the default pose, and of the cliff's top.
const DEFAULT_HEIGHT: f64 = 0.7;
const CLIFF_HEIGHT: f64 = 0.05;

/// The quantities of the cheetah that the task speaks of.
struct Cheetah<'a>(&'a Simulation);

impl Cheetah<'_> {
    fn position(&self) -> f64 {
        self.0.positions()[0]
    }

    /// Of the torso's middle, in the world.
    fn height(&self) -> f64 {
        DEFAULT_HEIGHT + self.0.positions()[1]
    }

    fn pitch(&self) -> f64 {
        wrapped(self.0.positions()[2])
    }

    fn speed(&self) -> f64 {
        self.0.velocities()[0]
    }
}

/// The task on the cheetah's model.
pub struct CliffCheetah {
    config: CliffCheetahConfig,
}

impl CliffCheetah {
    /// 0.8 near the origin, 0.1 falling with the distance from it, 0.1 for an upright torso; in [0, 1].
    fn reset_reward(cheetah: &Cheetah<'_>) -> f64 {
        let distance = cheetah.position().abs();
        let near = if distance < 0.5 { 0.8 } else { 0.0 };
        let upright = tolerance(cheetah.pitch(), [-0.05, 0.05], 0.1);
        (near + 0.1 * (1.0 - 0.2 * distance) + 0.1 * upright).clamp(0.0, 1.0)
    }
}

impl Task for CliffCheetah {
    type Config = CliffCheetahConfig;

    const MODEL: &'static str = include_str!("cliff_cheetah.xml");
    const SUBSTEPS: usize = 5;

    fn new(config: CliffCheetahConfig) -> Result<Self> {
        check_start_noise(config.start_noise)?;
        Ok(Self { config })
    }

    fn horizon(&self) -> usize {
        self.config.horizon
    }

    fn place(&self, _start: Option<&str>, rng: &mut Pcg64, positions: &mut [f64], velocities: &mut [f64]) {
        let noise = self.config.start_noise;
        for position in positions {
            *position += rng.random_range(-noise..=noise);
        }
        for velocity in velocities {
            let standard: f64 = rng.sample(StandardNormal);
            *velocity += noise * standard;
        }
    }

    fn outcome(&self, simulation: &Simulation) -> StepOutcome {
        let cheetah = Cheetah(simulation);
        let reset_reward = Self::reset_reward(&cheetah);
        StepOutcome {
            forward_reward: tolerance(cheetah.speed(), RUNNING, 7.0) as f32,
            reset_reward: reset_reward as f32,
            // The paper's "reset reward above 0.7" alone would admit a cheetah on its back.
            in_reset_set: reset_reward > 0.7 && cheetah.pitch().abs() < 0.5,
            terminated: false,
            success: (RUNNING[0]..=RUNNING[1]).contains(&cheetah.speed()),
            // On the cliff the torso's middle is above its top, in every pose.
            irreversible: cheetah.height() < CLIFF_HEIGHT,
        }
    }
}

#[cfg(test)]
mod tests {
    use shield_api::Environment;

    use super::*;
    use crate::suite::{make, pseudo_random_actions, value_of_staying};
    use crate::task::Robot;

    type CheetahRobot = Robot<CliffCheetah>;

    /// What Gymnasium's own model computes: MuJoCo 3.17.0, `half_cheetah.xml`, qpos[1] = 10, then 20 actions sin(0.7 k + i).
    const GYMNASIUM_FREE_FLIGHT: [f64; 18] = [
        -0.012027200610,
        5.101019506234,
        -0.239126083342,
        0.528757701418,
        0.579898930001,
        0.298805323078,
        -0.585666218991,
        -0.549124249130,
        -0.384463851860,
        -0.039891565281,
        -10.378888610289,
        0.253332655354,
        9.467869254516,
        1.320879798035,
        -4.419068315113,
        -15.367018309936,
        -2.350049383510,
        4.122431602062,
    ];

    fn place(cheetah: &mut CheetahRobot, x: f64, z: f64, pitch: f64) {
        cheetah.simulation_mut().reset(|positions, _| positions[..3].copy_from_slice(&[x, z, pitch]));
    }

    #[test]
    fn masses_are_those_of_gymnasiums_model() {
        let simulation = Simulation::new(CliffCheetah::MODEL).unwrap();
        let model = simulation.model();
        let published = [6.25020921, 1.54351464, 1.5874477, 1.09539749, 1.43807531, 1.20083682, 0.88451883];
        for (mass, published) in model.body_mass()[1..].iter().zip(published) {
            assert!((mass - published).abs() < 1e-8, "{mass} {published}");
        }
        assert!((model.totalmass() - 14.0).abs() < 1e-9);
    }

    #[test]
    fn free_flight_is_that_of_gymnasiums_model() {
        let mut simulation = Simulation::new(CliffCheetah::MODEL).unwrap();
        simulation.reset(|positions, _| positions[1] = 10.0);
        for k in 0..20 {
            let action: [f32; 6] = std::array::from_fn(|i| (0.7f32 * k as f32 + i as f32).sin());
            simulation.advance(&action, CliffCheetah::SUBSTEPS).unwrap();
        }
        let state = simulation.positions().iter().chain(simulation.velocities());
        for (index, (ours, theirs)) in state.zip(GYMNASIUM_FREE_FLIGHT).enumerate() {
            assert!((ours - theirs).abs() < 1e-6, "{index}: {ours} {theirs}");
        }
    }

    #[test]
    fn whoever_runs_off_the_cliff_stays_in_the_pit() {
        let mut cheetah: CheetahRobot = make("()");
        let mut observation = [0.0; 18];
        place(&mut cheetah, 15.0, -0.3, 0.0);
        let mut entered = 0;
        for action in pseudo_random_actions(6, 400) {
            let action: Vec<f32> = action.iter().map(|value| value.signum()).collect();
            let outcome = (0..3).map(|_| cheetah.step(&action, &mut observation).unwrap()).last().unwrap();
            assert!(!outcome.in_reset_set && outcome.reset_reward == 0.0, "{outcome:?}");
            assert!(outcome.irreversible || entered == 0, "it came out: {observation:?}");
            entered += usize::from(outcome.irreversible);
        }
        assert!(entered > 350, "{entered}");
    }

    #[test]
    fn no_pose_on_the_cliff_counts_as_irreversible() {
        let mut cheetah: CheetahRobot = make("()");
        let mut observation = [0.0; 18];
        for pitch in [0.0, 1.5, 3.1, -1.5] {
            place(&mut cheetah, 5.0, 0.3, pitch);
            for action in pseudo_random_actions(6, 100) {
                let outcome = cheetah.step(&action, &mut observation).unwrap();
                assert!(!outcome.irreversible, "{pitch}: {observation:?}");
            }
        }
    }

    #[test]
    fn a_cheetah_on_its_back_at_the_origin_is_not_reset() {
        let mut cheetah: CheetahRobot = make("()");
        let mut observation = [0.0; 18];
        place(&mut cheetah, 0.0, 0.0, std::f64::consts::PI);
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
    fn the_reset_value_tells_the_reset_set_from_the_pit() {
        let mut cheetah: CheetahRobot = make("()");
        cheetah.reset(0, &mut [0.0; 18]).unwrap();
        let safe = value_of_staying(&mut cheetah);
        place(&mut cheetah, 15.0, -1.9, 0.0);
        let lost = value_of_staying(&mut cheetah);
        assert!(safe > 89.0 && lost == 0.0, "{safe} {lost}");
    }

    #[test]
    fn each_field_of_the_configuration_is_heeded() {
        let cheetah: CheetahRobot = make("(horizon: 9)");
        assert_eq!(cheetah.spec().episode_length, 9);
        let mut still: CheetahRobot = make("(start_noise: 0.0)");
        let mut observation = [1.0; 18];
        still.reset(3, &mut observation).unwrap();
        assert_eq!(observation, [0.0; 18]);
    }
}
