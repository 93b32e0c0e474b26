//! The loss between predicted and target values.

use serde::{Deserialize, Serialize};

use crate::Real;

/// Per-row loss of the error e = prediction − target.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Loss {
    /// e²/2.
    Squared,
    /// e²/2 for |e| ≤ 1, |e| − 1/2 beyond.
    Huber,
}

impl Loss {
    /// The mean loss of the rows, weighted by `weights`, and its gradient with respect to the predictions. Where all
    /// weights are 0, both are 0.
    pub fn evaluate<T: Real>(
        self,
        predictions: &[T],
        targets: &[T],
        weights: &[T],
        gradients: &mut [T],
    ) -> T {
        weighted_mean(weights, gradients, |row| self.of(predictions[row] - targets[row]))
    }

    /// Loss and derivative of one error.
    fn of<T: Real>(self, error: T) -> (T, T) {
        let half = T::from_f64(0.5);
        let size = if error < T::ZERO { -error } else { error };
        if self == Self::Huber && size > T::ONE {
            (size - half, if error < T::ZERO { -T::ONE } else { T::ONE })
        } else {
            (half * error * error, error)
        }
    }
}

/// The mean binary cross-entropy between σ(logit) and targets in \[0, 1\], weighted as [`Loss::evaluate`] does, and its gradient with
/// respect to the logits, which is σ(logit) − target. Computed from the logits, so that it is finite for every finite one.
pub fn cross_entropy(logits: &[f32], targets: &[f32], weights: &[f32], gradients: &mut [f32]) -> f32 {
    weighted_mean(weights, gradients, |row| {
        let (logit, target) = (logits[row], targets[row]);
        // −t ln σ(z) − (1 − t) ln σ(−z) = max(z, 0) − t z + ln(1 + exp(−|z|)); `if` rather than `max`, which would hide NaN.
        let positive = if logit < 0.0 { 0.0 } else { logit };
        let value = positive - target * logit + (-logit.abs()).exp().ln_1p();
        (value, sigmoid(logit) - target)
    })
}

/// σ(x) = 1/(1 + exp(−x)), in \[0, 1\]; NaN stays NaN.
pub fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}

/// The mean of the rows' losses, weighted by `weights`; writes its gradient. `of` gives a row's loss and slope. Where all weights are 0,
/// both are 0.
fn weighted_mean<T: Real>(weights: &[T], gradients: &mut [T], of: impl Fn(usize) -> (T, T)) -> T {
    let total = weights.iter().fold(T::ZERO, |sum, weight| sum + *weight);
    let share = if total == T::ZERO { T::ZERO } else { T::ONE / total };
    let mut loss = T::ZERO;
    for (row, gradient) in gradients.iter_mut().enumerate() {
        let weight = weights[row] * share;
        let (value, slope) = of(row);
        loss += weight * value;
        *gradient = weight * slope;
    }
    loss
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_loss_is_the_mean_over_weighted_transitions() {
        let mut gradients = [9.0; 3];
        let (predictions, targets) = ([1.5, 3.0, 0.0], [1.0, 0.0, 7.0]);
        let loss = Loss::Squared.evaluate(&predictions, &targets, &[1.0, 1.0, 0.0], &mut gradients);
        assert_eq!((loss, gradients), ((0.125 + 4.5) / 2.0, [0.25, 1.5, 0.0]));
        let loss = Loss::Huber.evaluate(&predictions, &targets, &[1.0, 1.0, 0.0], &mut gradients);
        assert_eq!((loss, gradients), ((0.125 + 2.5) / 2.0, [0.25, 0.5, 0.0]));
    }

    #[test]
    fn the_loss_without_any_weight_is_zero() {
        let mut gradients = [9.0; 2];
        assert_eq!(Loss::Huber.evaluate(&[1.0, 2.0], &[0.0, 0.0], &[0.0, 0.0], &mut gradients), 0.0);
        assert_eq!(gradients, [0.0, 0.0]);
    }

    #[test]
    fn the_cross_entropy_is_that_of_the_textbook() {
        let (logits, targets) = ([0.5_f32, -2.0, 3.0], [0.2_f32, 0.9, 1.0]);
        let mut gradients = [9.0; 3];
        let loss = cross_entropy(&logits, &targets, &[1.0, 1.0, 0.0], &mut gradients);
        let of = |row: usize| {
            let (p, t) = (1.0 / (1.0 + f64::from(-logits[row]).exp()), f64::from(targets[row]));
            (-t * p.ln() - (1.0 - t) * (1.0 - p).ln(), p - t)
        };
        assert!((f64::from(loss) - (of(0).0 + of(1).0) / 2.0).abs() < 1e-6);
        for (row, gradient) in gradients[..2].iter().enumerate() {
            assert!((f64::from(*gradient) - of(row).1 / 2.0).abs() < 1e-6);
        }
        assert_eq!(gradients[2], 0.0);
    }

    #[test]
    fn the_cross_entropy_of_certain_logits_is_finite_and_keeps_nan() {
        let mut gradient = [9.0];
        assert_eq!(cross_entropy(&[200.0], &[0.0], &[1.0], &mut gradient), 200.0);
        assert_eq!(gradient, [1.0]);
        assert_eq!(cross_entropy(&[-200.0], &[0.0], &[1.0], &mut gradient), 0.0);
        assert_eq!((sigmoid(f32::MAX), sigmoid(f32::MIN)), (1.0, 0.0));
        for logit in [f32::NAN, f32::INFINITY] {
            assert!(!cross_entropy(&[logit], &[0.0], &[0.0], &mut gradient).is_finite(), "masked or not");
        }
    }
}
