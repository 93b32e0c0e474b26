#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

#[cfg(test)]
mod tests;

use actor_critic::{Adam, SoftAgent, SoftStep, smaller};
use learner_kit::{ActorCritic, CriticReport, Update, plugin_error, take_batch};
use shield_api::{Batch, Host, Result};

pub use learner_kit::CrossqConfig;

/// CrossQ with an ensemble of pairs of critics.
pub type Crossq = ActorCritic<CrossqUpdate>;

/// How it learns.
#[derive(Debug)]
pub struct CrossqUpdate {
    actor_optimiser: Adam,
    critic_optimiser: Adam,
    temperature_optimiser: Adam,
    steps: Vec<SoftStep>,
    /// (s, a) of the batch, then (s', a').
    joint: Joint,
}

/// The rows that the critics see in one pass.
#[derive(Debug, Default)]
struct Joint {
    observations: Vec<f32>,
    actions: Vec<f32>,
}

impl Update for CrossqUpdate {
    type Config = CrossqConfig;
    type Agent = SoftAgent;

    fn new(config: &CrossqConfig) -> Self {
        let adam = |rate| Adam { beta1: config.beta1, weight_decay: config.weight_decay, ..Adam::new(rate) };
        Self {
            actor_optimiser: adam(config.actor_rate),
            critic_optimiser: adam(config.critic_rate),
            temperature_optimiser: Adam::new(config.temperature_rate),
            steps: vec![SoftStep::default(); config.critics],
            joint: Joint::default(),
        }
    }

    fn learn(
        &mut self,
        config: &CrossqConfig,
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

impl CrossqUpdate {
    /// The update itself: everything random but dropout was drawn.
    fn learn_from_draws(
        &mut self,
        config: &CrossqConfig,
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
        join(&mut self.joint.observations, &buffers.observations, &buffers.next_observations);
        join(&mut self.joint.actions, &buffers.actions, &buffers.next_actions);
        let Joint { observations, actions } = &self.joint;

        agent.critics.for_each_group(2, &mut self.steps, |pair, step| {
            let SoftStep { critic: step, policy } = step;
            step.begin(batch.size, batch.masks, pair.index(), config.critics);
            // One pass over (s, a) and (s', a') together, so that both have the same statistics:
            // yᵢ = r + γ c (min(Qᵢ₁, Qᵢ₂)(s', a') − α log π(a'|s')), without target networks.
            step.targets.fill(f32::INFINITY);
            for twin in 0..2 {
                let mut critic = pair.member(twin);
                let next_values = &critic.learn(observations, actions)[batch.size..];
                for (least, value) in step.targets.iter_mut().zip(next_values) {
                    *least = smaller(*least, *value);
                }
            }
            for (row, target) in step.targets.iter_mut().enumerate() {
                let next_value = *target - bonus * next_log_probabilities[row];
                *target = batch.rewards[row] + config.discount * batch.continuations[row] * next_value;
            }
            policy.begin(batch.size, action_len);
            (step.loss, step.mean_value) = (0.0, 0.0);
            for twin in 0..2 {
                let mut critic = pair.member(twin);
                let (values, gradients) = critic.outputs();
                let (now, next) = gradients.split_at_mut(batch.size);
                let loss = config.loss.evaluate(&values[..batch.size], &step.targets, &step.weights, now);
                next.fill(0.0);
                step.mean_value += 0.5 * values[..batch.size].iter().sum::<f32>() / batch.size as f32;
                step.loss += 0.5 * loss;
                critic.backward(observations, actions);
                // A pair whose mask selects nothing learns nothing from the batch's statistics either.
                let learns = loss.is_finite() && step.weights.iter().any(|weight| *weight > 0.0);
                if learns {
                    critic.keep_statistics();
                }
                if actor_learns {
                    // ∂ min(Qᵢ₁, Qᵢ₂)/∂a by the running statistics, with the weights before their step.
                    critic.observe(&buffers.observations);
                    critic.smallest_policy_gradients(buffers, policy);
                }
                if learns {
                    critic.clipped_step(clip, &self.critic_optimiser, 1.0);
                }
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

/// Both, one after the other.
fn join(joint: &mut Vec<f32>, now: &[f32], next: &[f32]) {
    joint.clear();
    joint.extend_from_slice(now);
    joint.extend_from_slice(next);
}

shield_api::export_plugin! {
    learner "crossq" => Crossq { description: "CrossQ (Bhatt et al. 2024) with an ensemble of pairs of critics", deterministic: true }
}
