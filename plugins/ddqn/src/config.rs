//! The configuration, and what it may hold.

use actor_critic::{
    Activation, Error, Initialisation, Loss, check_finite_setting, check_layers, check_positive, check_share,
};

shield_api::config! {
    /// Settings of double DQN. "CleanRL" is the setting of its `dqn.py` for small tasks; "DDQN" is van Hasselt et al. 2016.
    pub struct DdqnConfig {
        /// How many Q-networks (Leave no Trace, section 5: 5).
        members: usize = 5,
        /// Hidden layers (CleanRL: 120, 84).
        hidden: Vec<usize> = vec![120, 84] => "[120, 84]",
        /// Tanh or Relu in hidden layers (CleanRL: ReLU).
        activation: Activation = Activation::Relu => "Relu",
        /// How weights begin: Lillicrap (DDPG's: small in the last layer), FanIn (PyTorch's, so CleanRL's), Glorot or He.
        initialisation: Initialisation = Initialisation::Lillicrap => "Lillicrap",
        /// Adam's step size (CleanRL: 2.5e-4).
        rate: f64 = 2.5e-4,
        /// γ (DDQN: 0.99).
        discount: f32 = 0.99,
        /// Share by which target networks follow per update (TD3: 0.005; DDQN copies them at intervals).
        tau: f64 = 0.005,
        /// Squared or Huber loss (DDQN clips the error to [-1, 1]: Huber).
        loss: Loss = Loss::Huber => "Huber",
        /// Share of uniform actions while exploring, at the beginning (DDQN: 1).
        epsilon: f32 = 1.0,
        /// The same after `epsilon_steps` (CleanRL: 0.05).
        final_epsilon: f32 = 0.05,
        /// Exploring actions within which the share moves linearly (not given for small tasks; chosen).
        epsilon_steps: u64 = 10_000 => "10000",
        /// Optimistic initial values: a bias of each network's last layer, of its target network too.
        initial_value: Option<f32> = None,
        /// Longest gradient of each network; None: as it is.
        gradient_clip: Option<f32> = None,
        /// Scales observations by the running mean and variance of the batches.
        normalise_observations: bool = false,
    }
}

impl DdqnConfig {
    /// Refuses values that cannot be.
    pub(crate) fn validate(&self) -> Result<(), Error> {
        check_positive("members", self.members as f64)?;
        check_layers("hidden", &self.hidden)?;
        check_positive("rate", self.rate)?;
        check_share("discount", self.discount)?;
        check_positive("tau", self.tau)?;
        check_share("tau", self.tau)?;
        check_share("epsilon", self.epsilon)?;
        check_share("final_epsilon", self.final_epsilon)?;
        check_finite_setting("initial_value", self.initial_value.unwrap_or(0.0))?;
        check_positive("gradient_clip", self.gradient_clip.unwrap_or(1.0))
    }
}
