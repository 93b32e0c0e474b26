//! `mujoco/peg-insertion`: an arm that pulls a peg out of a hole; putting it back is the reset (paper, section 6.6).

use shield_api::StepOutcome;

use crate::noise::Noise;
use crate::picture::View;
use crate::simulation::Simulation;
use crate::task::{Task, robot_config};

robot_config! {
    /// Settings of the peg insertion.
    pub struct PegInsertionConfig {
        /// Steps of an episode.
        horizon: usize = 50,
        /// Whether the reset reward pays for being inserted only; otherwise it also grows towards the hole.
        sparse: bool = false,
        /// A hard reset draws the joints' speeds (rad/s) uniformly from ± this.
        start_noise: f64 = 0.005,
        /// Time steps of the model (0.01 s) that an action is held.
        control_step: usize = 5,
    }
}

/// Bottom and top of the peg in the hole.
const INSERTED: [f64; 6] = [0.0, 0.3, -0.5, 0.0, 0.3, -0.2];
/// Bottom and top of the peg when it is out: where the start `above` has them.
const REMOVED: [f64; 6] = [0.106, 0.157, 0.150, 0.244, -0.094, 0.237];

/// Joint angles with the peg in the hole.
const HOLE: [f64; 7] = [0.52601062, 0.57254126, -2.0747581, -1.55342248, 0.15375072, -0.5747922, 0.70163815];
/// Joint angles with the peg above it, turned on its side.
const ABOVE: [f64; 7] =
    [0.44542705, 0.64189252, -0.39544481, -2.32144865, -0.17935136, -0.60320289, 1.57110214];

/// The model's two sites.
const PEG_BOTTOM: usize = 0;
const PEG_TOP: usize = 1;

/// The quantities of the peg that the task speaks of.
struct Peg<'a>(&'a Simulation);

impl Peg<'_> {
    /// Of bottom and top from a place of both: the Euclidean norm of all six differences.
    fn distance(&self, place: &[f64; 6]) -> f64 {
        let ends = [self.0.site(PEG_BOTTOM), self.0.site(PEG_TOP)];
        let squares = ends.as_flattened().iter().zip(place).map(|(end, place)| (end - place).powi(2));
        squares.sum::<f64>().sqrt()
    }

    /// At least half of the hole's depth.
    fn is_inserted(&self) -> bool {
        self.distance(&INSERTED) < 0.1 && self.0.site(PEG_BOTTOM)[2] < -0.45
    }

    fn control_reward(&self) -> f64 {
        (1.0 - 0.1 * self.0.squared_control()).clamp(0.0, 1.0)
    }

    /// 0.8 for being near where the peg is out, 0.2 for small actions. In [0, 1].
    fn remove_reward(&self) -> f64 {
        0.8 * nearness(self.distance(&REMOVED)) + 0.2 * self.control_reward()
    }

    /// Sparse: 0.8 for being inserted, 0.2 for small actions. Dense: a half, a quarter, and a quarter for nearness. In [0, 1].
    fn insert_reward(&self, sparse: bool) -> f64 {
        let inserted = if self.is_inserted() { 1.0 } else { 0.0 };
        if sparse {
            0.8 * inserted + 0.2 * self.control_reward()
        } else {
            0.5 * inserted + 0.25 * self.control_reward() + 0.25 * nearness(self.distance(&INSERTED))
        }
    }
}

fn nearness(distance: f64) -> f64 {
    (1.0 - distance).clamp(0.0, 1.0)
}

/// The task on the arm's model.
pub struct PegInsertion;

impl Task for PegInsertion {
    type Config = PegInsertionConfig;

    /// `hole` is the usual one.
    const STARTS: &'static [&'static str] = &["hole", "above"];

    fn model(_config: &PegInsertionConfig) -> String {
        include_str!("peg_insertion.xml").to_owned()
    }

    fn place(start: Option<&str>, noise: &mut Noise<'_>, positions: &mut [f64], velocities: &mut [f64]) {
        positions.copy_from_slice(if start == Some("above") { &ABOVE } else { &HOLE });
        velocities.fill_with(|| noise.uniform());
    }

    fn outcome(config: &PegInsertionConfig, simulation: &Simulation) -> StepOutcome {
        let peg = Peg(simulation);
        StepOutcome {
            forward_reward: peg.remove_reward() as f32,
            reset_reward: peg.insert_reward(config.sparse) as f32,
            in_reset_set: peg.is_inserted(),
            terminated: false,
            success: peg.distance(&REMOVED) < 0.1,
            // The hand never lets go of the peg.
            irreversible: false,
        }
    }

    fn view(_simulation: &Simulation) -> View {
        View { target: [0.0, 0.15, -0.25], distance: 1.6, azimuth: 215.0, elevation: -35.0 }
    }
}

#[cfg(test)]
mod tests {
    use shield_api::Environment;

    use super::*;
    use crate::task::Robot;
    use crate::testing::{idle_step, make, place, pseudo_random_actions, value_of_staying};

    type Arm = Robot<PegInsertion>;

    /// Joint angles with the peg upright, its bottom 0.02 above the hole's mouth, then half-way down into the hole.
    const OVER_MOUTH: [f64; 7] = [0.546, 0.3205, -2.0014, -1.7753, 0.2227, -0.5169, 0.856];
    const HALF_WAY: [f64; 7] = [0.5368, 0.4451, -2.0472, -1.6749, 0.1835, -0.5417, 0.7791];

    fn start(arm: &mut Arm, start: &str) {
        arm.reset_to(start, 0, &mut [0.0; 14]).unwrap();
    }

