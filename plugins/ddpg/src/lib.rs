#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod config;
mod learner;
#[cfg(test)]
mod tests;

use actor_critic::{ActionScale, Adam, Agent, AgentSettings, PolicyStep, Schedule};
use shield_api::{Checkpoint, Error, Host, Plugin, Result, Setup, Space};

pub use config::DdpgConfig;

/// How a saved state begins.
const MAGIC: &[u8] = b"shield/ddpg/1\n";

/// Deep deterministic policy gradient with an ensemble of critics, each with its own target network.
#[derive(Debug)]
pub struct Ddpg {
    config: DdpgConfig,
    host: Host,
    agent: Agent,
    actor_optimiser: Adam,
    critic_optimiser: Adam,
    steps: Vec<PolicyStep>,
}

impl Plugin for Ddpg {
    type Config = DdpgConfig;

    fn create(config: DdpgConfig, setup: &Setup) -> Result<Self> {
        config.validate().map_err(invalid_config)?;
        let spaces = setup.spaces()?;
        let agent = Agent::new(AgentSettings {
            observation_len: spaces.observation_len(),
            scale: action_scale(&spaces.action)?,
            actor_hidden: &config.actor_hidden,
            critic_hidden: &config.critic_hidden,
            activation: config.activation,
            members: config.critics,
            networks_per_member: 1,
            initial_value: config.initial_value,
            normalise_observations: config.normalise_observations,
            noise: config.noise,
            sigma: Schedule {
                start: config.sigma,
                end: config.final_sigma.unwrap_or(config.sigma),
                steps: config.sigma_steps,
            },
            random_steps: config.random_steps,
            threads: setup.threads,
            seed: setup.seed,
        })
        .map_err(invalid_config)?;
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

impl Checkpoint for Ddpg {
    fn save(&self, bytes: &mut Vec<u8>) -> Result<()> {
        self.agent.save(MAGIC, bytes).map_err(failed)
    }

    fn load(&mut self, bytes: &[u8]) -> Result<()> {
        self.agent.load(MAGIC, bytes).map_err(invalid_argument)
    }
}

fn invalid_config(error: actor_critic::Error) -> Error {
    Error::invalid_config(error.to_string())
}

fn invalid_argument(error: actor_critic::Error) -> Error {
    Error::invalid_argument(error.to_string())
}

/// What is not finite in a network is a failure of the learner, not of an argument.
fn failed(error: actor_critic::Error) -> Error {
    Error::failed(error.to_string())
}

fn action_scale(space: &Space) -> Result<ActionScale> {
    let Space::Box { low, high } = space else {
        return Err(Error::invalid_argument(
            "DDPG needs continuous actions; for discrete ones there is ddqn",
        ));
    };
    ActionScale::new(low, high).ok_or_else(|| {
        Error::invalid_argument(format!("DDPG needs finite bounds of the actions, not {low:?} to {high:?}"))
    })
}

shield_api::export_plugin! {
    learner "ddpg" => Ddpg { description: "DDPG with an ensemble of critics (Leave no Trace, appendix C)", deterministic: true }
}
