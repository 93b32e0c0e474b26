//! DDPG: see `plugins/ddpg`, whose configuration this is.

use std::marker::PhantomData;

use actor_critic::Adam;
use learner_kit::{ActorCritic, DdpgConfig, Update};
use shield_api::{Batch, Host, Result};

use crate::{
    agent::{Precision, TorchAgent},
    networks::failed,
};

/// DDPG with an ensemble of critics, on libtorch.
pub type Ddpg<P> = ActorCritic<DdpgUpdate<P>>;

/// How it learns.
#[derive(Debug)]
pub struct DdpgUpdate<P>(PhantomData<P>);

impl<P: Precision> Update for DdpgUpdate<P> {
    type Config = DdpgConfig;
    type Agent = TorchAgent<P>;

    fn new(_config: &DdpgConfig) -> Self {
        Self(PhantomData)
    }

    fn learn(
        &mut self,
        config: &DdpgConfig,
        agent: &mut TorchAgent<P>,
        batch: &Batch<'_>,
        host: &Host,
    ) -> Result<()> {
        let rows = agent.take_batch(batch)?;
        // y = r + γ c Q'(s', π'(s'))
        let next_actions = agent.actor.target_outputs(&rows.next_observations, None).map_err(failed)?;
        let next_values =
            agent.critics.target_outputs(&rows.next_observations, Some(&next_actions)).map_err(failed)?;
        let targets = agent.targets(&rows, config.discount, &next_values);
        let leaves = agent.critics.leaves().map_err(failed)?;
        let (gradient, report) = agent.critics_gradient(&leaves, &rows, &targets, config.loss)?;
        // The actor's, at the critics' weights before their step.
        let (ascent, norm) = agent.actor_gradient(&leaves, &rows)?;
        drop(leaves);
        let (clip, tau) = (config.gradient_clip, config.tau);
        agent
            .critics
            .step(&gradient, clip, &Adam::new(config.critic_rate).with_decay(config.weight_decay), tau)
            .map_err(failed)?;
        agent
            .actor
            .step(&ascent, clip, &Adam::new(config.actor_rate).with_decay(config.weight_decay), tau)
            .map_err(failed)?;
        report.send(host);
        host.metric("actor_gradient_norm", norm);
        Ok(())
    }
}
