//! TD3: see `plugins/td3`, whose configuration this is.

use std::marker::PhantomData;

use actor_critic::Adam;
use learner_kit::{ActorCritic, Td3Config, Update};
use shield_api::{Batch, Host, Result};
use tch::{TchError, Tensor};

use crate::{
    agent::{Precision, TorchAgent},
    networks::{failed, read},
};

/// TD3 with an ensemble of pairs of critics, on libtorch.
pub type Td3<P> = ActorCritic<Td3Update<P>>;

/// How it learns.
#[derive(Debug)]
pub struct Td3Update<P>(PhantomData<P>);

impl<P: Precision> Update for Td3Update<P> {
    type Config = Td3Config;
    type Agent = TorchAgent<P>;

    fn new(_config: &Td3Config) -> Self {
        Self(PhantomData)
    }

    fn learn(
        &mut self,
        config: &Td3Config,
        agent: &mut TorchAgent<P>,
        batch: &Batch<'_>,
        host: &Host,
    ) -> Result<()> {
        let rows = agent.take_batch(batch)?;
        // ã = π'(s') + noise; the draws are those of `td3`.
        let policy = agent.actor.target_outputs(&rows.next_observations, None).map_err(failed)?;
        let body = &mut agent.body;
        read(&policy, &mut body.buffers.next_actions)?;
        config.smooth(&mut body.buffers.next_actions, &mut body.rng);
        let next_actions = agent.rows_of(&agent.body.buffers.next_actions, batch.size).map_err(failed)?;
        // y = r + γ c min(Q'₁, Q'₂)(s', ã), the same for both networks of a pair.
        let next_values =
            agent.critics.target_outputs(&rows.next_observations, Some(&next_actions)).map_err(failed)?;
        let least = smaller_of_pairs(&next_values).map_err(failed)?;
        let targets = agent.targets(&rows, config.discount, &least);
        let leaves = agent.critics.leaves().map_err(failed)?;
        let (gradient, report) = agent.critics_gradient(&leaves, &rows, &targets, config.loss)?;
        // Every policy_delay-th update, the actor learns and all target networks follow.
        let actor_learns = (agent.critics.steps() + 1).is_multiple_of(config.policy_delay);
        let (clip, tau) = (config.gradient_clip, if actor_learns { config.tau } else { 0.0 });
        if actor_learns {
            let (ascent, norm) = agent.actor_gradient(&leaves, &rows)?;
            agent
                .actor
                .step(&ascent, clip, &Adam::new(config.actor_rate).with_decay(config.weight_decay), tau)
                .map_err(failed)?;
            host.metric("actor_gradient_norm", norm);
        }
        drop(leaves);
        agent
            .critics
            .step(&gradient, clip, &Adam::new(config.critic_rate).with_decay(config.weight_decay), tau)
            .map_err(failed)?;
        report.send(host);
        Ok(())
    }
}

/// `networks × rows × 1`, each network with the smaller value of its pair.
fn smaller_of_pairs(values: &Tensor) -> Result<Tensor, TchError> {
    let networks = values.size()[0];
    let pairs = values.f_view([networks / 2, 2, -1, 1])?;
    pairs.f_amin([1_i64].as_slice(), true)?.f_expand([-1, 2, -1, -1], false)?.f_reshape([networks, -1, 1])
}
