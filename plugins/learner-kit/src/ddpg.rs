//! The configuration of DDPG.

use actor_critic::{Activation, Initialisation, Loss, NoiseProcess, Valuation};

use crate::settings::check_tau;

shield_api::config! {
    /// Settings of DDPG. "Paper" is Leave no Trace, appendix C; what it does not give comes from Lillicrap et al. 2015
    /// (DDPG) and Fujimoto et al. 2018 (TD3).
    pub struct DdpgConfig {
        /// How many Q-functions (paper: 20).
        critics: usize = 20,
        /// Hidden layers of the actor (paper: 400, 300).
        actor_hidden: Vec<usize> = vec![400, 300] => "[400, 300]",
        /// Hidden layers of a critic (paper: 400, 300).
        critic_hidden: Vec<usize> = vec![400, 300] => "[400, 300]",
        /// The hidden layer of a critic at which the action enters, from 0; the last if there are fewer (DDPG and paper: 1; TD3: 0).
        action_layer: usize = 1,
        /// Tanh or Relu in hidden layers (paper: tanh).
        activation: Activation = Activation::Tanh => "Tanh",
        /// Normalises the sums of a critic's hidden layers before the activation (not in the paper; DroQ, Hiraoka et al. 2022, and RLPD do).
        layer_norm: bool = false,
        /// Probability with which an update drops a hidden unit of a critic (not in the paper; DroQ: 0.01 or less, with `layer_norm`).
        dropout: f32 = 0.0,
        /// AdamW's decay of the matrices of actor and critics, times their step sizes (not in the paper).
        weight_decay: f64 = 0.0,
        /// How weights begin: Lillicrap (DDPG's: small in the last layer), FanIn (PyTorch's), Glorot or He.
        initialisation: Initialisation = Initialisation::Lillicrap => "Lillicrap",
        /// Adam's step size for the actor (DDPG: 1e-4).
        actor_rate: f64 = 1e-4,
        /// Adam's step size for the critics (DDPG: 1e-3).
        critic_rate: f64 = 1e-3,
        /// γ (paper: 0.99).
        discount: f32 = 0.99,
        /// Share by which target networks follow per update (TD3: 0.005).
        tau: f64 = 0.005,
        /// Squared or Huber loss of the critics (not given; Huber bounds the step after a rare reward).
        loss: Loss = Loss::Huber => "Huber",
        /// Gaussian, or OrnsteinUhlenbeck(theta: 0.15) as in DDPG.
        noise: NoiseProcess = NoiseProcess::Gaussian => "Gaussian",
        /// Size of the exploration noise, as a share of half the action's range (DDPG: 0.2).
        sigma: f32 = 0.2,
        /// Size of the noise after `sigma_steps`; None: it stays.
        final_sigma: Option<f32> = None,
        /// Exploring actions within which the noise moves linearly to `final_sigma`.
        sigma_steps: u64 = 100_000 => "100000",
        /// Exploring actions that are uniform in the space, at the beginning (TD3: 1,000 for small tasks).
        random_steps: u64 = 1_000 => "1000",
        /// Optimistic initial values: a bias of each critic's last layer, of its target network too.
        initial_value: Option<f32> = None,
        /// Longest gradient of each network; None: as it is.
        gradient_clip: Option<f32> = None,
        /// Scales observations by the running mean and variance of the batches.
        normalise_observations: bool = false,
        /// F32, or Half: `q_values` from copies of the weights in 16 bits, at half the reading (within 2⁻¹¹ of each weight).
        valuation: Valuation = Valuation::F32 => "F32",
    }
}

crate::settings::describe_agent!(DdpgConfig, "DDPG", magic: b"shield/ddpg/1\n", networks_per_member: 1,
    also_check: |config| {
    check_tau(config.tau)?;
    config.check_noise()
}, exploration: Self::noisy);
crate::settings::describe_noise!(DdpgConfig);
