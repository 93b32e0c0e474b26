#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod buffers;
mod checkpoint;
mod config;
mod learner;
#[cfg(test)]
mod tests;

use actor_critic::{ActionScale, Adam, Architecture, Ensemble, Noise, Normaliser, Schedule};
use rand::SeedableRng;
use rand_pcg::Pcg64;
use shield_api::{Error, Host, Plugin, Result, Setup, Space};

use buffers::{Buffers, CriticStep, Valuation};
pub use config::DdpgConfig;

/// Deep deterministic policy gradient with an ensemble of critics, each with its own target network.
#[derive(Debug)]
pub struct Ddpg {
    config: DdpgConfig,
    host: Host,
    /// π, with its target network π'.
    actor: Ensemble<f32>,
    /// Q₁ … Qₙ, with their target networks. They see actions scaled to [-1, 1].
    critics: Ensemble<f32>,
    actor_optimiser: Adam,
    critic_optimiser: Adam,
    scale: ActionScale,
    normaliser: Option<Normaliser>,
    noise: Noise,
    rng: Pcg64,
    buffers: Buffers,
    critic_steps: Vec<CriticStep>,
    valuations: Vec<Valuation>,
}

impl Plugin for Ddpg {
    type Config = DdpgConfig;

    fn create(config: DdpgConfig, setup: &Setup) -> Result<Self> {
        config.validate()?;
        let spaces = setup.spaces()?;
        let scale = action_scale(&spaces.action)?;
        let (observation_len, action_len) = (spaces.observation_len(), spaces.action_len());
        let mut rng = Pcg64::seed_from_u64(setup.seed);
        let activation = config.activation;
        let actor = Architecture::actor(observation_len, action_len, &config.actor_hidden, activation)
            .and_then(|actor| Ensemble::new(actor, 1, 1, &mut rng))
            .map_err(invalid_config)?;
        let mut critics =
            Architecture::critic(observation_len, action_len, &config.critic_hidden, activation)
                .and_then(|critic| Ensemble::new(critic, config.critics, setup.threads, &mut rng))
                .map_err(invalid_config)?;
        if let Some(value) = config.initial_value {
            critics.raise_outputs(value);
        }
        let sigma = Schedule {
            start: config.sigma,
            end: config.final_sigma.unwrap_or(config.sigma),
            steps: config.sigma_steps,
        };
        Ok(Self {
            host: setup.host,
            actor,
            critics,
            actor_optimiser: Adam::new(config.actor_rate),
            critic_optimiser: Adam::new(config.critic_rate),
            scale,
            normaliser: config.normalise_observations.then(|| Normaliser::new(observation_len)),
            noise: Noise::new(config.noise, sigma, action_len),
            rng,
            buffers: Buffers::default(),
            critic_steps: vec![CriticStep::default(); config.critics],
            valuations: vec![Valuation::new(action_len); config.critics],
            config,
        })
    }
}

fn invalid_config(error: actor_critic::Error) -> Error {
    Error::invalid_config(error.to_string())
}

fn action_scale(space: &Space) -> Result<ActionScale> {
    let Space::Box { low, high } = space else {
        return Err(Error::invalid_argument(
            "DDPG needs continuous actions; for discrete ones there is tabular-q",
        ));
    };
    ActionScale::new(low, high).ok_or_else(|| {
        Error::invalid_argument(format!("DDPG needs finite bounds of the actions, not {low:?} to {high:?}"))
    })
}

shield_api::export_plugin! {
    learner "ddpg" => Ddpg { description: "DDPG with an ensemble of critics (Leave no Trace, appendix C)", deterministic: true }
}
