//! The shield: decides before every action whether it could be undone. It does nothing else: no learning, no files, no printing.
//!
//! Allow, else project, else abort. Whatever goes wrong on the way to a verdict aborts: a number that is not finite, a wrong length, a
//! plugin or solver that fails, a missed deadline.

mod clock;
mod explanation;
mod jury;
mod projection;
mod rows;
mod setup;
pub mod solver;

pub use setup::ShieldSettings;

use std::time::Duration;

use shield_api::{ActMode, Learner, Needs, ObservedDecision, Phase, check_finite};

use self::{
    clock::Clock,
    explanation::Explanation,
    jury::Jury,
    projection::{Attempt, Projector},
};
use crate::decision::{Abort, Cause, Decision, Projection};

/// What the shield is told of the moment in which an action is proposed.
#[derive(Debug, Clone, Copy)]
pub struct Moment<'a> {
    /// Environment steps so far, both phases.
    pub step: u64,
    /// The present observation.
    pub observation: &'a [f32],
    /// The action executed before; `None` after a hard reset.
    pub previous: Option<&'a [f32]>,
    /// The forward ensemble's values of the proposed action; empty for a policy, or if [`Shield::needs`] says no.
    pub forward_values: &'a [f32],
}

/// Rules, what is tried before an abort, and the buffers to decide without allocating.
pub struct Shield {
    jury: Jury,
    members: usize,
    projector: Option<Projector>,
    deadline: Option<Duration>,
    settings: ShieldSettings,
    other_action: Vec<f32>,
    why: Explanation,
}

impl Shield {
    /// What some rule wants to be computed. The caller computes the forward values.
    pub fn needs(&self) -> Needs {
        self.jury.needs()
    }

    /// Decides on `action` and tells every rule. After a projection, `action` holds the projected one. After an abort it holds the reset
    /// agent's greedy action, or the fallback action where that is not usable: a caller that ignores the decision still never executes
    /// what was rejected.
    pub fn filter(
        &mut self,
        reset_agent: &mut dyn Learner,
        moment: &Moment<'_>,
        action: &mut [f32],
    ) -> Decision {
        let mut decision = self.decide(reset_agent, moment, action, Phase::Forward);
        let observed = ObservedDecision { step: moment.step, aborted: decision.abort().is_some(), action };
        let told = self.jury.observe(&observed);
        if let Err(error) = told {
            decision = Decision::Abort(self.why.failed(Cause::RuleFailed, &error));
            self.why.is_final = true;
            self.make_safe(reset_agent, moment.observation, action);
        }
        decision
    }

    /// As [`filter`](Self::filter), but no rule is told and nothing is projected: for actions of the reset agent.
    pub fn guard(
        &mut self,
        reset_agent: &mut dyn Learner,
        moment: &Moment<'_>,
        action: &mut [f32],
    ) -> Decision {
        self.decide(reset_agent, moment, action, Phase::Reset)
    }

    /// Whether a plugin that the shield needs panicked, or a rule did not take note of a decision: from then on every decision would be an
    /// abort for the wrong reason, and a run must end.
    pub fn is_broken(&self) -> bool {
        self.why.is_final
    }

    /// Why the last action was rejected, for a person; empty if it was not.
    pub fn reason(&self) -> &str {
        self.why.text()
    }

    /// The reset ensemble's values at the action that was judged last; empty if no rule needs them.
    pub fn values(&self) -> &[f32] {
        self.jury.values()
    }

    fn decide(
        &mut self,
        reset_agent: &mut dyn Learner,
        moment: &Moment<'_>,
        action: &mut [f32],
        phase: Phase,
    ) -> Decision {
        let clock = Clock::start(self.deadline);
        self.why.clear();
        self.jury.phase = phase;
        let mut decision = match self.judge(reset_agent, moment, action) {
            Ok(()) if moment.step < self.settings.warm_up_steps => Decision::WarmUp,
            Ok(()) => Decision::Allow,
            Err(rejection) if phase == Phase::Forward && rejection.cause == Cause::Rejected => self
                .project(reset_agent, moment, action, rejection, clock)
                .map_or_else(Decision::Abort, Decision::Project),
            Err(abort) => Decision::Abort(abort),
        };
        if clock.is_late() && decision.abort().is_none() {
            self.why.append("the decision took longer than its deadline");
            decision = Decision::Abort(Abort::without_rule(Cause::Deadline));
        }
        match decision {
            Decision::Allow | Decision::WarmUp => {}
            Decision::Project(_) => action.copy_from_slice(&self.other_action),
            Decision::Abort(_) => self.make_safe(reset_agent, moment.observation, action),
        }
        decision
    }

    fn judge(
        &mut self,
        reset_agent: &mut dyn Learner,
        moment: &Moment<'_>,
        action: &[f32],
    ) -> Result<(), Abort> {
        let spaces = &self.settings.spaces;
        check_finite("the observation", moment.observation, spaces.observation_len())
            .map_err(|error| self.why.failed(Cause::InvalidObservation, &error))?;
        spaces.action.check_action(action).map_err(|error| self.why.failed(Cause::InvalidAction, &error))?;
        if moment.step < self.settings.warm_up_steps {
            return Ok(());
        }
        self.jury
            .value_state(reset_agent, moment)
            .map_err(|error| self.why.failed(Cause::ValuesFailed, &error))?;
        self.jury.judge(reset_agent, moment, action, &mut self.why)
    }

    /// Looks for another action that every rule allows; it is then in `other_action`.
    fn project(
        &mut self,
        reset_agent: &mut dyn Learner,
        moment: &Moment<'_>,
        proposed: &[f32],
        rejection: Abort,
        clock: Clock,
    ) -> Result<Projection, Abort> {
        let Some(projector) = &mut self.projector else { return Err(rejection) };
        let jury = &mut self.jury;
        let attempt = Attempt { jury, reset_agent, moment, proposed, rejection, clock };
        let found = projector.find(attempt, &mut self.other_action).and_then(|projection| {
            let checked = self.settings.spaces.action.check_action(&self.other_action);
            checked.map(|()| projection).map_err(|error| (Cause::InvalidAction, error.to_string()))
        });
        found.map_err(|(cause, why)| {
            self.why.append(format_args!("; not projected: {why}"));
            Abort { cause, ..rejection }
        })
    }

    fn make_safe(&mut self, reset_agent: &mut dyn Learner, observation: &[f32], action: &mut [f32]) {
        let spaces = &self.settings.spaces;
        let is_usable = check_finite("the observation", observation, spaces.observation_len())
            .and_then(|()| reset_agent.act(observation, ActMode::Greedy, &mut self.other_action))
            .and_then(|()| spaces.action.check_action(&self.other_action))
            .is_ok();
        let safe = if is_usable { &self.other_action } else { &self.settings.fallback_action };
        // A caller's buffer of the wrong length gets what fits; its action was rejected for that length.
        let length = safe.len().min(action.len());
        action[..length].copy_from_slice(&safe[..length]);
        action[length..].fill(0.0);
    }
}
