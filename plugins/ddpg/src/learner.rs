//! Acting, valuing and learning.

use actor_critic::{CriticStep, PolicyStep};
use learner_kit::{check_batch, plugin_error};
use shield_api::{ActMode, Batch, Learner, LearnerInfo, Result, check_finite};

use crate::Ddpg;

impl Learner for Ddpg {
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
        // π'(s') for the critics' targets; π(s) for the actor's ascent.
        self.agent.choose_next_actions();
        self.agent.choose_policy_actions();
        let Self { config, agent, steps, .. } = self;
        let (clip, buffers) = (config.gradient_clip, &agent.body.buffers);

        agent.critics.for_each_member(steps, |critic, step| {
            let PolicyStep { critic: step, action_gradients } = step;
            step.begin(batch.size, batch.masks, critic.index(), config.critics);
            // yᵢ = r + γ c Q'ᵢ(s', π'(s'))
            let next_values = critic.target_values(&buffers.next_observations, &buffers.next_actions);
            for (row, next_value) in next_values.iter().enumerate() {
                let bootstrap = config.discount * batch.continuations[row] * next_value;
                step.targets[row] = batch.rewards[row] + bootstrap;
            }
            critic.observe(&buffers.observations);
            step.mean_value = critic.values(&buffers.actions).iter().sum::<f32>() / batch.size as f32;
            let (values, gradients) = critic.outputs();
            step.loss = config.loss.evaluate(values, &step.targets, &step.weights, gradients);
            critic.backward(&buffers.observations, &buffers.actions);

            // ∂Qᵢ/∂a at π(s), with the weights before their step: the observation's share is computed once.
            critic.values(&buffers.policy_actions);
            action_gradients.resize(buffers.policy_actions.len(), 0.0);
            critic.action_gradients(action_gradients);
            if step.loss.is_finite() {
                critic.clipped_step(clip, &self.critic_optimiser, config.tau);
            }
        });
        agent.critics.count_step();
        CriticStep::check(steps.iter().map(|step| &step.critic)).map_err(plugin_error)?;

        // The actor ascends the mean of the ensemble's values, over the batch.
        let norm = agent.ascend(steps, &self.actor_optimiser, clip, config.tau).map_err(plugin_error)?;
        let (loss, value) = CriticStep::means(steps.iter().map(|step| &step.critic));
        self.host.metric("critic_loss", loss);
        self.host.metric("q_mean", value);
        self.host.metric("actor_gradient_norm", f64::from(norm));
        Ok(())
    }
}
