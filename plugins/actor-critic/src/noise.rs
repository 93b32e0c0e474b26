//! Exploration noise whose size changes linearly with time.

use rand::{Rng, RngExt};
use rand_distr::StandardNormal;
use serde::{Deserialize, Serialize};

/// A quantity that moves linearly from `start` to `end` within `steps`, and stays there.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Schedule {
    /// Value at step 0.
    pub start: f32,
    /// Value from step `steps` on.
    pub end: f32,
    /// How long the way is. 0: `end` from the beginning.
    pub steps: u64,
}

impl Schedule {
    /// The value at a step.
    pub fn at(&self, step: u64) -> f32 {
        if step >= self.steps {
            return self.end;
        }
        let share = step as f64 / self.steps as f64;
        (f64::from(self.start) + share * f64::from(self.end - self.start)) as f32
    }
}

/// How successive disturbances hang together.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum NoiseProcess {
    /// Independent: σ N(0, 1).
    Gaussian,
    /// x ← x − θ x + σ N(0, 1) (Lillicrap et al. 2015: θ = 0.15, σ = 0.2). It runs on across episodes.
    OrnsteinUhlenbeck {
        /// Share of the way back to 0 per step, in [0, 1].
        theta: f32,
    },
}

/// A source of exploration noise.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Noise {
    process: NoiseProcess,
    sigma: Schedule,
    step: u64,
    state: Vec<f32>,
}

impl Noise {
    /// Noise for actions with `dimensions` values.
    pub fn new(process: NoiseProcess, sigma: Schedule, dimensions: usize) -> Self {
        Self { process, sigma, step: 0, state: vec![0.0; dimensions] }
    }

    /// How many dimensions it disturbs.
    pub fn dimensions(&self) -> usize {
        self.state.len()
    }

    /// How many steps it has taken.
    pub fn step(&self) -> u64 {
        self.step
    }

    /// Lets a step pass without a disturbance: the schedule goes on.
    pub fn skip(&mut self) {
        self.step += 1;
    }

    /// Disturbs an action.
    pub fn disturb(&mut self, action: &mut [f32], rng: &mut impl Rng) {
        let sigma = self.sigma.at(self.step);
        self.step += 1;
        for (value, state) in action.iter_mut().zip(&mut self.state) {
            let draw: f32 = rng.sample(StandardNormal);
            *state = match self.process {
                NoiseProcess::Gaussian => sigma * draw,
                NoiseProcess::OrnsteinUhlenbeck { theta } => *state - theta * *state + sigma * draw,
            };
            *value += *state;
        }
    }

    /// Takes over step and state of `other`, not its settings.
    pub fn continue_from(&mut self, other: Self) {
        self.step = other.step;
        self.state = other.state;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_pcg::Pcg64;

    fn sample(process: NoiseProcess, steps: usize) -> Vec<f32> {
        let sigma = Schedule { start: 0.2, end: 0.2, steps: 0 };
        let mut noise = Noise::new(process, sigma, 1);
        let mut rng = Pcg64::seed_from_u64(3);
        (0..steps)
            .map(|_| {
                let mut action = [0.0];
                noise.disturb(&mut action, &mut rng);
                action[0]
            })
            .collect()
    }

    fn deviation(values: &[f32]) -> f64 {
        (values.iter().map(|x| f64::from(*x).powi(2)).sum::<f64>() / values.len() as f64).sqrt()
    }

    #[test]
    fn a_schedule_changes_linearly_and_then_stays() {
        let schedule = Schedule { start: 1.0, end: 0.0, steps: 4 };
        let values: Vec<f32> = (0..6).map(|step| schedule.at(step)).collect();
        assert_eq!(values, [1.0, 0.75, 0.5, 0.25, 0.0, 0.0]);
        assert_eq!(Schedule { start: 1.0, end: 0.3, steps: 0 }.at(0), 0.3);
    }

    #[test]
    fn noise_has_the_spread_of_its_process() {
        assert!((deviation(&sample(NoiseProcess::Gaussian, 50_000)) - 0.2).abs() < 0.005);
        // Stationary deviation of x ← (1 − θ) x + σ N: σ / √(1 − (1 − θ)²).
        let expected = 0.2 / (1.0_f64 - 0.85 * 0.85).sqrt();
        let measured = deviation(&sample(NoiseProcess::OrnsteinUhlenbeck { theta: 0.15 }, 50_000));
        assert!((measured - expected).abs() < 0.02, "{measured} {expected}");
    }
}
