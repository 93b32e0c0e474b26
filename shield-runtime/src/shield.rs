//! The shield: decides before every action whether it could be undone. It does nothing else: no learning, no files, no printing.
//!
//! Whatever goes wrong on the way to a verdict aborts: a number that is not finite, a wrong length, a plugin that fails.

use std::fmt::Write;

use shield_api::{
    AbortRule, ActMode, Learner, Needs, ObservedDecision, Reason, Result, RuleContext, Spaces, Verdict,
    check_finite,
};

use crate::decision::{Abort, Cause, Decision};

const REASON_CAPACITY: usize = 240;

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

/// Settings of a [`Shield`] beside its rules.
#[derive(Debug, Clone)]
pub struct ShieldSettings {
    /// The spaces of the environment.
    pub spaces: Spaces,
    /// Steps at the beginning during which nothing is aborted.
    pub warm_up_steps: u64,
    /// What the buffer holds after an abort where the reset agent's action is not usable. Must lie in the action space.
    pub fallback_action: Vec<f32>,
}

/// Rules, and the buffers to ask them without allocating.
pub struct Shield {
    rules: Vec<Box<dyn AbortRule>>,
    needs: Needs,
    settings: ShieldSettings,
    discount: f32,
    values: Vec<f32>,
    greedy_values: Vec<f32>,
    greedy_action: Vec<f32>,
    reason: [u8; REASON_CAPACITY],
    reason_length: usize,
}

impl Shield {
    /// A shield over `rules`, for a reset agent like `reset_agent`.
    ///
    /// # Errors
    /// The fallback action lies outside the action space.
    pub fn new(
        rules: Vec<Box<dyn AbortRule>>,
        reset_agent: &dyn Learner,
        settings: ShieldSettings,
    ) -> Result<Self> {
        settings.spaces.action.check_action(&settings.fallback_action)?;
        let info = reset_agent.info();
        let needs = rules.iter().map(|rule| rule.needs()).fold(Needs::default(), |all, one| Needs {
            values: all.values || one.values,
            greedy_values: all.greedy_values || one.greedy_values,
            forward_values: all.forward_values || one.forward_values,
        });
        Ok(Self {
            rules,
            needs,
            discount: info.discount,
            values: vec![f32::NAN; if needs.values { info.members } else { 0 }],
            greedy_values: vec![f32::NAN; if needs.greedy_values { info.members } else { 0 }],
            greedy_action: vec![0.0; settings.spaces.action_len()],
            reason: [0; REASON_CAPACITY],
            reason_length: 0,
            settings,
        })
    }

    /// What some rule wants to be computed. The caller computes the forward values.
    pub fn needs(&self) -> Needs {
        self.needs
    }

    /// Decides on `action` and tells every rule. After an abort, `action` holds the reset agent's greedy action, or the fallback
    /// action where that is not usable: a caller that ignores the decision still never executes what was rejected.
    pub fn filter(
        &mut self,
        reset_agent: &mut dyn Learner,
        moment: &Moment<'_>,
        action: &mut [f32],
    ) -> Decision {
        let mut decision = self.guard(reset_agent, moment, action);
        let observed = ObservedDecision { step: moment.step, aborted: decision.abort().is_some(), action };
        let told = self.rules.iter_mut().try_for_each(|rule| rule.observe(&observed));
        if let (Err(error), None) = (told, decision.abort()) {
            self.explain(&error);
            self.replace(reset_agent, moment.observation, action);
            decision = Decision::Abort(Abort::without_rule(Cause::RuleFailed));
        }
        decision
    }

    /// As [`filter`](Self::filter), but no rule is told: for actions of the reset agent.
    pub fn guard(
        &mut self,
        reset_agent: &mut dyn Learner,
        moment: &Moment<'_>,
        action: &mut [f32],
    ) -> Decision {
        self.reason_length = 0;
        let decision = match self.judge(reset_agent, moment, action) {
            Ok(()) if moment.step < self.settings.warm_up_steps => Decision::WarmUp,
            Ok(()) => Decision::Allow,
            Err(abort) => Decision::Abort(abort),
        };
        if decision.abort().is_some() {
            self.replace(reset_agent, moment.observation, action);
        }
        decision
    }

