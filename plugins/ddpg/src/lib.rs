#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod learner;
#[cfg(test)]
mod tests;

use actor_critic::{Adam, Agent, PolicyStep};
use learner_kit::plugin_error;
use shield_api::{Checkpoint, Host, Plugin, Result, Setup};

pub use learner_kit::DdpgConfig;

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

impl Checkpoint for Ddpg {
    fn save(&self, bytes: &mut Vec<u8>) -> Result<()> {
        self.agent.save(MAGIC, bytes).map_err(plugin_error)
    }

    fn load(&mut self, bytes: &[u8]) -> Result<()> {
        self.agent.load(MAGIC, bytes).map_err(plugin_error)
    }
}

shield_api::export_plugin! {
    learner "ddpg" => Ddpg { description: "DDPG with an ensemble of critics (Leave no Trace, appendix C)", deterministic: true }
}
