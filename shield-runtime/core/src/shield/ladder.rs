//! The decision ladder: allow, else project, else abort.

use std::time::Duration;

use shield_api::{
    AbortRule, ActMode, Learner, Needs, ObservedAttempt, ObservedDecision, Phase, Spaces, check_finite,
};

use super::{
    Agents, GivenValues, Moment,
    clock::Clock,
    explanation::Explanation,
    jury::{Judgement, Jury, Scope},
    projection::Projector,
    rejected::Rejected,
};
use crate::decision::{Abort, Cause, Decision, Projection};

/// Settings of a [`Ladder`] beside its rules.
#[derive(Debug, Clone)]
pub struct LadderSettings {
    /// The spaces of the environment.
    pub spaces: Spaces,
    /// Steps at the beginning during which rules that need learned values are not asked; undo probabilities are none.
    pub warm_up_steps: u64,
    /// What the buffer holds after an abort where the reset agent's action is not usable. Must lie in the action space.
    pub fallback_action: Vec<f32>,
}

/// Rules, what is tried before an abort, and the buffers to decide without allocating. It decides and does nothing else: no learning, no
/// files, no printing. Whatever goes wrong on the way to a verdict aborts.
pub struct Ladder {
    pub(super) jury: Jury,
    /// Of the reset agent and of the success critic.
    pub(super) members: [usize; 2],
    pub(super) projector: Option<Projector>,
    pub(super) deadline: Option<Duration>,
    pub(super) settings: LadderSettings,
    pub(super) other_action: Vec<f32>,
    pub(super) why: Explanation,
    /// No rule is told of anything.
    pub(super) is_frozen: bool,
}

impl Ladder {
    /// What some rule wants to be computed.
    pub fn needs(&self) -> Needs {
        self.jury.needs()
    }

    /// Whether every decision computes all that a record of it holds, also what no rule needs to allow it.
    pub fn be_thorough(&mut self, is_thorough: bool) {
        self.jury.be_thorough(is_thorough);
    }

    /// Decides on `action` and tells every rule. After a projection, `action` holds the projected one. After an abort it holds the reset
    /// agent's greedy action, or the fallback action where that is not usable: a caller that ignores the decision still never executes
    /// what was rejected.
    pub fn filter(&mut self, mut agents: Agents<'_>, moment: &Moment<'_>, action: &mut [f32]) -> Decision {
        let clock = Clock::start(self.deadline);
        let scope = self.forward_scope(moment);
        let decision = self.decide(&mut agents, moment, action, Phase::Forward, scope, clock);
        self.conclude(decision, &mut agents, moment, action, clock)
    }

    /// Decides where the forward agent gave no action: an abort of which every rule is told.
    pub fn forward_failed(
        &mut self,
        mut agents: Agents<'_>,
        moment: &Moment<'_>,
        error: &shield_api::Error,
        action: &mut [f32],
    ) -> Decision {
        let clock = Clock::start(self.deadline);
        self.jury.begin(Phase::Forward, Scope::All);
        self.jury.note_proposed();
        let decision = Decision::Abort(self.why.failed(Cause::ForwardFailed, error));
        self.make_safe(agents.reset, moment, action);
        self.conclude(decision, &mut agents, moment, action, clock)
    }

    /// Tells every rule of a decision. A rule that does not take note, or takes too long, makes it an abort.
    fn conclude(
        &mut self,
        mut decision: Decision,
        agents: &mut Agents<'_>,
        moment: &Moment<'_>,
        action: &mut [f32],
        clock: Clock,
    ) -> Decision {
        let observed = ObservedDecision { step: moment.step, aborted: decision.abort().is_some(), action };
        let told = if self.is_frozen { Ok(()) } else { self.jury.observe(&observed) };
        if let Err(error) = told {
            decision = Decision::Abort(self.why.failed(Cause::RuleFailed, &error));
            self.why.is_final = true;
            self.make_safe(agents.reset, moment, action);
        } else if decision.abort().is_none() && clock.is_late() {
            // The rules took too long to take note of it.
            decision = self.late();
            self.make_safe(agents.reset, moment, action);
        }
        decision
    }

    /// Decides on `action` by values that were computed before, and tells every rule. Nothing is projected.
    pub fn judge_given(&mut self, given: &GivenValues<'_>, moment: &Moment<'_>, action: &[f32]) -> Decision {
        self.why.clear();
        let scope = self.forward_scope(moment);
        self.jury.begin(Phase::Forward, scope);
        let decision = self
            .check_proposal(moment, action)
            .and_then(|()| self.jury.judge_given(given, moment, action, &mut self.why))
            .map_or_else(Decision::Abort, |()| allowed(scope));
        let observed = ObservedDecision { step: moment.step, aborted: decision.abort().is_some(), action };
        match self.jury.observe(&observed) {
            Ok(()) => decision,
            Err(error) => Decision::Abort(self.why.failed(Cause::RuleFailed, &error)),
        }
    }

