//! Adam (Kingma and Ba 2015, algorithm 1) with the soft update of the target weights in the same pass over memory.

use std::ops::Range;

use serde::{Deserialize, Serialize};

use crate::{Real, kernels::vectorised};

/// A moment below this is 0, and changes no weight by what a weight can hold. Of a unit that is never active any more the moments would decay into
/// the subnormal numbers and stay there, since rounding keeps the smallest of them; each one then costs a hundred times as much as another.
const NEGLIGIBLE: f64 = 1e-36;

/// Constants of the optimiser.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Adam {
    /// Step size α.
    pub rate: f64,
    /// β₁, decay of the first moment.
    pub beta1: f64,
    /// β₂, decay of the second moment.
    pub beta2: f64,
    /// ε, added to the root of the second moment.
    pub epsilon: f64,
    /// Share of the matrices, times the step size, that each step takes from them (AdamW, Loshchilov and Hutter 2019); biases and
    /// normalisations keep their size.
    pub weight_decay: f64,
}

impl Adam {
    /// The constants of the paper, with the given step size.
    pub fn new(rate: f64) -> Self {
        Self { rate, beta1: 0.9, beta2: 0.999, epsilon: 1e-8, weight_decay: 0.0 }
    }

    /// The same with this decay of the weights.
    #[must_use]
    pub fn with_decay(self, weight_decay: f64) -> Self {
        Self { weight_decay, ..self }
    }

    /// One step, the `step`-th counted from 1; then target ← target + τ (weight − target).
    pub(crate) fn apply<T: Real>(&self, slices: Slices<'_, T>, gradients: &[T], step: u64, tau: f64) {
        let step = i32::try_from(step).unwrap_or(i32::MAX);
        let (beta1, beta2) = (T::from_f64(self.beta1), T::from_f64(self.beta2));
        let (rest1, rest2) = (T::from_f64(1.0 - self.beta1), T::from_f64(1.0 - self.beta2));
        let rate = T::from_f64(self.rate / (1.0 - self.beta1.powi(step)));
        let root = T::from_f64(1.0 / (1.0 - self.beta2.powi(step)).sqrt());
        let (epsilon, tau) = (T::from_f64(self.epsilon), T::from_f64(tau));
        let negligible = T::from_f64(NEGLIGIBLE);
        let Slices { weights, targets, first, second } = slices;
        vectorised(
            #[inline(always)]
            || {
                let moments = first.iter_mut().zip(second);
                let state = weights.iter_mut().zip(targets).zip(moments);
                for (((weight, target), (first, second)), gradient) in state.zip(gradients) {
                    let gradient = *gradient;
                    *first = or_zero(first.mul_add(beta1, rest1 * gradient), negligible);
                    *second = or_zero(second.mul_add(beta2, rest2 * gradient * gradient), negligible);
                    *weight -= rate * *first / second.sqrt().mul_add(root, epsilon);
                    *target = (*weight - *target).mul_add(tau, *target);
                }
            },
        );
    }
}

/// The value, or 0 where it is smaller than `least`. NaN stays NaN.
#[inline(always)]
fn or_zero<T: Real>(value: T, least: T) -> T {
    if value < least && -least < value { T::ZERO } else { value }
}

/// What one step changes.
pub(crate) struct Slices<'a, T> {
    pub(crate) weights: &'a mut [T],
    pub(crate) targets: &'a mut [T],
    pub(crate) first: &'a mut [T],
    pub(crate) second: &'a mut [T],
}

impl<T> Slices<'_, T> {
    /// The given part of each, for as long as the whole is not needed.
    pub(crate) fn part(&mut self, range: Range<usize>) -> Slices<'_, T> {
        let Slices { weights, targets, first, second } = self;
        Slices { weights, targets, first, second }.into_part(range)
    }

    /// The given part of each.
    pub(crate) fn into_part(self, range: Range<usize>) -> Self {
        Self {
            weights: &mut self.weights[range.clone()],
            targets: &mut self.targets[range.clone()],
            first: &mut self.first[range.clone()],
            second: &mut self.second[range],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_matches_the_textbook() {
        let adam = Adam::new(0.01);
        let gradients = [[0.5, -2.0, 1e-4], [-0.1, 3.0, 0.0], [0.7, 0.2, -1e-3]];
        let mut weights = [1.0, -1.0, 0.0];
        let mut targets = weights;
        let (mut first, mut second) = ([0.0; 3], [0.0; 3]);
        let (mut w, mut t, mut m, mut v) = (weights, targets, [0.0_f64; 3], [0.0_f64; 3]);
        for (index, gradient) in gradients.iter().enumerate() {
            let step = index as i32 + 1;
            let slices = Slices {
                weights: &mut weights,
                targets: &mut targets,
                first: &mut first,
                second: &mut second,
            };
            adam.apply(slices, gradient, step as u64, 0.1);
            for i in 0..3 {
                m[i] = 0.9 * m[i] + 0.1 * gradient[i];
                v[i] = 0.999 * v[i] + 0.001 * gradient[i].powi(2);
                let m_hat = m[i] / (1.0 - 0.9_f64.powi(step));
                let v_hat = v[i] / (1.0 - 0.999_f64.powi(step));
                w[i] -= 0.01 * m_hat / (v_hat.sqrt() + 1e-8);
                t[i] = 0.9 * t[i] + 0.1 * w[i];
                assert!((weights[i] - w[i]).abs() < 1e-12, "weight {i} after {step}");
                assert!((targets[i] - t[i]).abs() < 1e-12, "target {i} after {step}");
            }
        }
    }

    #[test]
    fn moments_are_never_subnormal_and_keep_nan() {
        let adam = Adam::new(0.01);
        let (mut weights, mut targets, mut first, mut second) = ([1.0_f32], [1.0], [1e-3], [1e-30]);
        for step in 1..20_000 {
            let (weights, targets) = (&mut weights, &mut targets);
            let slices = Slices { weights, targets, first: &mut first, second: &mut second };
            adam.apply(slices, &[0.0], step, 0.1);
            assert!(
                !first[0].is_subnormal() && !second[0].is_subnormal(),
                "step {step}: {first:?} {second:?}"
            );
        }
        assert_eq!((first, second), ([0.0], [0.0]));
        let slices =
            Slices { weights: &mut weights, targets: &mut targets, first: &mut first, second: &mut second };
        adam.apply(slices, &[f32::NAN], 20_000, 0.1);
        assert!(first[0].is_nan() && second[0].is_nan());
    }
}
