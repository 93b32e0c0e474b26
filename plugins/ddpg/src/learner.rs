//! Acting, valuing and learning.

use rand::RngExt;
use shield_api::{ActMode, Batch, Error, Learner, LearnerInfo, Result, check_finite, check_length};

use crate::Ddpg;

impl Learner for Ddpg {
    fn info(&self) -> LearnerInfo {
        LearnerInfo { members: self.config.critics, discount: self.config.discount }
    }

    fn act(&mut self, observation: &[f32], mode: ActMode, action: &mut [f32]) -> Result<()> {
        check_finite("observation", observation, self.observation_len())?;
        check_length("action", action, self.scale.len())?;
        let unit = &mut self.buffers.action;
        unit.resize(action.len(), 0.0);
        if mode == ActMode::Explore && self.noise.step() < self.config.random_steps {
            self.noise.skip();
            unit.fill_with(|| self.rng.random_range(-1.0..=1.0));
        } else {
            self.buffers.take_observation(observation, self.normaliser.as_ref());
            let mut actor = self.actor.member(0);
            actor.observe(&self.buffers.observation);
            self.buffers.action.copy_from_slice(actor.values(&[]));
            if mode == ActMode::Explore {
                self.noise.disturb(&mut self.buffers.action, &mut self.rng);
            }
        }
        all_finite("the actor's output", &self.buffers.action)?;
        self.scale.from_unit(&self.buffers.action, action);
        Ok(())
    }

    fn q_values(&mut self, observation: &[f32], action: &[f32], values: &mut [f32]) -> Result<()> {
        check_length("values", values, self.config.critics)?;
        self.value(observation, action, false)?;
        for (value, valuation) in values.iter_mut().zip(&self.valuations) {
            *value = valuation.value;
        }
        all_finite("the values", values)
    }

    fn q_gradients(
        &mut self,
        observation: &[f32],
        action: &[f32],
        values: &mut [f32],
        gradients: &mut [f32],
    ) -> Result<()> {
        let action_len = self.scale.len();
        check_length("values", values, self.config.critics)?;
        check_length("gradients", gradients, self.config.critics * action_len)?;
        self.value(observation, action, true)?;
        let rows = gradients.chunks_exact_mut(action_len);
        for ((value, gradient), valuation) in values.iter_mut().zip(rows).zip(&self.valuations) {
            *value = valuation.value;
            gradient.copy_from_slice(&valuation.gradient);
            self.scale.gradient_to_box(gradient);
        }
        all_finite("the values", values)?;
        all_finite("the gradients", gradients)
    }

    fn update(&mut self, batch: &Batch<'_>) -> Result<()> {
        self.check_batch(batch)?;
        self.take_batch(batch);
        let Self { config, actor, critics, buffers, critic_steps, .. } = self;
        let clip = config.gradient_clip;

        // π'(s') for the critics' targets; π(s) for the actor's ascent.
        let mut actor_member = actor.member(0);
        buffers.next_actions.copy_from_slice(actor_member.target_values(&buffers.next_observations, &[]));
        actor_member.observe(&buffers.observations);
        buffers.policy_actions.copy_from_slice(actor_member.values(&[]));

        critics.for_each_member(critic_steps, |critic, step| {
            // yᵢ = r + γ c Q'ᵢ(s', π'(s'))
            let member = critic.index();
            let next_values = critic.target_values(&buffers.next_observations, &buffers.next_actions);
            for (row, next_value) in next_values.iter().enumerate() {
                let bootstrap = config.discount * batch.continuations[row] * next_value;
                step.targets[row] = batch.rewards[row] + bootstrap;
                step.weights[row] = batch.masks[row * config.critics + member];
            }
            critic.observe(&buffers.observations);
            step.mean_value = critic.values(&buffers.actions).iter().sum::<f32>() / batch.size as f32;
            let (values, gradients) = critic.outputs();
            step.loss = config.loss.evaluate(values, &step.targets, &step.weights, gradients);
            critic.backward(&buffers.observations, &buffers.actions);

            // ∂Qᵢ/∂a at π(s), with the weights before their step: the observation's share is computed once.
            critic.values(&buffers.policy_actions);
            critic.action_gradients(&mut step.action_gradients);
            if let Some(longest) = clip {
                critic.clip_gradient(longest);
            }
            if step.loss.is_finite() {
                critic.step(&self.critic_optimiser, config.tau);
            }
        });
        critics.count_step();
        if let Some(broken) = critic_steps.iter().position(|step| !step.loss.is_finite()) {
            return Err(Error::failed(format!(
                "the loss of critic {broken} is {}",
                critic_steps[broken].loss
            )));
        }

        // The actor ascends the mean of the ensemble's values, over the batch.
        let share = 1.0 / (batch.size * config.critics) as f32;
        let (_, gradients) = actor_member.outputs();
        gradients.fill(0.0);
        for step in critic_steps.iter() {
            for (gradient, ascent) in gradients.iter_mut().zip(&step.action_gradients) {
                *gradient -= share * ascent;
            }
        }
        actor_member.backward(&buffers.observations, &[]);
        let actor_gradient = actor_member.gradient_norm();
        if !actor_gradient.is_finite() {
            return Err(Error::failed(format!("the actor's gradient is {actor_gradient}")));
        }
        if let Some(longest) = clip {
            actor_member.clip_gradient(longest);
        }
        actor_member.step(&self.actor_optimiser, config.tau);
        actor.count_step();
        self.report(actor_gradient);
        Ok(())
    }
}

