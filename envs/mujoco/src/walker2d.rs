//! The planar walker: its model and its quantities, for the tasks that it has.

use crate::noise::Noise;
use crate::picture::View;
use crate::reward::wrapped;
use crate::simulation::Simulation;

/// The robot without ground.
pub const MODEL: &str = include_str!("walker2d.xml");

/// The quantities of the walker that the tasks speak of.
pub struct Walker2d<'a>(pub &'a Simulation);

impl Walker2d<'_> {
    pub fn position(&self) -> f64 {
        self.0.positions()[0]
    }

    /// Of the torso's middle above the ground.
    pub fn height(&self) -> f64 {
        self.0.positions()[1]
    }

    /// From the side, going along; into the pit as well.
    pub fn view(&self) -> View {
        View::from_the_side([self.position(), 0.0, self.height().min(1.0)], 4.0)
    }

    pub fn pitch(&self) -> f64 {
        wrapped(self.0.positions()[2])
    }

    pub fn speed(&self) -> f64 {
        self.0.velocities()[0]
    }

    /// The posture that Gymnasium calls healthy.
    pub fn stands(&self) -> bool {
        let height = self.height();
        height > 0.8 && height < 2.0 && self.pitch().abs() < 1.0
    }

    /// 0.25 for the height, 0.25 for standing tall, 0.5 for not having fallen; in [0, 1].
    pub fn stand_reward(&self) -> f64 {
        let height = self.height();
        let tall = if height > 1.2 { 0.25 } else { 0.0 };
        let not_fallen = if height >= 0.7 { 0.5 } else { 0.0 };
        (0.25 * height + tall + not_fallen).clamp(0.0, 1.0)
    }

    /// 1 for no action, less for large ones; in [0, 1].
    pub fn control_reward(&self) -> f64 {
        (1.0 - 0.05 * self.0.squared_control()).clamp(0.0, 1.0)
    }

    /// Half for the place, a quarter for standing, a quarter for small actions. The place's 0.8 are for being near the origin, its
    /// 0.2 fall with the distance from it. In [0, 1].
    pub fn reset_reward(&self) -> f64 {
        let distance = self.position().abs();
        let near = if distance < 0.5 { 0.8 } else { 0.0 };
        let place = near + 0.2 * (1.0 - 0.2 * distance);
        (0.5 * place + 0.25 * self.stand_reward() + 0.25 * self.control_reward()).clamp(0.0, 1.0)
    }

    /// The paper's "reset reward above 0.7" alone would admit a walker that lies at the origin.
    pub fn is_reset(&self) -> bool {
        self.reset_reward() > 0.7 && self.position().abs() < 0.5 && self.stands()
    }
}

/// Adds uniform noise to positions and velocities.
pub fn disturb(noise: &mut Noise<'_>, positions: &mut [f64], velocities: &mut [f64]) {
    positions.iter_mut().chain(velocities).for_each(|value| *value += noise.uniform());
}

/// Positions, then velocities clipped to ±10 as Gymnasium's are.
pub fn observe(simulation: &Simulation) -> impl Iterator<Item = f64> {
    let velocities = simulation.velocities().iter().map(|velocity| velocity.clamp(-10.0, 10.0));
    simulation.positions().iter().copied().chain(velocities)
}
