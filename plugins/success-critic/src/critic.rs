//! Estimating and learning.

use actor_critic::{CriticStep, Normaliser, check_finite_output, cross_entropy, sigmoid};
use learner_kit::{UndoTarget, check_attempts, plugin_error};
use shield_api::{AttemptBatch, Error, Result, SuccessCritic, SuccessCriticInfo, check_finite, check_length};

use crate::CriticEnsemble;

impl SuccessCritic for CriticEnsemble {
    fn info(&self) -> SuccessCriticInfo {
        SuccessCriticInfo { members: self.config.members }
    }

    fn probabilities(
        &mut self,
        observation: &[f32],
        action: &[f32],
        probabilities: &mut [f32],
    ) -> Result<()> {
        self.estimate(observation, action, probabilities, false)
    }

    fn gradients(
        &mut self,
        observation: &[f32],
        action: &[f32],
        probabilities: &mut [f32],
        gradients: &mut [f32],
    ) -> Result<()> {
        if !self.actions.is_continuous() {
            return Err(Error::unsupported("the gradient with respect to a discrete action"));
        }
        check_length("gradients", gradients, self.config.members * self.actions.input_len())?;
        self.estimate(observation, action, probabilities, true)?;
        let rows = gradients.chunks_exact_mut(self.actions.input_len());
        for ((row, answer), probability) in rows.zip(&self.answers).zip(probabilities) {
            // ∂σ(z)/∂a = σ(z) (1 − σ(z)) ∂z/∂a
            let slope = *probability * (1.0 - *probability);
            row.iter_mut().zip(&answer.gradient).for_each(|(to, from)| *to = slope * from);
            self.actions.gradient_to_action(row);
        }
        check_finite_output("the gradients", gradients).map_err(plugin_error)
    }

    fn update(&mut self, batch: &AttemptBatch<'_>) -> Result<()> {
        self.take_batch(batch)?;
        let Self { config, critics, optimiser, buffers, steps, .. } = self;
        let undo = UndoTarget { outcome_weight: config.outcome_weight, discount: config.discount };

        critics.for_each_member(steps, |critic, step| {
            step.begin(batch.size, batch.masks, critic.index(), config.members);
            // tᵢ = 1 in the reset set, 0 where nothing follows, else w o + (1 − w) γ σ(z'ᵢ(s', a')), a' the reset agent's action.
            let next_logits = critic.target_values(&buffers.next_observations, &buffers.next_actions);
            for (row, next_logit) in next_logits.iter().enumerate() {
                step.targets[row] = undo.of(batch, row, sigmoid(*next_logit));
            }

            critic.observe(&buffers.observations);
            let logits = critic.values(&buffers.actions);
            step.mean_value = logits.iter().copied().map(sigmoid).sum::<f32>() / batch.size as f32;
            let (logits, gradients) = critic.outputs();
            step.loss = cross_entropy(logits, &step.targets, &step.weights, gradients);
            critic.backward(&buffers.observations, &buffers.actions);
            // Without any transition of its own a member stays as it is: Adam's moments alone would move it.
            let is_taught = step.weights.iter().any(|weight| *weight > 0.0);
            if is_taught && step.loss.is_finite() {
                critic.step(optimiser, config.tau);
            }
        });
        critics.count_step();

        CriticStep::check(&*steps).map_err(plugin_error)?;
        let (loss, probability) = CriticStep::means(steps.iter());
        let targets = steps.iter().flat_map(|step| &step.targets).copied().map(f64::from);
        self.host.metric("success_loss", loss);
        self.host.metric("probability", probability);
        self.host.metric("target", targets.sum::<f64>() / (batch.size * config.members) as f64);
        Ok(())
    }
}

impl CriticEnsemble {
    fn observation_len(&self) -> usize {
        self.critics.architecture().observation_len()
    }

    /// Writes each member's P(s, a); where asked for, leaves the gradient of its logit in `answers`.
    fn estimate(
        &mut self,
        observation: &[f32],
        action: &[f32],
        probabilities: &mut [f32],
        with_gradients: bool,
    ) -> Result<()> {
        check_finite("observation", observation, self.observation_len())?;
        check_length("probabilities", probabilities, self.config.members)?;
        let buffers = &mut self.buffers;
        self.actions.take_rows("action", action, 1, &mut buffers.action)?;
        Normaliser::take_rows(self.normaliser.as_ref(), observation, &mut buffers.observation);
        self.critics.for_each_member(&mut self.answers, |critic, answer| {
            critic.observe(&buffers.observation);
            answer.logit = critic.values(&buffers.action)[0];
            if with_gradients {
                critic.action_gradients(&mut answer.gradient);
            }
        });
        probabilities.iter_mut().zip(&self.answers).for_each(|(to, answer)| *to = answer.logit);
        check_finite_output("the logits", probabilities).map_err(plugin_error)?;
        probabilities.iter_mut().for_each(|value| *value = sigmoid(*value));
        Ok(())
    }

    /// Checks the whole batch before anything changes, and copies it into the buffers.
    fn take_batch(&mut self, batch: &AttemptBatch<'_>) -> Result<()> {
        check_attempts(batch, self.observation_len(), self.config.members)?;
        let (buffers, size) = (&mut self.buffers, batch.size);
        self.actions.take_rows("actions", batch.actions, size, &mut buffers.actions)?;
        self.actions.take_rows("next_actions", batch.next_actions, size, &mut buffers.next_actions)?;
        if let Some(normaliser) = &mut self.normaliser {
            normaliser.observe(batch.observations);
        }
        let normaliser = self.normaliser.as_ref();
        Normaliser::take_rows(normaliser, batch.observations, &mut buffers.observations);
        Normaliser::take_rows(normaliser, batch.next_observations, &mut buffers.next_observations);
        Ok(())
    }
}
