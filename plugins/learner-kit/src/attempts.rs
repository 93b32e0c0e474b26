//! What success critics share: the target of a transition, and the checks of a batch.

use actor_critic::check_unit;
use shield_api::{AttemptBatch, Error, Result, check_finite};

use crate::plugin_error;

/// What an undo probability is to become after a transition.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct UndoTarget {
    /// How much the attempt's outcome counts against the estimate in the next state, in \[0, 1\].
    pub outcome_weight: f32,
    /// γ.
    pub discount: f32,
}

impl UndoTarget {
    /// 1 in the reset set; 0 where nothing follows; else w o + (1 − w) γ P'(s', a'), with the attempt's outcome o and
    /// w = `outcome_weight` × the transition's own weight.
    ///
    /// The outcome is what keeps the estimate honest: where no attempt succeeds and none ends, P = γ P' alone stays at whatever
    /// P began with.
    pub fn of(&self, batch: &AttemptBatch<'_>, row: usize, next_probability: f32) -> f32 {
        let weight = self.outcome_weight * batch.outcome_weights[row];
        let later = weight * batch.outcomes[row] + (1.0 - weight) * self.discount * next_probability;
        let success = batch.successes[row];
        success + (1.0 - success) * batch.continuations[row] * later
    }
}

/// Checks everything of a batch but its actions, which depend on the space.
///
/// # Errors
/// The batch is empty, something has the wrong length or is not finite, or a share, an outcome or a mask lies outside \[0, 1\].
pub fn check_attempts(batch: &AttemptBatch<'_>, observation_len: usize, members: usize) -> Result<()> {
    let size = batch.size;
    if size == 0 {
        return Err(Error::invalid_argument("the batch is empty"));
    }
    check_finite("observations", batch.observations, size * observation_len)?;
    check_finite("next_observations", batch.next_observations, size * observation_len)?;
    for (what, values) in [
        ("successes", batch.successes),
        ("continuations", batch.continuations),
        ("outcomes", batch.outcomes),
        ("outcome_weights", batch.outcome_weights),
    ] {
        check_unit(what, values, size).map_err(plugin_error)?;
    }
    check_unit("masks", batch.masks, size * members).map_err(plugin_error)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The target of a transition with these entries, w = 0.7 and γ = 0.9.
    fn target(success: f32, continuation: f32, (outcome, weight): (f32, f32), next: f32) -> f32 {
        let batch = AttemptBatch {
            size: 1,
            observations: &[0.0],
            actions: &[0.0],
            next_observations: &[0.0],
            next_actions: &[0.0],
            successes: &[success],
            continuations: &[continuation],
            outcomes: &[outcome],
            outcome_weights: &[weight],
            masks: &[1.0],
        };
        check_attempts(&batch, 1, 1).unwrap();
        UndoTarget { outcome_weight: 0.7, discount: 0.9 }.of(&batch, 0, next)
    }

    #[test]
    fn targets_are_those_computed_by_hand() {
        let check =
            |found: f32, expected: f32| assert!((found - expected).abs() < 1e-6, "{found} {expected}");
        check(target(1.0, 0.0, (1.0, 1.0), 0.3), 1.0);
        check(target(1.0, 0.0, (0.0, 0.0), 0.3), 1.0);
        check(target(0.0, 0.0, (0.0, 1.0), 0.3), 0.0);
        check(target(0.0, 0.0, (1.0, 1.0), 0.3), 0.0);
        check(target(0.0, 1.0, (1.0, 1.0), 0.5), 0.7 + 0.3 * 0.9 * 0.5);
        check(target(0.0, 1.0, (0.0, 1.0), 0.5), 0.3 * 0.9 * 0.5);
        check(target(0.0, 1.0, (1.0, 0.5), 0.5), 0.35 + 0.65 * 0.9 * 0.5);
    }

    #[test]
    fn an_outcome_without_weight_counts_for_nothing() {
        assert_eq!(target(0.0, 1.0, (0.0, 0.0), 0.5), target(0.0, 1.0, (1.0, 0.0), 0.5));
        assert_eq!(target(0.0, 1.0, (0.0, 0.0), 0.5), 0.9 * 0.5);
    }
}
