#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

#[cfg(test)]
mod tests;

use actor_critic::{Adam, Agent, PolicyStep};
use learner_kit::{ActorCritic, CriticReport, Update, plugin_error, take_batch};
use shield_api::{Batch, Host, Result};

pub use learner_kit::Td3Config;

/// Twin delayed deep deterministic policy gradient with an ensemble of pairs of critics.
pub type Td3 = ActorCritic<Td3Update>;

/// How it learns.
#[derive(Debug)]
pub struct Td3Update {
    actor_optimiser: Adam,
    critic_optimiser: Adam,
    steps: Vec<PolicyStep>,
}

impl Update for Td3Update {
    type Config = Td3Config;
    type Agent = Agent;

    fn new(config: &Td3Config) -> Self {
        Self {
            actor_optimiser: Adam::new(config.actor_rate).with_decay(config.weight_decay),
            critic_optimiser: Adam::new(config.critic_rate).with_decay(config.weight_decay),
            steps: vec![PolicyStep::default(); config.critics],
        }
    }

    fn learn(&mut self, config: &Td3Config, agent: &mut Agent, batch: &Batch<'_>, host: &Host) -> Result<()> {
        take_batch(&mut agent.body, batch, config.critics)?;
        agent.begin_update();
        agent.choose_next_actions();
        let body = &mut agent.body;
        config.smooth(&mut body.buffers.next_actions, &mut body.rng);
        // Every policy_delay-th update, the actor learns and all target networks follow.
        let actor_learns = (agent.critics.steps() + 1).is_multiple_of(config.policy_delay);
        if actor_learns {
            agent.choose_policy_actions();
        }
        let (clip, buffers) = (config.gradient_clip, &agent.body.buffers);
        let tau = if actor_learns { config.tau } else { 0.0 };

        agent.critics.for_each_group(2, &mut self.steps, |pair, step| {
            let PolicyStep { critic: step, action_gradients } = step;
            step.begin(batch.size, batch.masks, pair.index(), config.critics);
            // yᵢ = r + γ c min(Q'ᵢ₁, Q'ᵢ₂)(s', ã)
            let (next_states, next_actions) = (&buffers.next_observations, &buffers.next_actions);
            pair.smallest_target_values(next_states, next_actions, &mut step.targets);
            for (row, target) in step.targets.iter_mut().enumerate() {
                *target = batch.rewards[row] + config.discount * batch.continuations[row] * *target;
            }
            (step.loss, step.mean_value) = (0.0, 0.0);
            for twin in 0..2 {
                let mut critic = pair.member(twin);
                let (loss, mean_value) = critic.fit(buffers, &step.targets, &step.weights, config.loss);
                if actor_learns && twin == 0 {
                    // ∂Qᵢ₁/∂a at π(s), with the weights before their step: the observation's share is computed once.
                    critic.policy_gradients(buffers, action_gradients);
                }
                if loss.is_finite() {
                    critic.clipped_step(clip, &self.critic_optimiser, tau);
                }
                step.loss += 0.5 * loss;
                step.mean_value += 0.5 * mean_value;
            }
        });
        agent.critics.count_step();
        CriticReport::of(self.steps.iter().map(|step| &step.critic))?.send(host);
        if actor_learns {
            // The actor ascends the mean of the pairs' first values, over the batch.
            let ascended = agent.ascend(&self.steps, &self.actor_optimiser, clip, tau);
            host.metric("actor_gradient_norm", f64::from(ascended.map_err(plugin_error)?));
        }
        Ok(())
    }
}

shield_api::export_plugin! {
    learner "td3" => Td3 { description: "TD3 (Fujimoto et al. 2018) with an ensemble of pairs of critics", deterministic: true }
}
