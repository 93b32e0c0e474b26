//! The configuration, and what it may hold.

use actor_critic::{Error, check_positive, check_share};

shield_api::config! {
    /// Settings of the tables of undo probabilities. "Chosen": see the README.
    pub struct TabularSuccessConfig {
        /// How many tables (Leave no Trace, section 5: 5).
        members: usize = 5,
        /// γ: a success after 100 more steps counts 0.9 (chosen; 1 would be the probability itself).
        discount: f32 = 0.999,
        /// How much the outcome of an attempt counts against the estimate in the next state, from 0 to 1 (chosen).
        outcome_weight: f32 = 0.7,
        /// P everywhere before anything was learned (chosen: trusts what it does not know).
        initial_probability: f32 = 0.88,
        /// The step after n visits is 1/(n + 2), but at least this, so that old outcomes are forgotten (chosen).
        least_step: f32 = 0.005,
    }
}

impl TabularSuccessConfig {
    /// Refuses values that cannot be.
    pub(crate) fn validate(&self) -> Result<(), Error> {
        check_positive("members", self.members as f64)?;
        check_share("discount", self.discount)?;
        check_share("outcome_weight", self.outcome_weight)?;
        check_share("initial_probability", self.initial_probability)?;
        check_share("least_step", self.least_step)
    }
}
