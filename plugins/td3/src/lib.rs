#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod config;
mod learner;
#[cfg(test)]
mod tests;

use actor_critic::{ActionScale, Adam, Agent, AgentSettings, ErrorKind, PolicyStep, Schedule};
use shield_api::{Checkpoint, Error, Host, Plugin, Result, Setup, Space};

pub use config::Td3Config;

/// How a saved state begins.
const MAGIC: &[u8] = b"shield/td3/1\n";

/// Twin delayed deep deterministic policy gradient with an ensemble of pairs of critics.
#[derive(Debug)]
pub struct Td3 {
    config: Td3Config,
    host: Host,
    agent: Agent,
    actor_optimiser: Adam,
    critic_optimiser: Adam,
    steps: Vec<PolicyStep>,
}

impl Plugin for Td3 {
    type Config = Td3Config;

    fn create(config: Td3Config, setup: &Setup) -> Result<Self> {
        config.validate().map_err(plugin_error)?;
        let spaces = setup.spaces()?;
        let Space::Box { low, high } = &spaces.action else {
            return Err(Error::invalid_argument(
                "TD3 needs continuous actions; for discrete ones there is ddqn",
            ));
        };
        let agent = Agent::new(AgentSettings {
            observation_len: spaces.observation_len(),
            scale: ActionScale::new(low, high).map_err(plugin_error)?,
            actor_hidden: &config.actor_hidden,
            critic_hidden: &config.critic_hidden,
            activation: config.activation,
            members: config.critics,
            networks_per_member: 2,
            initial_value: config.initial_value,
            normalise_observations: config.normalise_observations,
            noise: config.noise,
            sigma: Schedule {
                start: config.sigma,
                end: config.final_sigma.unwrap_or(config.sigma),
                steps: config.sigma_steps,
            },
            random_steps: config.random_steps,
            valuation: config.valuation,
            threads: setup.threads,
            seed: setup.seed,
        })
        .map_err(plugin_error)?;
        Ok(Self {
            host: setup.host,
            agent,
            actor_optimiser: Adam::new(config.actor_rate),
            critic_optimiser: Adam::new(config.critic_rate),
            steps: vec![PolicyStep::default(); config.critics],
            config,
        })
    }
}

impl Checkpoint for Td3 {
    fn save(&self, bytes: &mut Vec<u8>) -> Result<()> {
        self.agent.save(MAGIC, bytes).map_err(plugin_error)
    }

    fn load(&mut self, bytes: &[u8]) -> Result<()> {
        self.agent.load(MAGIC, bytes).map_err(plugin_error)
    }
}

fn plugin_error(error: actor_critic::Error) -> Error {
    let message = error.to_string();
    match error.kind() {
        ErrorKind::Setting => Error::invalid_config(message),
        ErrorKind::Argument => Error::invalid_argument(message),
        ErrorKind::Failure => Error::failed(message),
    }
}

shield_api::export_plugin! {
    learner "td3" => Td3 { description: "TD3 (Fujimoto et al. 2018) with an ensemble of pairs of critics", deterministic: true }
}
