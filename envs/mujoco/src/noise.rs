//! The noise of initial states.

use rand::RngExt;
use rand_distr::StandardNormal;
use rand_pcg::Pcg64;

/// A source of noise of the configured size.
pub struct Noise<'a> {
    size: f64,
    rng: &'a mut Pcg64,
}

impl<'a> Noise<'a> {
    /// Noise of this size, 0 or more.
    pub fn new(size: f64, rng: &'a mut Pcg64) -> Self {
        Self { size, rng }
    }

    /// A uniform draw from ± the size.
    pub fn uniform(&mut self) -> f64 {
        self.rng.random_range(-self.size..=self.size)
    }

    /// A normal draw; its deviation is the size.
    pub fn normal(&mut self) -> f64 {
        let standard: f64 = self.rng.sample(StandardNormal);
        self.size * standard
    }
}
