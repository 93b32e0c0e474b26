//! The rules, and what they need to judge an action.

use shield_api::{
    AbortRule, ActMode, Error, Learner, Needs, ObservedDecision, Phase, Result, Rows, RuleContext, Verdict,
    check_finite,
};

use super::{Moment, explanation::Explanation};
use crate::decision::{Abort, Cause};

/// All rules with the buffers to ask them without allocating.
pub(super) struct Jury {
    rules: Vec<Box<dyn AbortRule>>,
    needs: Vec<Needs>,
    all_needs: Needs,
    discount: f32,
    /// Whose action is judged.
    pub phase: Phase,
    values: Vec<f32>,
    greedy_values: Vec<f32>,
    greedy_action: Vec<f32>,
}

impl Jury {
    pub fn new(rules: Vec<Box<dyn AbortRule>>, reset_agent: &dyn Learner, action_len: usize) -> Self {
        let info = reset_agent.info();
        let needs: Vec<Needs> = rules.iter().map(|rule| rule.needs()).collect();
        let all_needs = needs.iter().fold(Needs::default(), |all, one| Needs {
            values: all.values || one.values,
            greedy_values: all.greedy_values || one.greedy_values,
            forward_values: all.forward_values || one.forward_values,
        });
        Self {
            rules,
            needs,
            all_needs,
            discount: info.discount,
            phase: Phase::Forward,
            values: vec![f32::NAN; if all_needs.values { info.members } else { 0 }],
            greedy_values: vec![f32::NAN; if all_needs.greedy_values { info.members } else { 0 }],
            greedy_action: vec![0.0; action_len],
        }
    }

    pub fn needs(&self) -> Needs {
        self.all_needs
    }

    pub fn values(&self) -> &[f32] {
        &self.values
    }

    /// Computes what the rules need of the state alone, once per decision.
    pub fn value_state(&mut self, reset_agent: &mut dyn Learner, moment: &Moment<'_>) -> Result<()> {
        if self.all_needs.greedy_values {
            reset_agent.act(moment.observation, ActMode::Greedy, &mut self.greedy_action)?;
            reset_agent.q_values(moment.observation, &self.greedy_action, &mut self.greedy_values)?;
            check_finite("the reset values", &self.greedy_values, self.greedy_values.len())?;
        }
        check_finite("the forward values", moment.forward_values, moment.forward_values.len())
    }

    /// Values an action and lets every rule judge it. A rejection by a rule is explained by the rule, everything else by its error.
    pub fn judge(
        &mut self,
        reset_agent: &mut dyn Learner,
        moment: &Moment<'_>,
        action: &[f32],
        why: &mut Explanation,
    ) -> Result<(), Abort> {
        if self.all_needs.values {
            let valued = reset_agent.q_values(moment.observation, action, &mut self.values);
            valued
                .and_then(|()| check_finite("the reset values", &self.values, self.values.len()))
                .map_err(|error| why.failed(Cause::ValuesFailed, &error))?;
        }
        let context = self.context(moment, action);
        for (index, rule) in self.rules.iter().enumerate() {
            let judged = why.write(|reason| rule.evaluate(&context, reason));
            let (cause, score) = match judged {
                Ok(judged) if judged.score.is_nan() => (Cause::RuleFailed, f32::NAN),
                Ok(judged) if judged.verdict == Verdict::Allow => continue,
                Ok(judged) => (Cause::Rejected, judged.score),
                Err(error) => (why.failed(Cause::RuleFailed, &error).cause, f32::NAN),
            };
            return Err(Abort { cause, rule: Some(index), score });
        }
        why.clear();
        Ok(())
    }

    /// Collects the rows of every rule around `action`. `gradients` holds ∂Q/∂action of each member there.
    pub fn linearise(
        &mut self,
        reset_agent: &mut dyn Learner,
        moment: &Moment<'_>,
        action: &[f32],
        gradients: &mut [f32],
        rows: &mut dyn Rows,
    ) -> Result<(), (Cause, Error)> {
        if self.all_needs.values {
            let valued = reset_agent.q_gradients(moment.observation, action, &mut self.values, gradients);
            valued
                .and_then(|()| check_finite("the reset values", &self.values, self.values.len()))
                .and_then(|()| check_finite("the gradients", gradients, gradients.len()))
                .map_err(|error| (Cause::GradientsFailed, error))?;
        }
        let context = self.context(moment, action);
        for (rule, needs) in self.rules.iter().zip(&self.needs) {
            let own: &[f32] = if needs.values { gradients } else { &[] };
            rule.linearise(&context, own, rows).map_err(|error| {
                let is_unable = error.kind() == shield_api::ErrorKind::Unsupported;
                (if is_unable { Cause::NotLinearisable } else { Cause::RowsFailed }, error)
            })?;
        }
        Ok(())
    }

    pub fn observe(&mut self, decision: &ObservedDecision<'_>) -> Result<()> {
        // Every rule is told, whatever another answers.
        self.rules.iter_mut().map(|rule| rule.observe(decision)).fold(Ok(()), Result::and)
    }

    fn context<'a>(&'a self, moment: &Moment<'a>, proposed: &'a [f32]) -> RuleContext<'a> {
        RuleContext {
            step: moment.step,
            observation: moment.observation,
            proposed,
            previous: moment.previous,
            values: &self.values,
            greedy_values: &self.greedy_values,
            forward_values: moment.forward_values,
            discount: self.discount,
            phase: self.phase,
        }
    }
}
