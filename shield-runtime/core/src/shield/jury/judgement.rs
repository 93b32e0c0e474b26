//! What the rules were told of an action, and what they said.

/// What the rules were told of an action, and what they said.
#[derive(Debug, Clone, Default)]
pub struct Judgement {
    /// The reset ensemble's values of the action; empty if no rule needs them.
    pub values: Vec<f32>,
    /// The reset ensemble's values of the reset agent's own action; empty if no rule needs them.
    pub greedy_values: Vec<f32>,
    /// The forward ensemble's values of the action; empty if no rule needs them.
    pub forward_values: Vec<f32>,
    /// The success critic's estimates for the action; empty if no rule needs them.
    pub probabilities: Vec<f32>,
    /// The same for the reset agent's own action; empty if no rule needs them.
    pub greedy_probabilities: Vec<f32>,
    /// The same where the last reset ended, for the reset agent's action there; empty if no rule needs them.
    pub start_probabilities: Vec<f32>,
    /// What each rule compared, in the order of the experiment; NaN where it was not asked.
    pub scores: Vec<f32>,
}

impl Judgement {
    /// Empty if they were not computed in this state.
    pub(super) fn known_greedy_probabilities(&self) -> &[f32] {
        let are_known = self.greedy_probabilities.first().is_some_and(|probability| !probability.is_nan());
        if are_known { &self.greedy_probabilities } else { &[] }
    }

    pub(super) fn forget(&mut self) {
        for numbers in [
            &mut self.values,
            &mut self.greedy_values,
            &mut self.forward_values,
            &mut self.probabilities,
            &mut self.greedy_probabilities,
            &mut self.start_probabilities,
            &mut self.scores,
        ] {
            numbers.fill(f32::NAN);
        }
    }

    pub(super) fn copy_from(&mut self, other: &Self) {
        self.values.clone_from(&other.values);
        self.greedy_values.clone_from(&other.greedy_values);
        self.forward_values.clone_from(&other.forward_values);
        self.probabilities.clone_from(&other.probabilities);
        self.greedy_probabilities.clone_from(&other.greedy_probabilities);
        self.start_probabilities.clone_from(&other.start_probabilities);
        self.scores.clone_from(&other.scores);
    }
}