impl Ddpg {
    fn observation_len(&self) -> usize {
        self.critics.architecture().observation_len()
    }

    /// Values one (s, a) by every critic, into `valuations`.
    fn value(&mut self, observation: &[f32], action: &[f32], with_gradients: bool) -> Result<()> {
        check_finite("observation", observation, self.observation_len())?;
        check_finite("action", action, self.scale.len())?;
        self.buffers.take_observation(observation, self.normaliser.as_ref());
        self.buffers.take_action(action, &self.scale);
        let buffers = &self.buffers;
        self.critics.for_each_member(&mut self.valuations, |critic, valuation| {
            critic.observe(&buffers.observation);
            valuation.value = critic.values(&buffers.action)[0];
            if with_gradients {
                critic.action_gradients(&mut valuation.gradient);
            }
        });
        Ok(())
    }

    fn check_batch(&self, batch: &Batch<'_>) -> Result<()> {
        let size = batch.size;
        if size == 0 {
            return Err(Error::invalid_argument("the batch is empty"));
        }
        check_finite("observations", batch.observations, size * self.observation_len())?;
        check_finite("actions", batch.actions, size * self.scale.len())?;
        check_finite("rewards", batch.rewards, size)?;
        check_finite("next_observations", batch.next_observations, size * self.observation_len())?;
        check_unit("continuations", batch.continuations, size)?;
        check_unit("masks", batch.masks, size * self.config.critics)
    }

    /// Copies the batch into the buffers, scaled; the observations' statistics take it in first.
    fn take_batch(&mut self, batch: &Batch<'_>) {
        if let Some(normaliser) = &mut self.normaliser {
            normaliser.observe(batch.observations);
        }
        self.buffers.take_batch(batch, &self.scale, self.normaliser.as_ref());
        for step in &mut self.critic_steps {
            step.resize(batch.size, self.scale.len());
        }
    }

    fn report(&self, actor_gradient: f32) {
        let mean = |of: fn(&crate::CriticStep) -> f32| {
            let sum: f64 = self.critic_steps.iter().map(|step| f64::from(of(step))).sum();
            sum / self.critic_steps.len() as f64
        };
        self.host.metric("critic_loss", mean(|step| step.loss));
        self.host.metric("q_mean", mean(|step| step.mean_value));
        self.host.metric("actor_gradient_norm", f64::from(actor_gradient));
    }
}

fn check_unit(what: &str, values: &[f32], expected: usize) -> Result<()> {
    check_finite(what, values, expected)?;
    match values.iter().position(|value| !(0.0..=1.0).contains(value)) {
        None => Ok(()),
        Some(index) => {
            Err(Error::invalid_argument(format!("{what}[{index}] is {}, outside [0, 1]", values[index])))
        }
    }
}

/// The networks' own output: what is not finite there is a failure of the learner, not of an argument.
fn all_finite(what: &str, values: &[f32]) -> Result<()> {
    match values.iter().position(|value| !value.is_finite()) {
        None => Ok(()),
        Some(index) => Err(Error::failed(format!("{what} are not finite: [{index}] is {}", values[index]))),
    }
}
