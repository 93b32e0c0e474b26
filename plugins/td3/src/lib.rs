#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod learner;
#[cfg(test)]
mod tests;

use actor_critic::{Adam, Agent, PolicyStep};
use learner_kit::plugin_error;
use shield_api::{Checkpoint, Host, Plugin, Result, Setup};

pub use learner_kit::Td3Config;

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
        let agent = Agent::new(config.agent(setup)?).map_err(plugin_error)?;
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

shield_api::export_plugin! {
    learner "td3" => Td3 { description: "TD3 (Fujimoto et al. 2018) with an ensemble of pairs of critics", deterministic: true }
}
