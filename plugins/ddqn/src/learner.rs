//! Acting, valuing and learning.

use actor_critic::{Normaliser, check_finite_output, write_tensors};
use learner_kit::{CriticReport, check_batch, plugin_error};
use rand::RngExt;
use shield_api::{ActMode, Batch, Learner, LearnerInfo, Result, check_finite, check_length};

use crate::{Ddqn, MemberStep};

impl Learner for Ddqn {
    fn info(&self) -> LearnerInfo {
        LearnerInfo { members: self.config.members, discount: self.config.discount }
    }

    fn act(&mut self, observation: &[f32], mode: ActMode, action: &mut [f32]) -> Result<()> {
        check_finite("observation", observation, self.observation_len())?;
        check_length("action", action, 1)?;
        let is_random = mode == ActMode::Explore && {
            let epsilon = self.epsilon.at(self.explored);
            self.explored += 1;
            self.rng.random::<f32>() < epsilon
        };
        let index = if is_random {
            self.rng.random_range(0..self.buffers.sums.len())
        } else {
            self.best_action(observation)?
        };
        action[0] = index as f32;
        Ok(())
    }

    fn q_values(&mut self, observation: &[f32], action: &[f32], values: &mut [f32]) -> Result<()> {
        check_finite("observation", observation, self.observation_len())?;
        let action = self.actions.action_index(action)?;
        check_length("values", values, self.config.members)?;
        self.answer(observation);
        for (value, answer) in values.iter_mut().zip(&self.answers) {
            *value = answer[action];
        }
        check_finite_output("the values", values).map_err(plugin_error)
    }

    fn weights(&self, bytes: &mut Vec<u8>) -> Result<()> {
        let mut tensors = self.networks.tensors("values", false);
        tensors.extend(self.normaliser.iter().flat_map(|normaliser| normaliser.tensors()));
        write_tensors(&tensors, bytes).map_err(plugin_error)
    }

    fn update(&mut self, batch: &Batch<'_>) -> Result<()> {
        self.take_batch(batch)?;
        let Self { config, networks, buffers, steps, .. } = self;
        let actions = buffers.sums.len();

        networks.for_each_member(steps, |network, step| {
            let MemberStep { critic: step, next_actions, values, gradients } = step;
            step.begin(batch.size, batch.masks, network.index(), config.members);
            // yᵢ = r + γ c Q'ᵢ(s', argmax Qᵢ(s', ·)): the network chooses, its target network values.
            network.observe(&buffers.next_observations);
            next_actions.clear();
            next_actions.extend(network.values(&[]).chunks_exact(actions).map(largest));
            let next_values = network.target_values(&buffers.next_observations, &[]);
            for (row, next_values) in next_values.chunks_exact(actions).enumerate() {
                let bootstrap = config.discount * batch.continuations[row] * next_values[next_actions[row]];
                step.targets[row] = batch.rewards[row] + bootstrap;
            }

            network.observe(&buffers.observations);
            let outputs = network.values(&[]).chunks_exact(actions);
            values.clear();
            values.extend(outputs.zip(&buffers.chosen).map(|(outputs, action)| outputs[*action]));
            step.mean_value = values.iter().sum::<f32>() / batch.size as f32;
            gradients.resize(batch.size, 0.0);
            step.loss = config.loss.evaluate(values, &step.targets, &step.weights, gradients);

            // Only the executed actions' outputs have a gradient.
            let (_, output_gradients) = network.outputs();
            output_gradients.fill(0.0);
            let rows = output_gradients.chunks_exact_mut(actions);
            for ((row, action), gradient) in rows.zip(&buffers.chosen).zip(gradients) {
                row[*action] = *gradient;
            }
            network.backward(&buffers.observations, &[]);
            if step.loss.is_finite() {
                network.clipped_step(config.gradient_clip, &self.optimiser, config.tau);
            }
        });
        networks.count_step();
        CriticReport::of(steps.iter().map(|step| &step.critic))?.send(&self.host);
        Ok(())
    }
}

impl Ddqn {
    fn observation_len(&self) -> usize {
        self.networks.architecture().observation_len()
    }

    /// Writes Qᵢ(s, ·) of every member into `answers`.
    fn answer(&mut self, observation: &[f32]) {
        let seen = &mut self.buffers.observation;
        Normaliser::take_rows(self.normaliser.as_ref(), observation, seen);
        self.networks.for_each_member(&mut self.answers, |network, answer| {
            network.observe(seen);
            answer.copy_from_slice(network.values(&[]));
        });
    }

    /// The action whose values have the largest mean over the members; of equal ones the first.
    fn best_action(&mut self, observation: &[f32]) -> Result<usize> {
        self.answer(observation);
        let sums = &mut self.buffers.sums;
        sums.fill(0.0);
        for answer in &self.answers {
            sums.iter_mut().zip(answer).for_each(|(sum, value)| *sum += value);
        }
        check_finite_output("the values", sums).map_err(plugin_error)?;
        Ok(largest(sums))
    }

    /// Checks the whole batch before anything changes, and copies it into the buffers.
    fn take_batch(&mut self, batch: &Batch<'_>) -> Result<()> {
        check_length("actions", batch.actions, batch.size)?;
        check_batch(batch, self.observation_len(), self.config.members)?;
        self.buffers.chosen.clear();
        for action in batch.actions.chunks_exact(1) {
            self.buffers.chosen.push(self.actions.action_index(action)?);
        }

        if let Some(normaliser) = &mut self.normaliser {
            normaliser.observe(batch.observations);
        }
        let (buffers, normaliser) = (&mut self.buffers, self.normaliser.as_ref());
        Normaliser::take_rows(normaliser, batch.observations, &mut buffers.observations);
        Normaliser::take_rows(normaliser, batch.next_observations, &mut buffers.next_observations);
        Ok(())
    }
}

/// The index of the largest value; of equal ones the first.
pub(crate) fn largest(values: &[f32]) -> usize {
    let later = |best: usize, index: usize| if values[index] > values[best] { index } else { best };
    (0..values.len()).fold(0, later)
}
