//! What one critic, or one group of them, needs and returns in an update.

use crate::{Buffers, Error, Group, Loss, Member, SmallestGradients, smaller};

/// The part that every kind of critic has in common. Kept between updates, so that nothing is allocated after the first.
#[derive(Debug, Clone, Default)]
pub struct CriticStep {
    /// Values to learn, one per row.
    pub targets: Vec<f32>,
    /// The member's column of the bootstrap masks.
    pub weights: Vec<f32>,
    /// The mean loss before the step.
    pub loss: f32,
    /// The mean value of the batch before the step.
    pub mean_value: f32,
}

impl CriticStep {
    /// Makes room for `size` rows, and takes the column of `member` from the masks (`size × members`).
    pub fn begin(&mut self, size: usize, masks: &[f32], member: usize, members: usize) {
        self.targets.resize(size, 0.0);
        self.weights.clear();
        self.weights.extend(masks.iter().skip(member).step_by(members).take(size));
    }

    /// Whether every loss is finite.
    ///
    /// # Errors
    /// [`Error::LossNotFinite`] for the first that is not.
    pub fn check<'a>(steps: impl IntoIterator<Item = &'a Self>) -> Result<(), Error> {
        match steps.into_iter().enumerate().find(|(_, step)| !step.loss.is_finite()) {
            None => Ok(()),
            Some((critic, step)) => Err(Error::LossNotFinite { critic, loss: step.loss }),
        }
    }

    /// Mean loss and mean value over the critics.
    pub fn means<'a>(steps: impl ExactSizeIterator<Item = &'a Self>) -> (f64, f64) {
        let count = steps.len() as f64;
        let (loss, value) = steps.fold((0.0, 0.0), |(loss, value), step| {
            (loss + f64::from(step.loss), value + f64::from(step.mean_value))
        });
        (loss / count, value / count)
    }
}

impl Member<'_, f32> {
    /// Forms the gradient of the mean loss between a critic's values of the batch and `targets`, where each row counts with its weight.
    /// Returns that loss and the mean value.
    pub fn fit(&mut self, batch: &Buffers, targets: &[f32], weights: &[f32], loss: Loss) -> (f32, f32) {
        self.observe(&batch.observations);
        let mean_value = self.values(&batch.actions).iter().sum::<f32>() / targets.len() as f32;
        let (values, gradients) = self.outputs();
        let loss = loss.evaluate(values, targets, weights, gradients);
        self.backward(&batch.observations, &batch.actions);
        (loss, mean_value)
    }

    /// Writes ∂Q/∂a of a critic at the batch's π(s). To be called after [`fit`](Self::fit), with which it shares what only the observations
    /// decide, and before the critic's step.
    pub fn policy_gradients(&mut self, batch: &Buffers, gradients: &mut Vec<f32>) {
        self.values(&batch.policy_actions);
        gradients.resize(batch.policy_actions.len(), 0.0);
        self.action_gradients(gradients);
    }

    /// Keeps ∂Q/∂a of a critic at the policy's actions in the rows where its value is the smallest so far. To be called as
    /// [`policy_gradients`](Self::policy_gradients).
    pub fn smallest_policy_gradients(&mut self, batch: &Buffers, kept: &mut SmallestGradients) {
        let SmallestGradients { gradients, values, own, is_smallest } = kept;
        is_smallest.clear();
        for (value, smallest) in self.values(&batch.policy_actions).iter().zip(values) {
            is_smallest.push(*value < *smallest || value.is_nan());
            *smallest = smaller(*smallest, *value);
        }
        own.resize(gradients.len(), 0.0);
        self.action_gradients(own);
        let width = gradients.len() / is_smallest.len();
        let rows = gradients.chunks_exact_mut(width).zip(own.chunks_exact(width));
        for ((gradients, own), _) in rows.zip(is_smallest).filter(|(_, is_smallest)| **is_smallest) {
            gradients.copy_from_slice(own);
        }
    }
}

impl SmallestGradients {
    /// Forgets what was kept; makes room for the gradients of so many rows.
    pub fn begin(&mut self, rows: usize, action_len: usize) {
        self.values.clear();
        self.values.resize(rows, f32::INFINITY);
        self.gradients.clear();
        self.gradients.resize(rows * action_len, 0.0);
    }
}

impl Group<'_, f32> {
    /// Writes the smallest of the target networks' values, row by row.
    pub fn smallest_target_values(&mut self, observations: &[f32], actions: &[f32], smallest: &mut [f32]) {
        smallest.fill(f32::INFINITY);
        for network in 0..self.size() {
            let mut critic = self.member(network);
            for (smallest, value) in smallest.iter_mut().zip(critic.target_values(observations, actions)) {
                *smallest = smaller(*smallest, *value);
            }
        }
    }
}