    /// Why the last action was rejected, for a person; empty if it was not.
    pub fn reason(&self) -> &str {
        std::str::from_utf8(&self.reason[..self.reason_length]).unwrap_or("")
    }

    /// The reset ensemble's values at the last judged action; empty if no rule needs them.
    pub fn values(&self) -> &[f32] {
        &self.values
    }

    fn judge(
        &mut self,
        reset_agent: &mut dyn Learner,
        moment: &Moment<'_>,
        action: &[f32],
    ) -> Result<(), Abort> {
        let spaces = &self.settings.spaces;
        let observation = moment.observation;
        check_finite("the observation", observation, spaces.observation_len())
            .map_err(|error| self.failed(Cause::InvalidObservation, &error))?;
        self.settings
            .spaces
            .action
            .check_action(action)
            .map_err(|error| self.failed(Cause::InvalidAction, &error))?;
        if moment.step < self.settings.warm_up_steps {
            return Ok(());
        }
        self.value(reset_agent, moment, action).map_err(|error| self.failed(Cause::ValuesFailed, &error))?;
        let context = RuleContext {
            step: moment.step,
            observation,
            proposed: action,
            previous: moment.previous,
            values: &self.values,
            greedy_values: &self.greedy_values,
            forward_values: moment.forward_values,
            discount: self.discount,
        };
        for (index, rule) in self.rules.iter().enumerate() {
            let mut reason = Reason::new(&mut self.reason);
            let judged = rule.evaluate(&context, &mut reason);
            self.reason_length = reason.len();
            let (cause, score) = match judged {
                Ok(judged) if judged.score.is_nan() => (Cause::RuleFailed, f32::NAN),
                Ok(judged) if judged.verdict == Verdict::Allow => continue,
                Ok(judged) => (Cause::Rejected, judged.score),
                Err(error) => (self.failed(Cause::RuleFailed, &error).cause, f32::NAN),
            };
            return Err(Abort { cause, rule: Some(index), score });
        }
        self.reason_length = 0;
        Ok(())
    }

    /// Computes what the rules need. Values that are not finite are an error.
    fn value(&mut self, reset_agent: &mut dyn Learner, moment: &Moment<'_>, action: &[f32]) -> Result<()> {
        if self.needs.values {
            reset_agent.q_values(moment.observation, action, &mut self.values)?;
            check_finite("the reset values", &self.values, self.values.len())?;
        }
        if self.needs.greedy_values {
            reset_agent.act(moment.observation, ActMode::Greedy, &mut self.greedy_action)?;
            reset_agent.q_values(moment.observation, &self.greedy_action, &mut self.greedy_values)?;
            check_finite("the reset values", &self.greedy_values, self.greedy_values.len())?;
        }
        check_finite("the forward values", moment.forward_values, moment.forward_values.len())
    }

    fn replace(&mut self, reset_agent: &mut dyn Learner, observation: &[f32], action: &mut [f32]) {
        let spaces = &self.settings.spaces;
        let is_usable = check_finite("the observation", observation, spaces.observation_len())
            .and_then(|()| reset_agent.act(observation, ActMode::Greedy, &mut self.greedy_action))
            .and_then(|()| spaces.action.check_action(&self.greedy_action))
            .is_ok();
        let safe = if is_usable { &self.greedy_action } else { &self.settings.fallback_action };
        // A caller's buffer of the wrong length gets what fits; its action was rejected for that length.
        let length = safe.len().min(action.len());
        action[..length].copy_from_slice(&safe[..length]);
        action[length..].fill(0.0);
    }

    fn failed(&mut self, cause: Cause, error: &shield_api::Error) -> Abort {
        self.explain(error);
        Abort::without_rule(cause)
    }

    fn explain(&mut self, error: &shield_api::Error) {
        let mut reason = Reason::new(&mut self.reason);
        write!(reason, "{error}").ok();
        self.reason_length = reason.len();
    }
}
