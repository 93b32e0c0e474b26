//! Batch renormalisation (Ioffe 2017) of a layer's input, as CrossQ uses it: y = g (r (x − μ)/σ + d) + h per feature, with learned g and h.
//!
//! In an update μ and σ = √(variance + ε) are those of the batch; r = σ/σ̄ and d = (μ − μ̄)/σ̄ lead to the running statistics, are cut to
//! [1/3, 3] and [−5, 5], and count as constants. Before the warm-up is over they are 1 and 0. Elsewhere μ̄ and σ̄ are used, r = 1 and d = 0.
//! With n = (x − μ)/σ: ∂L/∂x = g r/σ (∂L/∂y − mean(∂L/∂y) − n mean(n ∂L/∂y)), where the means are over the batch.
//!
//! CrossQ's code and SBX's subtract d σ with ε left out of σ, which changes y by less than 1e-3 of d where the variance is 1.

use crate::{Real, kernels::vectorised};

/// As Flax's, which CrossQ has.
const EPSILON: f64 = 1e-3;
/// r lies between 1/3 and 3, d between −5 and 5 (CrossQ).
const LONGEST: [f64; 2] = [3.0, 5.0];

/// Constants of batch renormalisation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BatchRenorm {
    /// Share of the running statistics that is kept per update.
    pub momentum: f64,
    /// Updates before r and d are applied.
    pub warm_up: u64,
}

/// Which statistics a pass uses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) enum Statistics {
    /// The running ones.
    #[default]
    Running,
    /// The batch's, in an update.
    Batch {
        /// Whether r and d are applied.
        is_warm: bool,
    },
}

/// g, h, and the running mean and variance of some features.
pub(crate) struct Features<'a, T> {
    pub(crate) gain: &'a [T],
    pub(crate) shift: &'a [T],
    pub(crate) mean: &'a [T],
    pub(crate) variance: &'a [T],
}

impl Features<'_, f32> {
    /// Factor and summand of each feature where the running statistics are used.
    pub(crate) fn affine(&self) -> [Vec<f32>; 2] {
        let factor = |index: usize| self.gain[index] / (self.variance[index] + EPSILON as f32).sqrt();
        let summand = |index: usize| self.shift[index] - self.mean[index] * factor(index);
        [(0..self.gain.len()).map(factor).collect(), (0..self.gain.len()).map(summand).collect()]
    }
}

/// What a pass leaves of some features: rows × features, or one value per feature.
#[derive(Debug, Clone, Default)]
pub(crate) struct Renormed<T> {
    /// y.
    pub(crate) outputs: Vec<T>,
    /// n.
    normal: Vec<T>,
    means: Vec<T>,
    variances: Vec<T>,
    /// 1/σ, r, d.
    slopes: Vec<T>,
    scales: Vec<T>,
    offsets: Vec<T>,
    /// Sums over the batch, in the backward pass.
    sums: Vec<T>,
    sums_along: Vec<T>,
    statistics: Statistics,
}

impl<T: Real> Renormed<T> {
    /// Makes room for so many features and rows.
    pub(crate) fn resize(&mut self, rows: usize, features: usize) {
        for buffer in [&mut self.outputs, &mut self.normal] {
            buffer.resize(buffer.len().max(rows * features), T::ZERO);
        }
        for buffer in [
            &mut self.means,
            &mut self.variances,
            &mut self.slopes,
            &mut self.scales,
            &mut self.offsets,
            &mut self.sums,
            &mut self.sums_along,
        ] {
            buffer.resize(features, T::ZERO);
        }
    }

    /// Renormalises `inputs` into the outputs.
    pub(crate) fn forward(&mut self, inputs: &[T], features: &Features<'_, T>, statistics: Statistics) {
        let width = features.gain.len();
        self.resize(inputs.len() / width, width);
        self.statistics = statistics;
        if statistics == Statistics::Running {
            self.means.copy_from_slice(features.mean);
            self.variances.copy_from_slice(features.variance);
        } else {
            moments(inputs, &mut self.means, &mut self.variances);
        }
        let epsilon = T::from_f64(EPSILON);
        for index in 0..width {
            let deviation = (self.variances[index] + epsilon).sqrt();
            self.slopes[index] = T::ONE / deviation;
            let running = (features.variance[index] + epsilon).sqrt();
            (self.scales[index], self.offsets[index]) = match statistics {
                Statistics::Batch { is_warm: true } => (
                    cut(deviation / running, 1.0 / LONGEST[0], LONGEST[0]),
                    cut((self.means[index] - features.mean[index]) / running, -LONGEST[1], LONGEST[1]),
                ),
                _ => (T::ONE, T::ZERO),
            };
        }
        let Self { outputs, normal, means, slopes, scales, offsets, .. } = self;
        vectorised(
            #[inline(always)]
            || {
                let rows = inputs.chunks_exact(width).zip(outputs.chunks_exact_mut(width));
                for ((row, outputs), normal) in rows.zip(normal.chunks_exact_mut(width)) {
                    for index in 0..width {
                        let n = (row[index] - means[index]) * slopes[index];
                        normal[index] = n;
                        let renormed = n.mul_add(scales[index], offsets[index]);
                        outputs[index] = renormed.mul_add(features.gain[index], features.shift[index]);
                    }
                }
            },
        );
    }

