//! Acting, valuing and learning.

use actor_critic::{CriticStep, PolicyStep, smaller};
use learner_kit::{check_batch, plugin_error};
use rand::RngExt;
use rand_distr::StandardNormal;
use shield_api::{ActMode, Batch, Learner, LearnerInfo, Result, check_finite};

use crate::Td3;

impl Learner for Td3 {
    fn info(&self) -> LearnerInfo {
        LearnerInfo { members: self.config.critics, discount: self.config.discount }
    }

    fn act(&mut self, observation: &[f32], mode: ActMode, action: &mut [f32]) -> Result<()> {
        self.agent.act(observation, mode == ActMode::Explore, action).map_err(plugin_error)
    }

    fn q_values(&mut self, observation: &[f32], action: &[f32], values: &mut [f32]) -> Result<()> {
        self.agent.value(observation, action, values, None).map_err(plugin_error)
    }

    fn q_gradients(
        &mut self,
        observation: &[f32],
        action: &[f32],
        values: &mut [f32],
        gradients: &mut [f32],
    ) -> Result<()> {
        self.agent.value(observation, action, values, Some(gradients)).map_err(plugin_error)
    }

    fn weights(&self, bytes: &mut Vec<u8>) -> Result<()> {
        self.agent.write_weights(bytes).map_err(plugin_error)
    }

    fn onnx(&self, bytes: &mut Vec<u8>) -> Result<()> {
        self.agent.write_onnx(bytes);
        Ok(())
    }

    fn update(&mut self, batch: &Batch<'_>) -> Result<()> {
        check_finite("actions", batch.actions, batch.size * self.agent.action_len())?;
        check_batch(batch, self.agent.observation_len(), self.config.critics)?;
        self.agent.body.take_batch(batch.observations, batch.actions, batch.next_observations);
        self.agent.choose_next_actions();
        self.smooth_next_actions();
        // Every policy_delay-th update, the actor learns and all target networks follow.
        let actor_learns = (self.agent.critics.steps() + 1).is_multiple_of(self.config.policy_delay);
        if actor_learns {
            self.agent.choose_policy_actions();
        }
        let Self { config, agent, steps, .. } = self;
        let (clip, buffers) = (config.gradient_clip, &agent.body.buffers);
        let tau = if actor_learns { config.tau } else { 0.0 };

        agent.critics.for_each_group(2, steps, |pair, step| {
            let PolicyStep { critic: step, action_gradients } = step;
            step.begin(batch.size, batch.masks, pair.index(), config.critics);
            // yᵢ = r + γ c min(Q'ᵢ₁, Q'ᵢ₂)(s', ã)
            step.targets.fill(f32::INFINITY);
            for twin in 0..2 {
                let mut critic = pair.member(twin);
                let next_values = critic.target_values(&buffers.next_observations, &buffers.next_actions);
                step.targets
                    .iter_mut()
                    .zip(next_values)
                    .for_each(|(least, value)| *least = smaller(*least, *value));
            }
            for (row, target) in step.targets.iter_mut().enumerate() {
                *target = batch.rewards[row] + config.discount * batch.continuations[row] * *target;
            }
            (step.loss, step.mean_value) = (0.0, 0.0);
            for twin in 0..2 {
                let mut critic = pair.member(twin);
                critic.observe(&buffers.observations);
                let mean_value = critic.values(&buffers.actions).iter().sum::<f32>() / batch.size as f32;
                let (values, gradients) = critic.outputs();
                let loss = config.loss.evaluate(values, &step.targets, &step.weights, gradients);
                critic.backward(&buffers.observations, &buffers.actions);
                if actor_learns && twin == 0 {
                    // ∂Qᵢ₁/∂a at π(s), with the weights before their step: the observation's share is computed once.
                    critic.values(&buffers.policy_actions);
                    action_gradients.resize(buffers.policy_actions.len(), 0.0);
                    critic.action_gradients(action_gradients);
                }
                if loss.is_finite() {
                    critic.clipped_step(clip, &self.critic_optimiser, tau);
                }
                step.loss += 0.5 * loss;
                step.mean_value += 0.5 * mean_value;
            }
        });
        agent.critics.count_step();
        CriticStep::check(steps.iter().map(|step| &step.critic)).map_err(plugin_error)?;

        let (loss, value) = CriticStep::means(steps.iter().map(|step| &step.critic));
        self.host.metric("critic_loss", loss);
        self.host.metric("q_mean", value);
        if actor_learns {
            // The actor ascends the mean of the pairs' first values, over the batch.
            let norm = agent.ascend(steps, &self.actor_optimiser, clip, tau).map_err(plugin_error)?;
            self.host.metric("actor_gradient_norm", f64::from(norm));
        }
        Ok(())
    }
}

impl Td3 {
    /// Target smoothing: ã = π'(s') + clip(σ̃ N(0, 1), ±c), inside the box. The same for every pair.
    pub(crate) fn smooth_next_actions(&mut self) {
        let (sigma, clip) = (self.config.target_sigma, self.config.target_clip);
        for action in &mut self.agent.body.buffers.next_actions {
            let draw: f32 = self.agent.body.rng.sample(StandardNormal);
            *action = (*action + (sigma * draw).clamp(-clip, clip)).clamp(-1.0, 1.0);
        }
    }
}
