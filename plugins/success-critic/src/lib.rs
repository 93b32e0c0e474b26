#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod action_input;
mod checkpoint;
mod config;
mod critic;
#[cfg(test)]
#[path = "../../../tests/critics/support.rs"]
mod support;
#[cfg(test)]
mod tests;

use actor_critic::{
    Activation, Adam, Architecture, Buffers, CriticStep, Ensemble, Initialisation, Normaliser,
};
use learner_kit::plugin_error;
use rand::SeedableRng;
use rand_pcg::Pcg64;
use shield_api::{Host, Plugin, Result, Setup, Space};

use action_input::ActionInput;
pub use config::SuccessCriticConfig;

/// An ensemble of networks for P(s, a), each with its own target network.
#[derive(Debug)]
pub struct CriticEnsemble {
    config: SuccessCriticConfig,
    host: Host,
    /// z₁ … zₙ with P = σ(z).
    critics: Ensemble<f32>,
    optimiser: Adam,
    actions: ActionInput,
    normaliser: Option<Normaliser>,
    /// Memory that is kept between calls, so that none is allocated after the first.
    buffers: Buffers,
    steps: Vec<CriticStep>,
    /// One per member.
    answers: Vec<Answer>,
}

/// One member's logit of one (s, a), and its gradient with respect to the network's input.
#[derive(Debug, Clone)]
struct Answer {
    logit: f32,
    /// Of an earlier action where it was not asked for.
    gradient: Vec<f32>,
}

impl Plugin for CriticEnsemble {
    type Config = SuccessCriticConfig;

    fn create(config: SuccessCriticConfig, setup: &Setup) -> Result<Self> {
        config.validate().map_err(plugin_error)?;
        let spaces = setup.spaces()?;
        let (observation_len, actions) = (spaces.observation_len(), ActionInput::new(&spaces.action)?);
        let action_len = actions.input_len();
        let mut rng = Pcg64::seed_from_u64(setup.seed);
        // The action enters before the second layer, as in the learners' critics. One thread: waking another takes longer than a network.
        let network = Architecture::critic(observation_len, action_len, &config.hidden, 1, Activation::Tanh);
        let mut critics = network
            .and_then(|network| {
                Ensemble::new(network, Initialisation::Lillicrap, config.members, 1, &mut rng)
            })
            .map_err(plugin_error)?;
        critics.raise_outputs(config.initial_logit());
        Ok(Self {
            host: setup.host,
            critics,
            optimiser: Adam::new(config.learning_rate),
            actions,
            normaliser: (config.normalise_observations && matches!(spaces.observation, Space::Box { .. }))
                .then(|| Normaliser::new(observation_len)),
            buffers: Buffers::default(),
            steps: vec![CriticStep::default(); config.members],
            answers: vec![Answer { logit: 0.0, gradient: vec![0.0; action_len] }; config.members],
            config,
        })
    }
}

shield_api::export_plugin! {
    success_critic "success-critic" => CriticEnsemble { description: "An ensemble of networks that learns the undo probability from outcomes", deterministic: true }
}
