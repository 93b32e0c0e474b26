#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

#[cfg(test)]
mod tests;

use actor_critic::{Adam, Agent, PolicyStep};
use learner_kit::{ActorCritic, CriticReport, Update, plugin_error, take_batch};
use shield_api::{Batch, Host, Result};

pub use learner_kit::DdpgConfig;

/// Deep deterministic policy gradient with an ensemble of critics, each with its own target network.
pub type Ddpg = ActorCritic<DdpgUpdate>;

/// How it learns.
#[derive(Debug)]
pub struct DdpgUpdate {
    actor_optimiser: Adam,
    critic_optimiser: Adam,
    steps: Vec<PolicyStep>,
}

impl Update for DdpgUpdate {
    type Config = DdpgConfig;
    type Agent = Agent;

    fn new(config: &DdpgConfig) -> Self {
        Self {
            actor_optimiser: Adam::new(config.actor_rate).with_decay(config.weight_decay),
            critic_optimiser: Adam::new(config.critic_rate).with_decay(config.weight_decay),
            steps: vec![PolicyStep::default(); config.critics],
        }
    }

    fn learn(
        &mut self,
        config: &DdpgConfig,
        agent: &mut Agent,
        batch: &Batch<'_>,
        host: &Host,
    ) -> Result<()> {
        take_batch(&mut agent.body, batch, config.critics)?;
        agent.begin_update();
        // π'(s') for the critics' targets; π(s) for the actor's ascent.
        agent.choose_next_actions();
        agent.choose_policy_actions();
        let (clip, buffers) = (config.gradient_clip, &agent.body.buffers);

        agent.critics.for_each_member(&mut self.steps, |critic, step| {
            let PolicyStep { critic: step, action_gradients } = step;
            step.begin(batch.size, batch.masks, critic.index(), config.critics);
            // yᵢ = r + γ c Q'ᵢ(s', π'(s'))
            let next_values = critic.target_values(&buffers.next_observations, &buffers.next_actions);
            for (row, next_value) in next_values.iter().enumerate() {
                let bootstrap = config.discount * batch.continuations[row] * next_value;
                step.targets[row] = batch.rewards[row] + bootstrap;
            }
            (step.loss, step.mean_value) = critic.fit(buffers, &step.targets, &step.weights, config.loss);
            // ∂Qᵢ/∂a at π(s), with the weights before their step: the observation's share is computed once.
            critic.policy_gradients(buffers, action_gradients);
            if step.loss.is_finite() {
                critic.clipped_step(clip, &self.critic_optimiser, config.tau);
            }
        });
        agent.critics.count_step();
        let report = CriticReport::of(self.steps.iter().map(|step| &step.critic))?;

        // The actor ascends the mean of the ensemble's values, over the batch.
        let ascended = agent.ascend(&self.steps, &self.actor_optimiser, clip, config.tau);
        let norm = ascended.map_err(plugin_error)?;
        report.send(host);
        host.metric("actor_gradient_norm", f64::from(norm));
        Ok(())
    }
}

shield_api::export_plugin! {
    learner "ddpg" => Ddpg { description: "DDPG with an ensemble of critics (Leave no Trace, appendix C)", deterministic: true }
}
