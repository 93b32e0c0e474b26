//! Layer normalisation (Ba et al. 2016) of a hidden layer's sums: y = g (z − mean) / √(variance + ε) + h over the units of each row, with
//! learned g and h.
//!
//! With n = (z − mean) / √(variance + ε) and ∂L/∂n = g ∂L/∂y: ∂L/∂z = (∂L/∂n − mean(∂L/∂n) − n mean(n ∂L/∂n)) / √(variance + ε).

use crate::{Real, kernels::vectorised};

/// As PyTorch's.
const EPSILON: f64 = 1e-5;

/// What the backward pass needs of the forward pass.
#[derive(Debug, Clone, Default)]
pub(crate) struct LayerNorms<T> {
    /// n of all layers, laid out as the activations.
    pub(crate) normal: Vec<T>,
    /// 1 / √(variance + ε) of each row, one layer after the other.
    pub(crate) spreads: Vec<T>,
}

/// Replaces each row z by n, and writes 1 / √(variance + ε) of it.
pub(crate) fn normalise<T: Real>(rows: &mut [T], width: usize, spreads: &mut [T]) {
    let share = T::from_f64(1.0 / width as f64);
    let epsilon = T::from_f64(EPSILON);
    vectorised(
        #[inline(always)]
        || {
            for (row, spread) in rows.chunks_exact_mut(width).zip(spreads) {
                let mean = row.iter().fold(T::ZERO, |sum, z| sum + *z) * share;
                row.iter_mut().for_each(|z| *z -= mean);
                let variance = row.iter().fold(T::ZERO, |sum, z| z.mul_add(*z, sum)) * share;
                *spread = T::ONE / (variance + epsilon).sqrt();
                row.iter_mut().for_each(|z| *z *= *spread);
            }
        },
    );
}

/// Turns ∂L/∂y into ∂L/∂z, and adds to the gradients of g and h where these are wanted.
pub(crate) fn differentiate<T: Real>(
    deltas: &mut [T],
    normal: &[T],
    spreads: &[T],
    gain: &[T],
    mut gradients: Option<[&mut [T]; 2]>,
) {
    let width = gain.len();
    let share = T::from_f64(1.0 / width as f64);
    if let Some([of_gain, of_shift]) = &mut gradients {
        of_gain.fill(T::ZERO);
        of_shift.fill(T::ZERO);
    }
    vectorised(
        #[inline(always)]
        || {
            let rows = deltas.chunks_exact_mut(width).zip(normal.chunks_exact(width)).zip(spreads);
            for ((delta, normal), spread) in rows {
                if let Some([of_gain, of_shift]) = &mut gradients {
                    let sums = of_gain.iter_mut().zip(of_shift.iter_mut());
                    for ((of_gain, of_shift), (delta, normal)) in sums.zip(delta.iter().zip(normal)) {
                        *of_gain = delta.mul_add(*normal, *of_gain);
                        *of_shift += *delta;
                    }
                }
                let (mut mean, mut along) = (T::ZERO, T::ZERO);
                for ((delta, gain), normal) in delta.iter_mut().zip(gain).zip(normal) {
                    *delta *= *gain;
                    mean += *delta;
                    along = delta.mul_add(*normal, along);
                }
                let (mean, along) = (mean * share, along * share);
                for (delta, normal) in delta.iter_mut().zip(normal) {
                    *delta = (*delta - mean - *normal * along) * *spread;
                }
            }
        },
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_normalised_row_has_mean_zero_and_variance_one() {
        let mut rows = [1.0_f64, 2.0, 6.0, -3.0, 5.0, 5.0, 5.0, 5.0];
        let mut spreads = [9.0; 2];
        normalise(&mut rows, 4, &mut spreads);
        let mean = rows[..4].iter().sum::<f64>() / 4.0;
        let variance = rows[..4].iter().map(|x| x * x).sum::<f64>() / 4.0;
        assert!(mean.abs() < 1e-12 && (variance - 1.0).abs() < 1e-5, "{mean} {variance}");
        assert_eq!(rows[4..], [0.0; 4], "a row of equal values");
        assert!((spreads[1] - 1.0 / EPSILON.sqrt()).abs() < 1e-9);
    }

    #[test]
    fn a_row_with_nan_becomes_nan() {
        let mut rows = [1.0_f32, f32::NAN];
        normalise(&mut rows, 2, &mut [0.0]);
        assert!(rows.iter().all(|value| value.is_nan()));
    }
}