    /// Decides on an exploratory action of the reset agent by every rule; none is told. A rejected one is not projected: the agent's greedy
    /// action takes its place.
    pub fn guard(&mut self, mut agents: Agents<'_>, moment: &Moment<'_>, action: &mut [f32]) -> Decision {
        let clock = Clock::start(self.deadline);
        let scope = self.forward_scope(moment);
        self.decide(&mut agents, moment, action, Phase::Reset, scope, clock)
    }

    /// Decides on any action of the reset agent by the rules that need nothing learned, which hold for every agent; none is told. `None` if there
    /// is no such rule.
    pub fn limit(
        &mut self,
        mut agents: Agents<'_>,
        moment: &Moment<'_>,
        action: &mut [f32],
    ) -> Option<Decision> {
        if !self.jury.has_limits() {
            return None;
        }
        let clock = Clock::start(self.deadline);
        Some(self.decide(&mut agents, moment, action, Phase::Reset, Scope::Limits, clock))
    }

    /// Which rules judge the forward agent's actions now.
    fn forward_scope(&self, moment: &Moment<'_>) -> Scope {
        let is_warm_up = moment.step < self.settings.warm_up_steps && self.jury.has_warm_up();
        if is_warm_up { Scope::WarmUp } else { Scope::All }
    }

    /// Whether an action of the reset agent may be executed at all; no rule is asked.
    ///
    /// # Errors
    /// The observation is not finite or of the wrong length, or the action is not one of the space.
    pub fn check(&self, moment: &Moment<'_>, action: &[f32]) -> shield_api::Result<()> {
        let spaces = &self.settings.spaces;
        check_finite("the observation", moment.observation, spaces.observation_len())?;
        spaces.action.check_action(action)
    }

    /// An abort without anyone being asked; the buffer holds the fallback action.
    pub fn refuse(&mut self, cause: Cause, action: &mut [f32]) -> Decision {
        self.jury.begin(Phase::Forward, Scope::All);
        self.why.forget();
        if !self.why.is_final {
            self.why.append(match cause {
                Cause::AwaitsHardReset => "a hard reset must come first",
                _ => "the shield was not asked",
            });
        }
        write_safe(&self.settings.fallback_action, action);
        Decision::Abort(Abort::without_rule(cause))
    }

    /// An abort because the reset agent failed; the buffer holds the fallback action.
    pub fn reset_failed(&mut self, error: &shield_api::Error, action: &mut [f32]) -> Decision {
        self.jury.begin(Phase::Forward, Scope::All);
        write_safe(&self.settings.fallback_action, action);
        Decision::Abort(self.why.failed(Cause::ResetFailed, error))
    }

    /// Forgets why an earlier action was rejected.
    pub fn forget_reason(&mut self) {
        self.why.forget();
    }

    /// The spaces of the environment.
    pub fn spaces(&self) -> &Spaces {
        &self.settings.spaces
    }

