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
        let total = weights.iter().fold(T::ZERO, |sum, weight| sum + *weight);
        let share = if total == T::ZERO { T::ZERO } else { T::ONE / total };
        let mut loss = T::ZERO;
        for (row, gradient) in gradients.iter_mut().enumerate() {
            let weight = weights[row] * share;
            let error = predictions[row] - targets[row];
            let (value, slope) = self.of(error);
            loss += weight * value;
            *gradient = weight * slope;
        }
        loss
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
}
