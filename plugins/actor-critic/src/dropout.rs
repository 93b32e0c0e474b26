//! Dropout (Srivastava et al. 2014): in an update, each hidden unit's sum is 0 with probability p, else 1/(1 − p) times as large.

use rand::Rng;
use rand_pcg::Pcg64;

use crate::{Real, kernels::vectorised};

/// What is dropped, and by which generator.
#[derive(Debug, Clone, Default)]
pub(crate) struct Dropout<T> {
    /// Of the group of networks in work; `None` outside an update, where nothing is dropped.
    generator: Option<Pcg64>,
    /// The factors of all layers, laid out as the activations.
    pub(crate) factors: Vec<T>,
}

/// One in so many units can be dropped.
const STEPS: f64 = 65536.0;

impl<T: Real> Dropout<T> {
    /// Begins a group's part in an update, if a seed is given: with a stream of its own, whichever thread works on it.
    pub(crate) fn begin(&mut self, seed: Option<u64>, group: usize) {
        self.generator = seed.map(|seed| Pcg64::new(u128::from(seed), group as u128));
    }

    /// Whether units are dropped.
    pub(crate) fn is_on(&self) -> bool {
        self.generator.is_some()
    }

    /// Draws the factors at `range`, and multiplies the values by them. Four units take one number of 64 bits; the probability is rounded to
    /// 2⁻¹⁶.
    pub(crate) fn apply(&mut self, probability: f32, values: &mut [T], range: std::ops::Range<usize>) {
        let Some(generator) = &mut self.generator else { return };
        let threshold = (f64::from(probability) * STEPS).round();
        let kept = T::from_f64(STEPS / (STEPS - threshold));
        let threshold = threshold as u64;
        let factors = &mut self.factors[range];
        for four in factors.chunks_mut(4) {
            let mut bits = generator.next_u64();
            for factor in four {
                *factor = if bits & 0xffff < threshold { T::ZERO } else { kept };
                bits >>= 16;
            }
        }
        multiply(values, factors);
    }
}

/// `values *= factors`.
pub(crate) fn multiply<T: Real>(values: &mut [T], factors: &[T]) {
    vectorised(
        #[inline(always)]
        || values.iter_mut().zip(factors).for_each(|(value, factor)| *value *= *factor),
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_dropped_share_and_the_mean_are_those_of_the_definition() {
        let mut dropout = Dropout { generator: None, factors: vec![0.0_f32; 40_000] };
        let mut values = vec![1.0; 40_000];
        dropout.apply(0.2, &mut values, 0..40_000);
        assert_eq!(values, vec![1.0; 40_000], "outside an update");
        dropout.begin(Some(7), 3);
        dropout.apply(0.2, &mut values, 0..40_000);
        let dropped = values.iter().filter(|value| **value == 0.0).count() as f64 / 40_000.0;
        let mean = values.iter().sum::<f32>() / 40_000.0;
        assert!((dropped - 0.2).abs() < 0.01, "{dropped}");
        assert!((mean - 1.0).abs() < 0.015, "{mean}");
        let mut others = vec![1.0; 40_000];
        dropout.begin(Some(7), 4);
        dropout.apply(0.2, &mut others, 0..40_000);
        assert_ne!(values, others, "groups drop other units");
    }
}
