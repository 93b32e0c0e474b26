//! TD3: see `plugins/td3`, whose configuration this is.

use actor_critic::Adam;
use learner_kit::Td3Config;
use rand::RngExt;
use rand_distr::StandardNormal;
use shield_api::{ActMode, Batch, Checkpoint, Host, Learner, LearnerInfo, Plugin, Result, Setup};
use tch::{TchError, Tensor};

use crate::{
    agent::{Precision, Rows, TorchAgent},
    networks::{failed, read},
};

/// How a saved state begins: it is one of `td3`.
const MAGIC: &[u8] = b"shield/td3/1\n";

/// TD3 with an ensemble of pairs of critics, on libtorch.
#[derive(Debug)]
pub struct Td3<P> {
    config: Td3Config,
    host: Host,
    pub(crate) agent: TorchAgent<P>,
}

impl<P: Precision> Plugin for Td3<P> {
    type Config = Td3Config;

    fn create(config: Td3Config, setup: &Setup) -> Result<Self> {
        let agent = TorchAgent::new(config.agent(setup)?)?;
        Ok(Self { host: setup.host, agent, config })
    }
}

impl<P: Precision> Learner for Td3<P> {
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
        let rows = self.agent.take_batch(batch)?;
        let next_actions = self.smoothed_next_actions(&rows, batch.size)?;
        let Self { config, host, agent } = self;
        // y = r + γ c min(Q'₁, Q'₂)(s', ã), the same for both networks of a pair.
        let next_values =
            agent.critics.target_outputs(&rows.next_observations, Some(&next_actions)).map_err(failed)?;
        let least = smaller_of_pairs(&next_values).map_err(failed)?;
        let targets = agent.targets(&rows, config.discount, &least);
        let leaves = agent.critics.leaves().map_err(failed)?;
        let (gradient, found) = agent.critics_gradient(&leaves, &rows, &targets, config.loss)?;
        // Every policy_delay-th update, the actor learns and all target networks follow.
        let actor_learns = (agent.critics.steps() + 1).is_multiple_of(config.policy_delay);
        let (clip, tau) = (config.gradient_clip, if actor_learns { config.tau } else { 0.0 });
        if actor_learns {
            let (ascent, norm) = agent.actor_gradient(&leaves, &rows)?;
            agent.actor.step(&ascent, clip, &Adam::new(config.actor_rate), tau).map_err(failed)?;
            host.metric("actor_gradient_norm", norm);
        }
        drop(leaves);
        agent.critics.step(&gradient, clip, &Adam::new(config.critic_rate), tau).map_err(failed)?;
        host.metric("critic_loss", found.mean_loss());
        host.metric("q_mean", found.mean_value);
        Ok(())
    }
}

/// `networks × rows × 1`, each network with the smaller value of its pair.
fn smaller_of_pairs(values: &Tensor) -> Result<Tensor, TchError> {
    let networks = values.size()[0];
    let pairs = values.f_view([networks / 2, 2, -1, 1])?;
    pairs.f_amin([1_i64].as_slice(), true)?.f_expand([-1, 2, -1, -1], false)?.f_reshape([networks, -1, 1])
}

impl<P: Precision> Td3<P> {
    /// ã = π'(s') + clip(σ̃ N(0, 1), ±c), inside the box; the draws are those of `td3`.
    fn smoothed_next_actions(&mut self, rows: &Rows, size: usize) -> Result<Tensor> {
        let (sigma, clip) = (self.config.target_sigma, self.config.target_clip);
        let actions = self.agent.actor.target_outputs(&rows.next_observations, None).map_err(failed)?;
        let body = &mut self.agent.body;
        read(&actions, &mut body.buffers.next_actions)?;
        for action in &mut body.buffers.next_actions {
            let draw: f32 = body.rng.sample(StandardNormal);
            *action = (*action + (sigma * draw).clamp(-clip, clip)).clamp(-1.0, 1.0);
        }
        self.agent.rows_of(&self.agent.body.buffers.next_actions, size).map_err(failed)
    }
}

impl<P: Precision> Checkpoint for Td3<P> {
    fn save(&self, bytes: &mut Vec<u8>) -> Result<()> {
        self.agent.save(MAGIC, bytes)
    }

    fn load(&mut self, bytes: &[u8]) -> Result<()> {
        self.agent.load(MAGIC, bytes)
    }
}