    /// What a buffer holds where nothing better can be executed.
    pub fn fallback_action(&self) -> &[f32] {
        &self.settings.fallback_action
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

    /// What the rules were told of the action that was proposed last, and what they compared; NaN where it did not come to that.
    pub fn judgement(&self) -> &Judgement {
        self.jury.proposed()
    }

    /// Nothing has to be undone: the reset set was reached, or a hard reset is done. The next decision is measured against its own state.
    pub fn begin_cycle(&mut self) {
        self.jury.begin_cycle();
    }

    /// The undo probabilities where the last reset ended, to be kept; `None` before the first decision since then.
    pub fn start_probabilities(&self) -> Option<&[f32]> {
        self.jury.start_probabilities()
    }

    /// Goes on from what [`start_probabilities`](Self::start_probabilities) gave.
    pub fn go_on_from(&mut self, start_probabilities: Option<&[f32]>) {
        self.jury.go_on_from(start_probabilities);
    }

    /// Whether rules are told of decisions and attempts, or stay as they are.
    pub(crate) fn freeze(&mut self, is_frozen: bool) {
        self.is_frozen = is_frozen;
    }

    /// Tells every rule how an attempt ended. If one fails, nothing is decided any more.
    pub fn observe_attempt(&mut self, attempt: &ObservedAttempt) {
        if self.is_frozen {
            return;
        }
        if let Err(error) = self.jury.observe_attempt(attempt) {
            self.why.failed(Cause::RuleFailed, &error);
            self.why.is_final = true;
        }
    }

    /// The rules in the order of the experiment, to keep their states.
    pub fn rules(&mut self) -> impl Iterator<Item = &mut dyn AbortRule> {
        self.jury.rules()
    }

    fn decide(
        &mut self,
        agents: &mut Agents<'_>,
        moment: &Moment<'_>,
        action: &mut [f32],
        phase: Phase,
        scope: Scope,
        clock: Clock,
    ) -> Decision {
        self.why.clear();
        self.jury.begin(phase, scope);
        let judged = self.judge(agents, moment, action);
        self.jury.note_proposed();
        let is_projected = phase == Phase::Forward || scope == Scope::Limits;
        let mut decision = match judged {
            Ok(()) => allowed(scope),
            Err(rejection) if is_projected && rejection.cause == Cause::Rejected => self
                .project(agents, moment, action, rejection, clock)
                .map_or_else(Decision::Abort, Decision::Project),
            Err(abort) => Decision::Abort(abort),
        };
        if decision.abort().is_none() && clock.is_late() {
            decision = self.late();
        }
        match decision {
            Decision::Project(_) => action.copy_from_slice(&self.other_action),
            Decision::Abort(_) => self.make_safe(agents.reset, moment, action),
            Decision::Allow | Decision::WarmUp | Decision::Resetting => {}
        }
        decision
    }

    fn late(&mut self) -> Decision {
        self.why.append("the decision took longer than its deadline");
        Decision::Abort(Abort::without_rule(Cause::Deadline))
    }

    fn judge(&mut self, agents: &mut Agents<'_>, moment: &Moment<'_>, action: &[f32]) -> Result<(), Abort> {
        self.check_proposal(moment, action)?;
        self.jury
            .value_state(agents, moment)
            .map_err(|error| self.why.failed(Cause::ValuesFailed, &error))?;
        self.jury.judge(agents, moment, action, &mut self.why)
    }

    fn check_proposal(&mut self, moment: &Moment<'_>, action: &[f32]) -> Result<(), Abort> {
        let spaces = &self.settings.spaces;
        check_finite("the observation", moment.observation, spaces.observation_len())
            .map_err(|error| self.why.failed(Cause::InvalidObservation, &error))?;
        spaces.action.check_action(action).map_err(|error| self.why.failed(Cause::InvalidAction, &error))
    }

    /// Looks for another action that the rules allow; it is then in `other_action`.
    fn project(
        &mut self,
        agents: &mut Agents<'_>,
        moment: &Moment<'_>,
        proposed: &[f32],
        rejection: Abort,
        clock: Clock,
    ) -> Result<Projection, Abort> {
        let Some(projector) = &mut self.projector else { return Err(rejection) };
        let jury = &mut self.jury;
        let rejected = Rejected { jury, agents, moment, proposed, rejection, clock };
        let found = projector.find(rejected, &mut self.other_action).and_then(|projection| {
            let checked = self.settings.spaces.action.check_action(&self.other_action);
            checked.map(|()| projection).map_err(|error| (Cause::InvalidAction, error.to_string()))
        });
        found.map_err(|(cause, why)| {
            self.why.append(format_args!("; not projected: {why}"));
            Abort { cause, ..rejection }
        })
    }

    /// Writes the reset agent's greedy action, or the fallback action where that is not usable or breaks a limit.
    fn make_safe(&mut self, reset_agent: &mut dyn Learner, moment: &Moment<'_>, action: &mut [f32]) {
        let observation = moment.observation;
        let spaces = &self.settings.spaces;
        let is_usable = check_finite("the observation", observation, spaces.observation_len())
            .and_then(|()| reset_agent.act(observation, ActMode::Greedy, &mut self.other_action))
            .and_then(|()| spaces.action.check_action(&self.other_action))
            .is_ok()
            && self.jury.limits_allow(moment, &self.other_action);
        let safe = if is_usable { &self.other_action } else { &self.settings.fallback_action };
        write_safe(safe, action);
    }
}

/// What it is called that the rules of a scope allow an action.
fn allowed(scope: Scope) -> Decision {
    match scope {
        Scope::All | Scope::Limits => Decision::Allow,
        Scope::WarmUp => Decision::WarmUp,
    }
}

/// A caller's buffer of the wrong length gets what fits; its action was rejected for that length.
pub fn write_safe(safe: &[f32], action: &mut [f32]) {
    let length = safe.len().min(action.len());
    action[..length].copy_from_slice(&safe[..length]);
    action[length..].fill(0.0);
}
