//! The configuration of SAC.

use actor_critic::{Activation, Initialisation, Loss, Valuation, check_positive};

use crate::settings::check_tau;

shield_api::config! {
    /// Settings of SAC. "SAC" is Haarnoja et al. 2018b; "SB3" is Stable-Baselines3 2.9, whose defaults those of SBX are.
    pub struct SacConfig {
        /// How many pairs of Q-functions; a pair's value is the smaller one (SAC: 1).
        critics: usize = 1,
        /// Hidden layers of the actor (SAC: 256, 256).
        actor_hidden: Vec<usize> = vec![256, 256] => "[256, 256]",
        /// Hidden layers of a critic (SAC: 256, 256).
        critic_hidden: Vec<usize> = vec![256, 256] => "[256, 256]",
        /// The hidden layer of a critic at which the action enters, from 0; the last if there are fewer (SAC: 0).
        action_layer: usize = 0,
        /// Tanh or Relu in hidden layers (SAC: ReLU).
        activation: Activation = Activation::Relu => "Relu",
        /// Normalises the sums of a critic's hidden layers before the activation (not in SAC; DroQ, Hiraoka et al. 2022, and RLPD do).
        layer_norm: bool = false,
        /// Probability with which an update drops a hidden unit of a critic (not in SAC; DroQ: 0.01 or less, with `layer_norm`).
        dropout: f32 = 0.0,
        /// AdamW's decay of the matrices of actor and critics, times their step sizes (not in SAC).
        weight_decay: f64 = 0.0,
        /// How weights begin: FanIn (PyTorch's, so SB3's), Lillicrap (small in the last layer), Glorot or He.
        initialisation: Initialisation = Initialisation::FanIn => "FanIn",
        /// Adam's step size for the actor (SAC: 3e-4).
        actor_rate: f64 = 3e-4,
        /// Adam's step size for the critics (SAC: 3e-4).
        critic_rate: f64 = 3e-4,
        /// Adam's step size for the logarithm of the temperature (SAC: 3e-4); 0: it stays as it begins.
        temperature_rate: f64 = 3e-4,
        /// α, the weight of the entropy, at the beginning (SB3: 1).
        initial_temperature: f32 = 1.0,
        /// The entropy that the temperature aims at, of actions in [-1, 1]; None: minus the number of an action's values (SAC).
        target_entropy: Option<f32> = None,
        /// Whether values count the entropy of later actions (SAC: true). False: they are those of the rewards alone, which a rule can compare.
        backup_entropy: bool = true,
        /// γ (SAC: 0.99).
        discount: f32 = 0.99,
        /// Share by which the critics' target networks follow per update (SAC: 0.005).
        tau: f64 = 0.005,
        /// Updates of the critics per update of actor and temperature (SAC: 1; DroQ, with 20 updates per step: 20).
        policy_delay: u64 = 1,
        /// Squared or Huber loss of the critics (SAC: squared).
        loss: Loss = Loss::Squared => "Squared",
        /// Exploring actions that are uniform in the space, at the beginning (SAC: 1,000 for small tasks, 10,000 otherwise; SB3: 100).
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

crate::settings::describe_agent!(SacConfig, "SAC", magic: b"shield/sac/1\n", networks_per_member: 2, also_check: |config| {
    check_tau(config.tau)?;
    config.check_temperature()?;
    check_positive("policy_delay", config.policy_delay as f64)
}, exploration: |config, settings| {
    actor_critic::AgentSettings { initial_temperature: config.initial_temperature, ..settings }
});

crate::settings::describe_temperature!(SacConfig);
