//! DDPG: see `plugins/ddpg`, whose configuration this is.

use actor_critic::Adam;
use learner_kit::DdpgConfig;
use shield_api::{ActMode, Batch, Checkpoint, Host, Learner, LearnerInfo, Plugin, Result, Setup};

use crate::{
    agent::{Precision, TorchAgent},
    networks::failed,
};

/// How a saved state begins: it is one of `ddpg`.
const MAGIC: &[u8] = b"shield/ddpg/1\n";

/// DDPG with an ensemble of critics, on libtorch.
#[derive(Debug)]
pub struct Ddpg<P> {
    config: DdpgConfig,
    host: Host,
    pub(crate) agent: TorchAgent<P>,
}

impl<P: Precision> Plugin for Ddpg<P> {
    type Config = DdpgConfig;

    fn create(config: DdpgConfig, setup: &Setup) -> Result<Self> {
        let agent = TorchAgent::new(config.agent(setup)?)?;
        Ok(Self { host: setup.host, agent, config })
    }
}

impl<P: Precision> Learner for Ddpg<P> {
    fn info(&self) -> LearnerInfo {
        LearnerInfo { members: self.config.critics, discount: self.config.discount }
    }

    fn act(&mut self, observation: &[f32], mode: ActMode, action: &mut [f32]) -> Result<()> {
        self.agent.act(observation, mode == ActMode::Explore, action)
    }

    fn q_values(&mut self, observation: &[f32], action: &[f32], values: &mut [f32]) -> Result<()> {
        self.agent.value(observation, action, values, None)
    }

    fn q_gradients(
        &mut self,
        observation: &[f32],
        action: &[f32],
        values: &mut [f32],
        gradients: &mut [f32],
    ) -> Result<()> {
        self.agent.value(observation, action, values, Some(gradients))
    }

    fn update(&mut self, batch: &Batch<'_>) -> Result<()> {
        let Self { config, host, agent } = self;
        let rows = agent.take_batch(batch)?;
        // y = r + γ c Q'(s', π'(s'))
        let next_actions = agent.actor.target_outputs(&rows.next_observations, None).map_err(failed)?;
        let next_values =
            agent.critics.target_outputs(&rows.next_observations, Some(&next_actions)).map_err(failed)?;
        let targets = agent.targets(&rows, config.discount, &next_values);
        let leaves = agent.critics.leaves().map_err(failed)?;
        let (gradient, found) = agent.critics_gradient(&leaves, &rows, &targets, config.loss)?;
        // The actor's, at the critics' weights before their step.
        let (ascent, norm) = agent.actor_gradient(&leaves, &rows)?;
        drop(leaves);
        let (clip, tau) = (config.gradient_clip, config.tau);
        agent.critics.step(&gradient, clip, &Adam::new(config.critic_rate), tau).map_err(failed)?;
        agent.actor.step(&ascent, clip, &Adam::new(config.actor_rate), tau).map_err(failed)?;
        host.metric("critic_loss", found.mean_loss());
        host.metric("q_mean", found.mean_value);
        host.metric("actor_gradient_norm", norm);
        Ok(())
    }
}

impl<P: Precision> Checkpoint for Ddpg<P> {
    fn save(&self, bytes: &mut Vec<u8>) -> Result<()> {
        self.agent.save(MAGIC, bytes)
    }

    fn load(&mut self, bytes: &[u8]) -> Result<()> {
        self.agent.load(MAGIC, bytes)
    }
}
