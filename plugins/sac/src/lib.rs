#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

#[cfg(test)]
mod tests;

use actor_critic::{Adam, SoftAgent, SoftStep};
use learner_kit::{ActorCritic, CriticReport, Update, plugin_error, take_batch};
use shield_api::{Batch, Host, Result};

pub use learner_kit::SacConfig;

/// Soft actor-critic with an ensemble of pairs of critics.
pub type Sac = ActorCritic<SacUpdate>;

/// How it learns.
#[derive(Debug)]
pub struct SacUpdate {
    actor_optimiser: Adam,
    critic_optimiser: Adam,
    temperature_optimiser: Adam,
    steps: Vec<SoftStep>,
}

impl Update for SacUpdate {
    type Config = SacConfig;
    type Agent = SoftAgent;

    fn new(config: &SacConfig) -> Self {
        Self {
            actor_optimiser: Adam::new(config.actor_rate).with_decay(config.weight_decay),
            critic_optimiser: Adam::new(config.critic_rate).with_decay(config.weight_decay),
            temperature_optimiser: Adam::new(config.temperature_rate),
            steps: vec![SoftStep::default(); config.critics],
        }
    }

    fn learn(
        &mut self,
        config: &SacConfig,
        agent: &mut SoftAgent,
        batch: &Batch<'_>,
        host: &Host,
    ) -> Result<()> {
        take_batch(&mut agent.body, batch, config.critics)?;
        agent.begin_update();
        agent.draw_noise();
        self.learn_from_draws(config, agent, batch, host)
    }
}

impl SacUpdate {
    /// The update itself: everything random was drawn.
    fn learn_from_draws(
        &mut self,
        config: &SacConfig,
        agent: &mut SoftAgent,
        batch: &Batch<'_>,
        host: &Host,
    ) -> Result<()> {
        // a' ~ π(·|s') for the critics' targets; a ~ π(·|s) for the actor's ascent.
        agent.choose_next_actions();
        let actor_learns = (agent.critics.steps() + 1).is_multiple_of(config.policy_delay);
        if actor_learns {
            agent.choose_policy_actions();
        }
        let bonus = if config.backup_entropy { agent.policy.temperature() } else { 0.0 };
        let (clip, buffers, action_len) = (config.gradient_clip, &agent.body.buffers, agent.body.scale.len());
        let next_log_probabilities = &agent.policy.next.log_probabilities;

        agent.critics.for_each_group(2, &mut self.steps, |pair, step| {
            let SoftStep { critic: step, policy } = step;
            step.begin(batch.size, batch.masks, pair.index(), config.critics);
            // yᵢ = r + γ c (min(Q'ᵢ₁, Q'ᵢ₂)(s', a') − α log π(a'|s'))
            let (next_states, next_actions) = (&buffers.next_observations, &buffers.next_actions);
            pair.smallest_target_values(next_states, next_actions, &mut step.targets);
            for (row, target) in step.targets.iter_mut().enumerate() {
                let next_value = *target - bonus * next_log_probabilities[row];
                *target = batch.rewards[row] + config.discount * batch.continuations[row] * next_value;
            }
            policy.begin(batch.size, action_len);
            (step.loss, step.mean_value) = (0.0, 0.0);
            for twin in 0..2 {
                let mut critic = pair.member(twin);
                let (loss, mean_value) = critic.fit(buffers, &step.targets, &step.weights, config.loss);
                if actor_learns {
                    // ∂ min(Qᵢ₁, Qᵢ₂)/∂a, with the weights before their step: the observation's share is computed once.
                    critic.smallest_policy_gradients(buffers, policy);
                }
                if loss.is_finite() {
                    critic.clipped_step(clip, &self.critic_optimiser, config.tau);
                }
                step.loss += 0.5 * loss;
                step.mean_value += 0.5 * mean_value;
            }
        });
        agent.critics.count_step();
        CriticReport::of(self.steps.iter().map(|step| &step.critic))?.send(host);
        if actor_learns {
            // The actor descends α log π − mean of the pairs' smaller values, over the batch.
            let ascended = agent.ascend(&self.steps, &self.actor_optimiser, clip);
            host.metric("actor_gradient_norm", f64::from(ascended.map_err(plugin_error)?));
            let adjusted = agent.adjust_temperature(config.target_entropy, &self.temperature_optimiser);
            adjusted.map_err(plugin_error)?;
            host.metric("entropy", agent.entropy());
            host.metric("temperature", f64::from(agent.policy.temperature()));
        }
        Ok(())
    }
}

shield_api::export_plugin! {
    learner "sac" => Sac { description: "SAC (Haarnoja et al. 2018) with an ensemble of pairs of critics", deterministic: true }
}
