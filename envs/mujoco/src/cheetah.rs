//! The half-cheetah: its model and its quantities, for the tasks that it has.

use crate::noise::Noise;
use crate::picture::View;
use crate::reward::{tolerance, wrapped};
use crate::simulation::Simulation;

/// The robot without ground.
pub const MODEL: &str = include_str!("half_cheetah.xml");

/// Height of the torso in the default pose.
const DEFAULT_HEIGHT: f64 = 0.7;

/// The quantities of the cheetah that the tasks speak of.
pub struct Cheetah<'a>(pub &'a Simulation);

impl Cheetah<'_> {
    pub fn position(&self) -> f64 {
        self.0.positions()[0]
    }

    /// Of the torso's middle, in the world.
    pub fn height(&self) -> f64 {
        DEFAULT_HEIGHT + self.0.positions()[1]
    }

    /// From the side, going along; into the pit as well.
    pub fn view(&self) -> View {
        View::from_the_side([self.position(), 0.0, self.height().min(DEFAULT_HEIGHT)], 3.5)
    }

    pub fn pitch(&self) -> f64 {
        wrapped(self.0.positions()[2])
    }

    pub fn speed(&self) -> f64 {
        self.0.velocities()[0]
    }

    /// 0.8 near the origin, 0.1 falling with the distance from it, 0.1 for an upright torso; in [0, 1].
    pub fn reset_reward(&self) -> f64 {
        let distance = self.position().abs();
        let near = if distance < 0.5 { 0.8 } else { 0.0 };
        let upright = tolerance(self.pitch(), [-0.05, 0.05], 0.1);
        (near + 0.1 * (1.0 - 0.2 * distance) + 0.1 * upright).clamp(0.0, 1.0)
    }

    /// The paper's "reset reward above 0.7" alone would admit a cheetah on its back.
    pub fn is_reset(&self) -> bool {
        self.reset_reward() > 0.7 && self.pitch().abs() < 0.5
    }
}

/// Adds uniform noise to the positions and normal noise to the velocities.
pub fn disturb(noise: &mut Noise<'_>, positions: &mut [f64], velocities: &mut [f64]) {
    positions.iter_mut().for_each(|position| *position += noise.uniform());
    velocities.iter_mut().for_each(|velocity| *velocity += noise.normal());
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{assert_masses, assert_state};

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

    #[test]
    fn masses_match_gymnasiums_model() {
        let simulation = Simulation::new(MODEL).unwrap();
        let published = [6.25020921, 1.54351464, 1.5874477, 1.09539749, 1.43807531, 1.20083682, 0.88451883];
        assert_masses(&simulation, &published);
        assert!((simulation.model().totalmass() - 14.0).abs() < 1e-9);
    }

    #[test]
    fn free_flight_matches_gymnasiums_model() {
        let mut simulation = Simulation::new(MODEL).unwrap();
        simulation.reset(|positions, _| positions[1] = 10.0);
        for k in 0..20 {
            let action: [f32; 6] = std::array::from_fn(|i| (0.7f32 * k as f32 + i as f32).sin());
            simulation.advance(&action, 5).unwrap();
        }
        assert_state(&simulation, &GYMNASIUM_FREE_FLIGHT);
    }
}
