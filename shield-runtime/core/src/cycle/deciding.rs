//! Proposing, deciding and acting.

use shield_api::{ActMode, Error, ErrorKind, Result};

use super::{CycleParts, ResetCycle};
use crate::{
    agent::ForwardAgent,
    critic::Critic,
    decision::{Cause, Decision},
    shield::{Agents, Moment},
};

impl ResetCycle {
    /// The forward agent proposes an action. If it fails where a shield decides, [`decide`](Self::decide) aborts.
    ///
    /// # Errors
    /// There is no forward agent, it panicked, or it failed where no shield could abort.
    pub fn propose(&mut self, observation: &[f32]) -> Result<()> {
        let CycleParts { forward, ladder, .. } = &mut self.parts;
        let forward = forward.as_mut().ok_or_else(|| Error::failed("there is no forward agent"))?;
        self.failure = forward.act(observation, ActMode::Explore, &mut self.action).err();
        match &self.failure {
            None => {}
            // A panicked plugin never acts again; any other failure may pass, and must not be executed meanwhile.
            Some(error) if ladder.is_none() || error.kind() == ErrorKind::Panicked => {
                return Err(error.clone());
            }
            Some(_) => self.action.fill(f32::NAN),
        }
        self.proposed.copy_from_slice(&self.action);
        Ok(())
    }

    /// The caller proposes an action, of the right length.
    pub fn take_proposal(&mut self, action: &[f32]) {
        self.failure = None;
        self.proposed.copy_from_slice(action);
        self.action.copy_from_slice(action);
    }

    /// Decides on the proposed action; [`action`](Self::action) is then what may be executed. An abort ends the forward episode, and the
    /// reset agent's turn comes.
    pub fn decide(&mut self, observation: &[f32]) -> Decision {
        self.observation.copy_from_slice(observation);
        self.is_pending = true;
        self.since_reset.stays = false;
        let CycleParts { forward, reset, success, ladder, .. } = &mut self.parts;
        let (Some(ladder), Some(reset)) = (ladder, reset) else { return Decision::Allow };
        if ladder.is_broken() {
            self.is_pending = false;
            return ladder.refuse(Cause::RuleFailed, &mut self.action);
        }
        if self.hard_reset_due.is_some() {
            return ladder.refuse(Cause::AwaitsHardReset, &mut self.action);
        }
        let moment = Moment {
            step: self.counters.steps,
            observation,
            previous: self.has_previous.then_some(&self.previous),
        };
        let forward = forward.as_mut().and_then(ForwardAgent::learner);
        let success = success.as_mut().map(Critic::critic);
        let agents = Agents { reset: reset.learner(), forward, success };
        let decision = match self.failure.take() {
            Some(error) => ladder.forward_failed(agents, &moment, &error, &mut self.action),
            None => ladder.filter(agents, &moment, &mut self.action),
        };
        self.is_pending = !ladder.is_broken();
        self.count(decision);
        decision
    }

    fn count(&mut self, decision: Decision) {
        self.counters.warm_up_decisions += u64::from(decision == Decision::WarmUp);
        self.counters.projections += u64::from(decision.projection().is_some());
        self.diagnosis.decided(decision.abort().is_none());
        // A shield that cannot decide any more has not aborted: it has ended.
        let Some(abort) = decision.abort().filter(|_| !self.is_broken()) else { return };
        self.counters.early_aborts += 1;
        self.counters.failed_closed += u64::from(abort.cause.is_failure());
    }

    /// The reset agent acts. Rules that need nothing learned judge its action, and every rule where its exploration is shielded; a rejected one
    /// gives way to a projected one, to its greedy one or to the fallback action, and the decision says so.
    ///
    /// # Errors
    /// There is no reset agent, or it gave no action of the action space.
    pub fn act_to_reset(&mut self, observation: &[f32]) -> Result<Option<Decision>> {
        self.observation.copy_from_slice(observation);
        self.is_pending = true;
        self.since_reset.stays = false;
        self.proposed.fill(f32::NAN);
        let is_greedy = self.look_ahead(observation)?;
        let CycleParts { forward, reset, success, ladder, .. } = &mut self.parts;
        let reset = reset.as_mut().ok_or_else(no_reset_agent)?;
        if self.settings.explores {
            reset.learner().act(observation, ActMode::Explore, &mut self.action)?;
        } else if !is_greedy {
            reset.learner().act(observation, ActMode::Greedy, &mut self.action)?;
        }
        self.proposed.copy_from_slice(&self.action);
        let Some(ladder) = ladder else { return Ok(None) };
        let moment = Moment {
            step: self.counters.steps,
            observation,
            previous: self.has_previous.then_some(&self.previous),
        };
        let forward = forward.as_mut().and_then(ForwardAgent::learner);
        let success = success.as_mut().map(Critic::critic);
        let agents = Agents { reset: reset.learner(), forward, success };
        let decision = if self.settings.explores && self.settings.shield_exploration {
            ladder.guard(agents, &moment, &mut self.action)
        } else {
            ladder.check(&moment, &self.action)?;
            match ladder.limit(agents, &moment, &mut self.action) {
                None | Some(Decision::Allow) => return Ok(None),
                Some(decision) => decision,
            }
        };
        self.counters.exploration_replaced += u64::from(decision.abort().is_some());
        Ok(Some(decision))
    }

    /// The reset agent failed in [`act_to_reset`](Self::act_to_reset), and a caller executes whatever [`action`](Self::action) holds: the
    /// fallback action takes its place.
    pub fn reset_failed(&mut self, error: &Error) -> Decision {
        let Some(ladder) = &mut self.parts.ladder else { return Decision::Resetting };
        self.counters.failed_closed += 1;
        ladder.reset_failed(error, &mut self.action)
    }

    /// Forgets why an earlier action was rejected.
    pub fn forget_reason(&mut self) {
        if let Some(ladder) = &mut self.parts.ladder {
            ladder.forget_reason();
        }
    }

    /// Refuses an action without asking anybody; [`action`](Self::action) is then the fallback action.
    pub fn refuse(&mut self, cause: Cause) -> Decision {
        self.is_pending = false;
        match &mut self.parts.ladder {
            Some(ladder) => ladder.refuse(cause, &mut self.action),
            None => Decision::Allow,
        }
    }
}

fn no_reset_agent() -> Error {
    Error::failed("there is no reset agent")
}
