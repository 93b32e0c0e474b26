//! Estimating and learning.

use learner_kit::{UndoTarget, check_attempts};
use shield_api::{AttemptBatch, Error, Result, SuccessCritic, SuccessCriticInfo, check_length};

use crate::{SuccessTables, Transition};

impl SuccessCritic for SuccessTables {
    fn info(&self) -> SuccessCriticInfo {
        SuccessCriticInfo { members: self.config.members }
    }

    fn probabilities(
        &mut self,
        observation: &[f32],
        action: &[f32],
        probabilities: &mut [f32],
    ) -> Result<()> {
        let cell = self.cell("observation", observation, action)?;
        check_length("probabilities", probabilities, self.config.members)?;
        let tables = self.tables.chunks_exact(self.states * self.actions);
        probabilities.iter_mut().zip(tables).for_each(|(to, table)| *to = table[cell]);
        Ok(())
    }

    fn update(&mut self, batch: &AttemptBatch<'_>) -> Result<()> {
        self.take_batch(batch)?;
        let (config, cells) = (&self.config, self.states * self.actions);
        let undo = UndoTarget { outcome_weight: config.outcome_weight, discount: config.discount };
        let (mut squares, mut learned) = (0.0_f64, 0.0_f64);
        let (mut probabilities, mut targets) = (0.0_f64, 0.0_f64);
        let members = self.tables.chunks_exact_mut(cells).zip(self.visits.chunks_exact_mut(cells));
        for (member, (table, visits)) in members.enumerate() {
            for (row, transition) in self.transitions.iter().enumerate() {
                // P(s, a) ← P(s, a) + m α (t − P(s, a)), where t is 1 in the reset set, 0 where nothing follows, else
                // w o + (1 − w) γ P(s', a'), a' the reset agent's action; α = 1/(n + 2): what P began with counts as a visit.
                let target = undo.of(batch, row, table[transition.next_cell]);
                let mask = batch.masks[row * config.members + member];
                let (value, visits) = (&mut table[transition.cell], &mut visits[transition.cell]);
                let error = target - *value;
                probabilities += f64::from(*value);
                targets += f64::from(target);
                squares += f64::from(mask * error * error);
                learned += f64::from(mask);
                let step = mask * (1.0 / (*visits + 2.0)).max(config.least_step);
                // The bounds are for what rounding adds.
                *value = step.mul_add(error, *value).clamp(0.0, 1.0);
                *visits += mask;
            }
        }
        let count = (config.members * batch.size) as f64;
        self.host.metric("success_loss", if learned > 0.0 { 0.5 * squares / learned } else { 0.0 });
        self.host.metric("probability", probabilities / count);
        self.host.metric("target", targets / count);
        Ok(())
    }
}

impl SuccessTables {
    /// Where a table has P of one (s, a), s being one-hot.
    fn cell(&self, what: &str, observation: &[f32], action: &[f32]) -> Result<usize> {
        check_length(what, observation, self.states)?;
        let refused = || Error::invalid_argument(format!("{what} is not one-hot: {observation:?}"));
        let state = observation.iter().position(|value| *value != 0.0).ok_or_else(refused)?;
        let is_one_hot =
            observation[state] == 1.0 && observation[state + 1..].iter().all(|value| *value == 0.0);
        if is_one_hot { Ok(state * self.actions + self.space.action_index(action)?) } else { Err(refused()) }
    }

    /// Checks the whole batch before anything changes, and keeps it as places in a table.
    fn take_batch(&mut self, batch: &AttemptBatch<'_>) -> Result<()> {
        check_attempts(batch, self.states, self.config.members)?;
        check_length("actions", batch.actions, batch.size)?;
        check_length("next_actions", batch.next_actions, batch.size)?;
        self.transitions.clear();
        let rows = batch.observations.chunks_exact(self.states).zip(batch.actions.chunks_exact(1));
        let next_rows =
            batch.next_observations.chunks_exact(self.states).zip(batch.next_actions.chunks_exact(1));
        for ((observation, action), (next_observation, next_action)) in rows.zip(next_rows) {
            self.transitions.push(Transition {
                cell: self.cell("observations", observation, action)?,
                next_cell: self.cell("next_observations", next_observation, next_action)?,
            });
        }
        Ok(())
    }
}
