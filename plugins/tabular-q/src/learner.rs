//! Acting, valuing and learning.

use rand::RngExt;
use shield_api::{ActMode, Batch, Error, Learner, LearnerInfo, Result, check_finite, check_length};

use crate::{TabularQ, Transition};

impl Learner for TabularQ {
    fn info(&self) -> LearnerInfo {
        LearnerInfo { members: self.config.members, discount: self.config.discount }
    }

    fn act(&mut self, observation: &[f32], mode: ActMode, action: &mut [f32]) -> Result<()> {
        let state = self.state("observation", observation)?;
        check_length("action", action, 1)?;
        let is_random = mode == ActMode::Explore && {
            let epsilon = self.config.epsilon_at(self.explored);
            self.explored += 1;
            self.rng.random::<f32>() < epsilon
        };
        let index = if is_random { self.rng.random_range(0..self.actions) } else { self.best_action(state) };
        action[0] = index as f32;
        Ok(())
    }

    fn q_values(&mut self, observation: &[f32], action: &[f32], values: &mut [f32]) -> Result<()> {
        let state = self.state("observation", observation)?;
        let action = self.action("action", action)?;
        check_length("values", values, self.config.members)?;
        for (value, table) in values.iter_mut().zip(self.tables.chunks_exact(self.states * self.actions)) {
            *value = table[state + action];
        }
        Ok(())
    }

    fn update(&mut self, batch: &Batch<'_>) -> Result<()> {
        self.take_batch(batch)?;
        let (members, actions, discount) = (self.config.members, self.actions, self.config.discount);
        let (mut loss, mut learned, mut sum) = (0.0_f64, 0.0_f64, 0.0_f64);
        let tables = self.tables.chunks_exact_mut(self.states * actions);
        for (member, table) in tables.enumerate() {
            for (row, transition) in self.transitions.iter().enumerate() {
                // Q(s, a) ← Q(s, a) + α m (r + γ c max Q(s', ·) − Q(s, a))
                let next_values = &table[transition.next_state..transition.next_state + actions];
                let next_value = next_values.iter().copied().fold(f32::NEG_INFINITY, f32::max);
                let target = batch.rewards[row] + discount * batch.continuations[row] * next_value;
                let mask = batch.masks[row * members + member];
                let value = &mut table[transition.state + transition.action];
                let error = target - *value;
                *value += self.config.learning_rate * mask * error;
                loss += f64::from(mask * error * error);
                learned += f64::from(mask);
                sum += f64::from(*value);
            }
        }
        if !sum.is_finite() {
            return Err(Error::failed("a value has left the range of f32"));
        }
        self.host.metric("critic_loss", if learned > 0.0 { 0.5 * loss / learned } else { 0.0 });
        self.host.metric("q_mean", sum / (members * batch.size) as f64);
        Ok(())
    }
}

impl TabularQ {
    /// The action whose values have the largest mean over the members; of equal ones the first.
    fn best_action(&self, state: usize) -> usize {
        let mut best = (0, f32::NEG_INFINITY);
        for action in 0..self.actions {
            let values = self.tables[state + action..].iter().step_by(self.states * self.actions);
            let sum: f32 = values.sum();
            if sum > best.1 {
                best = (action, sum);
            }
        }
        best.0
    }

    /// Offset of a one-hot state's values in a table.
    fn state(&self, what: &str, observation: &[f32]) -> Result<usize> {
        check_length(what, observation, self.states)?;
        let refused = || Error::invalid_argument(format!("{what} is not one-hot: {observation:?}"));
        let index = observation.iter().position(|value| *value != 0.0).ok_or_else(refused)?;
        let is_one_hot =
            observation[index] == 1.0 && observation[index + 1..].iter().all(|value| *value == 0.0);
        if is_one_hot { Ok(index * self.actions) } else { Err(refused()) }
    }

    fn action(&self, what: &str, action: &[f32]) -> Result<usize> {
        check_finite(what, action, 1)?;
        let index = action[0];
        let is_exact = index >= 0.0 && index.fract() == 0.0 && (index as usize) < self.actions;
        if is_exact {
            Ok(index as usize)
        } else {
            Err(Error::invalid_argument(format!("{what} {index} is not an index below {}", self.actions)))
        }
    }

    /// Checks the whole batch before anything changes, and keeps it as indices.
    fn take_batch(&mut self, batch: &Batch<'_>) -> Result<()> {
        let size = batch.size;
        if size == 0 {
            return Err(Error::invalid_argument("the batch is empty"));
        }
        check_length("observations", batch.observations, size * self.states)?;
        check_length("actions", batch.actions, size)?;
        check_finite("rewards", batch.rewards, size)?;
        check_length("next_observations", batch.next_observations, size * self.states)?;
        check_unit("continuations", batch.continuations, size)?;
        check_unit("masks", batch.masks, size * self.config.members)?;
        self.transitions.clear();
        let observations = batch.observations.chunks_exact(self.states);
        let next_observations = batch.next_observations.chunks_exact(self.states);
        for ((observation, next_observation), action) in
            observations.zip(next_observations).zip(batch.actions.chunks_exact(1))
        {
            self.transitions.push(Transition {
                state: self.state("observations", observation)?,
                action: self.action("actions", action)?,
                next_state: self.state("next_observations", next_observation)?,
            });
        }
        Ok(())
    }
}

fn check_unit(what: &str, values: &[f32], expected: usize) -> Result<()> {
    check_length(what, values, expected)?;
    match values.iter().position(|value| !(0.0..=1.0).contains(value)) {
        None => Ok(()),
        Some(index) => {
            Err(Error::invalid_argument(format!("{what}[{index}] is {}, outside [0, 1]", values[index])))
        }
    }
}
