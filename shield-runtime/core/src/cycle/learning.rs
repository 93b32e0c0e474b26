//! What follows a step: it is stored, and the agents learn.

use shield_api::{Error, Result, StepOutcome};

use super::{CycleParts, CycleSettings, Memory, ResetCycle};
use crate::{
    decision::Cause,
    events::{EpisodeEnd, Tally},
    experience::{AgentRole, AgentShare, Fate, Transition},
    settings::Updates,
};

impl ResetCycle {
    /// The action of [`decide`](Self::decide) or [`act_to_reset`](Self::act_to_reset) was executed and led to `next_observation`: stores the
    /// step and lets the agents learn. Returns why the episode ends, if it does.
    ///
    /// # Errors
    /// Nothing was decided, or a learner failed.
    pub fn observe(&mut self, next_observation: &[f32], outcome: &StepOutcome) -> Result<Option<EpisodeEnd>> {
        if !std::mem::take(&mut self.is_pending) {
            return Err(Error::failed("nothing was decided: each step begins with a decision"));
        }
        let mut tally = self.episode.unwrap_or_default();
        tally += outcome;
        // A caller may also report what came of a fallback action, outside of any episode.
        self.episode = self.episode.map(|_| tally);
        let is_forward = self.turn == AgentRole::Forward && !self.since_reset.stays;
        self.counters.forward_steps += u64::from(is_forward);
        if self.is_shielded() {
            let role = if is_forward { AgentRole::Forward } else { AgentRole::Reset };
            self.diagnosis.step(role, outcome, &self.metrics);
        }
        let has_failed =
            self.turn == AgentRole::Reset && self.is_last(&tally) && !self.passes_reset_test(&tally);
        self.store(next_observation, outcome, has_failed);
        self.learn()?;
        Ok(self.end_of(&tally, outcome))
    }

    fn end_of(&self, tally: &Tally, outcome: &StepOutcome) -> Option<EpisodeEnd> {
        let is_attempt = self.turn == AgentRole::Reset;
        if outcome.terminated {
            Some(EpisodeEnd::Terminated)
        } else if is_attempt && self.settings.stop_on_reset && outcome.in_reset_set {
            Some(EpisodeEnd::ResetSet)
        } else {
            self.is_last(tally).then_some(EpisodeEnd::TimeLimit)
        }
    }

    fn is_last(&self, tally: &Tally) -> bool {
        let limit = match self.turn {
            AgentRole::Forward => self.settings.forward_length,
            AgentRole::Reset => Some(self.attempt_length()),
        };
        limit.is_some_and(|limit| tally.length >= limit)
    }

    pub(super) fn passes_reset_test(&self, tally: &Tally) -> bool {
        self.settings.reset_test.is_passed(tally.visited_reset_set, tally.is_in_reset_set)
    }

    /// Stores the step for both agents. `has_failed`: it was the last one of a failed attempt.
    fn store(&mut self, next_observation: &[f32], outcome: &StepOutcome, has_failed: bool) {
        let StepOutcome { in_reset_set, terminated, .. } = *outcome;
        let mut number = None;
        if let Some(Memory { experience, masks }) = &mut self.parts.memory {
            let forward = AgentShare { reward: outcome.forward_reward, continues: !terminated };
            let reset = AgentShare {
                reward: outcome.reset_reward,
                continues: self.settings.endings.reset_continues(in_reset_set, terminated, has_failed),
            };
            let transition = Transition {
                observation: &self.observation,
                action: &self.action,
                next_observation,
                forward: self.settings.stores_forward.then_some(forward),
                reset: Some(reset),
                fate: Some(Fate::of(outcome)),
            };
            number = Some(experience.next_number());
            experience.push(&transition, masks);
        }
        self.since_reset.note(self.turn, number, outcome);
        self.previous.copy_from_slice(&self.action);
        self.has_previous = true;
        self.counters.steps += 1;
        self.counters.lifetime_return += f64::from(outcome.forward_reward);
        self.counters.irreversible_entries += u64::from(outcome.irreversible && !self.was_irreversible);
        self.was_irreversible = outcome.irreversible;
    }

    fn learn(&mut self) -> Result<()> {
        let CycleSettings { updates, updates_per_step, update_every, .. } = self.settings;
        if !self.counters.steps.is_multiple_of(update_every.max(1)) {
            return Ok(());
        }
        let reset_updates = self.settings.reset_updates();
        let learns = |role| self.turn == role || updates == Updates::Both;
        let CycleParts { forward, reset, success, memory: Some(Memory { experience, .. }), .. } =
            &mut self.parts
        else {
            return Ok(());
        };
        if let Some(forward) = forward.as_mut().filter(|_| learns(AgentRole::Forward)) {
            forward.learn(experience, updates_per_step)?;
        }
        if let Some(reset) = reset.as_mut().filter(|_| learns(AgentRole::Reset)) {
            reset.learn(experience, reset_updates)?;
        }
        if let (Some(success), Some(reset)) = (success, reset) {
            success.learn(experience, reset.learner(), reset_updates)?;
        }
        Ok(())
    }

    /// Lets the forward agent learn from the action that a rule rejected. What failed is not the fault of its action.
    pub(super) fn store_abort(&mut self, cause: Cause) {
        let Some(reward) = self.settings.on_abort.reward().filter(|_| !cause.is_failure()) else { return };
        let Some(Memory { experience, masks }) = &mut self.parts.memory else { return };
        let transition = Transition {
            observation: &self.observation,
            action: &self.proposed,
            next_observation: &self.observation,
            forward: Some(AgentShare { reward, continues: false }),
            reset: None,
            fate: None,
        };
        experience.push(&transition, masks);
    }
}
