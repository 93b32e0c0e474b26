//! The configuration, and what it may hold.

use shield_api::{Error, Result};

shield_api::config! {
    /// Settings of tabular Q-learning. "Paper" is Leave no Trace, section 5; what it does not give is said so.
    pub struct TabularQConfig {
        /// How many tables (paper: 5).
        members: usize = 5,
        /// Share of the way to its target that a value goes per update (Sutton and Barto 2018, example 6.5: 0.5).
        learning_rate: f32 = 0.5,
        /// γ (paper: 0.99).
        discount: f32 = 0.99,
        /// Initial values are uniform between this (a probability of resetting is at least 0) ...
        initial_low: f32 = 0.0,
        /// ... and this (and at most 1).
        initial_high: f32 = 1.0,
        /// Share of uniform actions while exploring, at the beginning (not given; chosen).
        epsilon: f32 = 0.3,
        /// The same after `epsilon_steps` (not given; chosen).
        final_epsilon: f32 = 0.05,
        /// Exploring actions within which the share moves linearly (not given; chosen).
        epsilon_steps: u64 = 5_000 => "5000",
    }
}

/// Values begin within plus and minus this.
const MOST_INITIAL: f32 = 1e30;

impl TabularQConfig {
    /// Refuses values that cannot be.
    pub(crate) fn validate(&self) -> Result<()> {
        check(self.members > 0, "members", self.members, "at least 1")?;
        let unit = |name, value: f32| check((0.0..=1.0).contains(&value), name, value, "in [0, 1]");
        unit("learning_rate", self.learning_rate)?;
        unit("discount", self.discount)?;
        unit("epsilon", self.epsilon)?;
        unit("final_epsilon", self.final_epsilon)?;
        // The range between the two must be a number, too.
        let allowed = -MOST_INITIAL..=MOST_INITIAL;
        let is_low = allowed.contains(&self.initial_low);
        check(is_low, "initial_low", self.initial_low, "from -1e30 to 1e30")?;
        let is_above = self.initial_high >= self.initial_low && allowed.contains(&self.initial_high);
        check(is_above, "initial_high", self.initial_high, "not below initial_low, and at most 1e30")
    }

    /// ε after the given number of exploring actions.
    pub(crate) fn epsilon_at(&self, step: u64) -> f32 {
        if step >= self.epsilon_steps {
            return self.final_epsilon;
        }
        let share = (step as f64 / self.epsilon_steps as f64) as f32;
        self.epsilon + share * (self.final_epsilon - self.epsilon)
    }
}

fn check(is_valid: bool, name: &str, value: impl std::fmt::Display, allowed: &str) -> Result<()> {
    if is_valid {
        Ok(())
    } else {
        Err(Error::invalid_config(format!("{name} is {value}; it must be {allowed}")).in_field(name))
    }
}