    #[test]
    fn the_starts_put_the_peg_where_the_published_dimensions_say() {
        let mut arm: Arm = make("(start_noise: 0.0)");
        for (name, place, tolerance) in [("hole", INSERTED, 1e-7), ("above", REMOVED, 1e-3)] {
            start(&mut arm, name);
            let distance = Peg(arm.simulation_mut()).distance(&place);
            assert!(distance < tolerance, "{name}: {distance}");
        }
    }

    #[test]
    fn the_sites_have_the_numbers_that_the_task_uses() {
        let model = Simulation::new(include_str!("peg_insertion.xml")).unwrap();
        let id = |name| model.model().name_to_id(mujoco_rs::prelude::MjtObjBase::mjOBJ_SITE, name);
        assert_eq!([id("peg_bottom"), id("peg_top")], [Some(PEG_BOTTOM), Some(PEG_TOP)]);
    }

    #[test]
    fn an_idle_peg_stays_in_its_hole() {
        let mut arm: Arm = make("()");
        for seed in 0..20 {
            arm.reset(seed, &mut [0.0; 14]).unwrap();
            for step in 0..50 {
                let outcome = idle_step(&mut arm);
                let distance = Peg(arm.simulation_mut()).distance(&INSERTED);
                assert!(outcome.in_reset_set && distance < 0.02, "seed {seed}, step {step}: {distance}");
            }
        }
    }

    #[test]
    fn the_walls_hold_the_peg_against_a_sideways_push() {
        let mut arm: Arm = make("()");
        start(&mut arm, "hole");
        for _ in 0..50 {
            arm.step(&[2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], &mut [0.0; 14]).unwrap();
        }
        let bottom = arm.simulation_mut().site(PEG_BOTTOM);
        assert!(bottom[0].hypot(bottom[1] - 0.3) < 0.02 && bottom[2] < -0.45, "{bottom:?}");
    }

    #[test]
    fn random_torques_pull_the_peg_out_through_the_mouth_alone() {
        let mut arm: Arm = make("()");
        let mut out = 0;
        for seed in 0..20 {
            arm.reset(seed, &mut [0.0; 14]).unwrap();
            let actions = pseudo_random_actions(7, 10 * (seed as usize + 1)).split_off(10 * seed as usize);
            let mut last = StepOutcome::default();
            for action in actions {
                let action: Vec<f32> = action.iter().map(|value| 2.0 * value).collect();
                for _ in 0..10 {
                    last = arm.step(&action, &mut [0.0; 14]).unwrap();
                    let [x, y, z] = arm.simulation_mut().site(PEG_BOTTOM);
                    let sideways = x.abs().max((y - 0.3).abs());
                    assert!(!(0.045..0.39).contains(&sideways) || z > -0.43, "through the wall: {x} {y} {z}");
                }
            }
            out += usize::from(!last.in_reset_set);
        }
        assert!(out > 15, "{out}");
    }

    #[test]
    fn the_reset_value_separates_the_hole_from_the_outside() {
        // Densely, a quarter for no action and a quarter for nearness are the most that a peg outside can have: 50.
        for (config, outside, q_min) in [("()", 50.0, 60.0), ("(sparse: true)", 20.1, 40.0)] {
            let mut arm: Arm = make(config);
            start(&mut arm, "hole");
            let safe = value_of_staying(&mut arm);
            start(&mut arm, "above");
            let stuck = value_of_staying(&mut arm);
            place(&mut arm, &OVER_MOUTH);
            let nearly = value_of_staying(&mut arm);
            assert!(safe > q_min + 30.0, "{config}: {safe}");
            assert!(
                stuck < outside && nearly < outside && outside < q_min - 5.0,
                "{config}: {stuck} {nearly}"
            );
        }
    }

    #[test]
    fn rewards_follow_the_formulas_of_the_readme() {
        let action = [1.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0];
        for (config, expected) in
            [("(start_noise: 0.0)", 0.5 + 0.2 + 0.25), ("(start_noise: 0.0, sparse: true)", 0.8 + 0.16)]
        {
            let mut arm: Arm = make(config);
            start(&mut arm, "hole");
            let outcome = arm.step(&action, &mut [0.0; 14]).unwrap();
            assert!((outcome.reset_reward - expected).abs() < 0.02, "{config}: {outcome:?}");
            start(&mut arm, "above");
            let outcome = arm.step(&action, &mut [0.0; 14]).unwrap();
            assert!(outcome.success && (outcome.forward_reward - 0.96).abs() < 0.1, "{config}: {outcome:?}");
        }
    }

    #[test]
    fn stiff_joints_lead_the_peg_back_into_the_hole() {
        let mut arm: Arm = make("()");
        let mut observation = [0.0; 14];
        place(&mut arm, &OVER_MOUTH);
        for (seen, angle) in observation.iter_mut().zip(OVER_MOUTH) {
            *seen = angle as f32;
        }
        let mut steps = 0;
        let mut outcome = StepOutcome::default();
        while !outcome.in_reset_set && steps < 50 {
            let progress = f64::from(steps) / 15.0;
            let (from, to) = if progress < 1.0 { (OVER_MOUTH, HALF_WAY) } else { (HALF_WAY, HOLE) };
            let share = if progress < 1.0 { progress } else { (progress - 1.0).min(1.0) };
            let torques: [f32; 7] = std::array::from_fn(|joint| {
                let wanted = (from[joint] + share * (to[joint] - from[joint])) as f32;
                let torque = 400.0 * (wanted - observation[joint]) - observation[7 + joint];
                torque * [1.0, 1.0, 0.2, 0.5, 0.2, 0.2, 0.2][joint]
            });
            outcome = arm.step(&torques, &mut observation).unwrap();
            steps += 1;
        }
        assert!(outcome.in_reset_set, "{observation:?}");
    }
}
