//! The configuration of CrossQ.

use actor_critic::{
    Activation, AgentSettings, BatchRenorm, Initialisation, Loss, Regularisation, Valuation, check_below_one,
    check_positive, check_share,
};

shield_api::config! {
    /// Settings of CrossQ. "CrossQ" is Bhatt et al. 2024 with its authors' code; what it takes over from SAC is marked so.
    pub struct CrossqConfig {
        /// How many pairs of Q-functions; a pair's value is the smaller one (CrossQ: 1).
        critics: usize = 1,
        /// Hidden layers of the actor (CrossQ: 256, 256).
        actor_hidden: Vec<usize> = vec![256, 256] => "[256, 256]",
        /// Hidden layers of a critic (CrossQ: 2048, 2048, for a graphics card; a sixteenth of that arithmetic is affordable here).
        critic_hidden: Vec<usize> = vec![512, 512] => "[512, 512]",
        /// The hidden layer of a critic at which the action enters, from 0; the last if there are fewer (CrossQ: 0).
        action_layer: usize = 0,
        /// Tanh or Relu in hidden layers (CrossQ: ReLU).
        activation: Activation = Activation::Relu => "Relu",
        /// Normalises the sums of a critic's hidden layers before the activation (not in CrossQ).
        layer_norm: bool = false,
        /// Probability with which an update drops a hidden unit of a critic (not in CrossQ).
        dropout: f32 = 0.0,
        /// AdamW's decay of the matrices of actor and critics, times their step sizes (not in CrossQ).
        weight_decay: f64 = 0.0,
        /// How weights begin: FanIn (PyTorch's), Lillicrap (small in the last layer), Glorot or He.
        initialisation: Initialisation = Initialisation::FanIn => "FanIn",
        /// Adam's step size for the actor (CrossQ: 1e-3).
        actor_rate: f64 = 1e-3,
        /// Adam's step size for the critics (CrossQ: 1e-3).
        critic_rate: f64 = 1e-3,
        /// Adam's β₁ for actor and critics (CrossQ: 0.5).
        beta1: f64 = 0.5,
        /// Adam's step size for the logarithm of the temperature (CrossQ: 1e-3); 0: it stays as it begins.
        temperature_rate: f64 = 1e-3,
        /// α, the weight of the entropy, at the beginning (SAC: 1).
        initial_temperature: f32 = 1.0,
        /// The entropy that the temperature aims at, of actions in [-1, 1]; None: minus the number of an action's values (SAC).
        target_entropy: Option<f32> = None,
        /// Whether values count the entropy of later actions (SAC: true). False: they are those of the rewards alone, which a rule can compare.
        backup_entropy: bool = true,
        /// γ (SAC: 0.99).
        discount: f32 = 0.99,
        /// Updates of the critics per update of actor and temperature (CrossQ: 3).
        policy_delay: u64 = 3,
        /// Share of the running statistics of batch renormalisation that is kept per update (CrossQ: 0.99).
        renorm_momentum: f64 = 0.99,
        /// Updates of a network before its batches are led to the running statistics (CrossQ: 100,000).
        renorm_warm_up: u64 = 100_000 => "100000",
        /// Squared or Huber loss of the critics (SAC: squared).
        loss: Loss = Loss::Squared => "Squared",
        /// Exploring actions that are uniform in the space, at the beginning (as SAC's here).
        random_steps: u64 = 1_000 => "1000",
        /// Optimistic initial values: a bias of each critic's last layer.
        initial_value: Option<f32> = None,
        /// Longest gradient of each network; None: as it is.
        gradient_clip: Option<f32> = None,
        /// Scales observations by the running mean and variance of the batches.
        normalise_observations: bool = false,
        /// F32, or Half: `q_values` from copies of the weights in 16 bits, at half the reading (within 2⁻¹¹ of each weight).
        valuation: Valuation = Valuation::F32 => "F32",
    }
}

crate::settings::describe_agent!(CrossqConfig, "CrossQ", magic: b"shield/crossq/1\n", networks_per_member: 2, also_check: |config| {
    check_below_one("beta1", config.beta1)?;
    check_share("renorm_momentum", config.renorm_momentum)?;
    config.check_temperature()?;
    check_positive("policy_delay", config.policy_delay as f64)
}, exploration: |config, settings| {
    let batch_renorm = Some(BatchRenorm { momentum: config.renorm_momentum, warm_up: config.renorm_warm_up });
    let regularisation = Regularisation { batch_renorm, ..settings.regularisation };
    AgentSettings { regularisation, initial_temperature: config.initial_temperature, ..settings }
});

crate::settings::describe_temperature!(CrossqConfig);
