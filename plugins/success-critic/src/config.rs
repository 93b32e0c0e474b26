//! The configuration, and what it may hold.

use actor_critic::{Error, check_layers, check_positive, check_share};

shield_api::config! {
    /// Settings of the success critic. "Chosen": see the README.
    pub struct SuccessCriticConfig {
        /// How many critics (chosen; Lakshminarayanan et al. 2017: 5).
        members: usize = 5,
        /// Hidden layers of a critic (chosen).
        hidden: Vec<usize> = vec![64, 64] => "[64, 64]",
        /// Adam's step size (as the critics' of DDPG, Lillicrap et al. 2015).
        learning_rate: f64 = 1e-3,
        /// γ: a success in 100 steps counts 0.9 (chosen; 1 would be the probability itself).
        discount: f32 = 0.999,
        /// How much the outcome of an attempt counts against the estimate in the next state, from 0 to 1 (chosen).
        outcome_weight: f32 = 0.7,
        /// Share by which target networks follow per update (TD3, Fujimoto et al. 2018).
        tau: f64 = 0.005,
        /// P everywhere before anything was learned, above 0 and below 1 (chosen: trusts what it does not know).
        initial_probability: f64 = 0.88,
        /// Scales observations by the running mean and variance of the batches (as the learners do); those of a choice stay as they are.
        normalise_observations: bool = true,
    }
}

impl SuccessCriticConfig {
    /// Refuses values that cannot be.
    pub(crate) fn validate(&self) -> Result<(), Error> {
        check_positive("members", self.members as f64)?;
        check_layers("hidden", &self.hidden)?;
        check_positive("learning_rate", self.learning_rate)?;
        check_share("discount", self.discount)?;
        check_share("outcome_weight", self.outcome_weight)?;
        check_positive("tau", self.tau)?;
        check_share("tau", self.tau)?;
        let value = self.initial_probability;
        let is_open = value > 0.0 && value < 1.0;
        if is_open {
            Ok(())
        } else {
            let allowed = "above 0 and below 1";
            Err(Error::Setting { name: "initial_probability", value, allowed })
        }
    }

    /// The logit of P before anything was learned.
    pub(crate) fn initial_logit(&self) -> f32 {
        (self.initial_probability / (1.0 - self.initial_probability)).ln() as f32
    }
}