    /// Turns ∂L/∂y into ∂L/∂x, and writes the gradients of g and h where these are wanted.
    pub(crate) fn backward(&mut self, deltas: &mut [T], gain: &[T], gradients: Option<[&mut [T]; 2]>) {
        let width = gain.len();
        let share = T::from_f64(width as f64 / deltas.len() as f64);
        let Self { normal, slopes, scales, offsets, sums, sums_along, statistics, .. } = self;
        sums.fill(T::ZERO);
        sums_along.fill(T::ZERO);
        vectorised(
            #[inline(always)]
            || {
                for (delta, normal) in deltas.chunks_exact(width).zip(normal.chunks_exact(width)) {
                    for index in 0..width {
                        sums[index] += delta[index];
                        sums_along[index] = delta[index].mul_add(normal[index], sums_along[index]);
                    }
                }
            },
        );
        if let Some([of_gain, of_shift]) = gradients {
            of_shift.copy_from_slice(sums);
            for index in 0..width {
                of_gain[index] = scales[index] * sums_along[index] + offsets[index] * sums[index];
            }
        }
        // With running statistics, a row's output depends on that row alone.
        let share = if *statistics == Statistics::Running { T::ZERO } else { share };
        vectorised(
            #[inline(always)]
            || {
                for (delta, normal) in deltas.chunks_exact_mut(width).zip(normal.chunks_exact(width)) {
                    for index in 0..width {
                        let own = delta[index] - share * (sums[index] + normal[index] * sums_along[index]);
                        delta[index] = own * gain[index] * scales[index] * slopes[index];
                    }
                }
            },
        );
    }

    /// Moves the running statistics towards those of the batch.
    pub(crate) fn move_statistics(&self, momentum: f64, mean: &mut [T], variance: &mut [T]) {
        let rest = T::from_f64(1.0 - momentum);
        for (running, own) in [(mean, &self.means), (variance, &self.variances)] {
            running.iter_mut().zip(own).for_each(|(running, own)| *running += rest * (*own - *running));
        }
    }
}

/// Mean and variance of each column.
fn moments<T: Real>(rows: &[T], means: &mut [T], variances: &mut [T]) {
    let width = means.len();
    let share = T::from_f64(width as f64 / rows.len() as f64);
    means.fill(T::ZERO);
    variances.fill(T::ZERO);
    vectorised(
        #[inline(always)]
        || {
            for row in rows.chunks_exact(width) {
                means.iter_mut().zip(row).for_each(|(mean, x)| *mean += *x);
            }
            means.iter_mut().for_each(|mean| *mean *= share);
            for row in rows.chunks_exact(width) {
                for ((variance, mean), x) in variances.iter_mut().zip(means.iter()).zip(row) {
                    let distance = *x - *mean;
                    *variance = distance.mul_add(distance, *variance);
                }
            }
            variances.iter_mut().for_each(|variance| *variance *= share);
        },
    );
}

/// The value, or the nearer bound. NaN stays NaN.
fn cut<T: Real>(value: T, least: f64, largest: f64) -> T {
    let (least, largest) = (T::from_f64(least), T::from_f64(largest));
    if value < least {
        least
    } else if value > largest {
        largest
    } else {
        value
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FEATURES: Features<'static, f64> =
        Features { gain: &[1.0, 2.0], shift: &[0.0, 0.5], mean: &[1.0, -40.0], variance: &[4.0, 1e-6] };
    const ROWS: [f64; 8] = [1.0, 2.0, 3.0, -1.0, 0.5, 4.0, -2.0, 0.0];

    #[test]
    fn a_batch_is_brought_to_mean_zero_and_variance_one_until_it_is_warm() {
        let mut renormed = Renormed::default();
        renormed.forward(&ROWS, &FEATURES, Statistics::Batch { is_warm: false });
        let column = |index| renormed.outputs.iter().skip(index).step_by(2).copied();
        let mean = column(1).sum::<f64>() / 4.0;
        assert!((mean - 0.5).abs() < 1e-12, "{mean}");
        let variance = column(0).map(|y| y * y).sum::<f64>() / 4.0;
        assert!((variance - 1.0).abs() < 1e-3, "{variance}");
    }

    #[test]
    fn a_warm_batch_is_normalised_by_the_running_statistics_within_the_bounds() {
        let (mut warm, mut running) = (Renormed::default(), Renormed::default());
        warm.forward(&ROWS, &FEATURES, Statistics::Batch { is_warm: true });
        running.forward(&ROWS, &FEATURES, Statistics::Running);
        for row in 0..4 {
            assert!((warm.outputs[2 * row] - running.outputs[2 * row]).abs() < 1e-12, "within the bounds");
        }
        // Both bounds are passed in the second feature.
        assert_eq!((warm.scales[1], warm.offsets[1]), (3.0, 5.0));
    }

    #[test]
    fn running_statistics_move_by_their_share() {
        let mut renormed = Renormed::default();
        renormed.forward(&ROWS, &FEATURES, Statistics::Batch { is_warm: false });
        let (mut mean, mut variance) = ([1.0, -40.0], [4.0, 1e-6]);
        renormed.move_statistics(0.99, &mut mean, &mut variance);
        assert!((mean[0] - (0.99 + 0.01 * 0.625)).abs() < 1e-12);
        assert!((mean[1] - (-39.6 + 0.01 * 1.25)).abs() < 1e-12);
        assert!((variance[0] - (3.96 + 0.01 * 3.171_875)).abs() < 1e-12, "{variance:?}");
    }
}
