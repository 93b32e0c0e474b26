//! What the rules say of an action.

use shield_api::{Error, ErrorKind, Needs, Phase, Reason, Result, RuleContext, Verdict};

use super::{Judgement, Juror, Jury};
use crate::{
    decision::{Abort, Cause},
    shield::{Agents, GivenValues, Moment, explanation::Explanation, rows::RowBuffer},
};

impl Jury {
    /// Values an action and lets every rule judge it. A rejection by rules is explained by them, everything else by its error.
    pub fn judge(
        &mut self,
        agents: &mut Agents<'_>,
        moment: &Moment<'_>,
        action: &[f32],
        why: &mut Explanation,
    ) -> Result<(), Abort> {
        self.value_action(agents, moment, action).map_err(|error| why.failed(Cause::ValuesFailed, &error))?;
        let judged = self.ask_all(moment, action, why);
        let are_missing =
            self.present_needs().greedy_on_rejection && self.present.known_greedy_probabilities().is_empty();
        let Err(Abort { cause: Cause::Rejected, .. }) = judged else { return judged };
        if !are_missing {
            return judged;
        }
        self.value_greedy_action(agents, moment).map_err(|error| why.failed(Cause::ValuesFailed, &error))?;
        self.ask_all(moment, action, why)
    }

    /// Lets every rule judge an action whose values are given, as [`judge`](Self::judge) those that it computes.
    pub fn judge_given(
        &mut self,
        given: &GivenValues<'_>,
        moment: &Moment<'_>,
        action: &[f32],
        why: &mut Explanation,
    ) -> Result<(), Abort> {
        self.take(given).map_err(|error| why.failed(Cause::ValuesFailed, &error))?;
        self.ask_all(moment, action, why)
    }

    fn ask_all(&mut self, moment: &Moment<'_>, action: &[f32], why: &mut Explanation) -> Result<(), Abort> {
        for index in 0..self.jurors.len() {
            if !self.judges(index) {
                self.jurors[index].allows = true;
                continue;
            }
            let failure = self.ask(index, moment, action, why);
            self.present.scores[index] = self.jurors[index].score;
            if let Some(cause) = failure {
                return Err(Abort { cause, rule: Some(index), score: f32::NAN });
            }
        }
        let allows = |rule: usize| self.jurors[rule].allows;
        if self.shape.holds(&allows) {
            why.clear();
            return Ok(());
        }
        Err(self.rejection(why))
    }

    /// Lets one rule judge; returns why it could not. One that fails rejects, whatever a branch beside it says.
    fn ask(
        &mut self,
        index: usize,
        moment: &Moment<'_>,
        action: &[f32],
        why: &mut Explanation,
    ) -> Option<Cause> {
        let context =
            context(&self.present, &self.start_probabilities, self.discount, self.phase, moment, action);
        let juror = &mut self.jurors[index];
        let mut reason = Reason::new(&mut juror.sentence[..]);
        let judged = juror.rule.evaluate(&context, &mut reason);
        juror.sentence_len = reason.len();
        (juror.allows, juror.score) = (false, f32::NAN);
        match judged {
            Ok(judged) if judged.score.is_nan() => {
                why.clear();
                why.append(format_args!("{}: its score is NaN", juror.sentence()));
                Some(Cause::RuleFailed)
            }
            Ok(judged) => {
                (juror.allows, juror.score) = (judged.verdict == Verdict::Allow, judged.score);
                None
            }
            Err(error) => Some(why.failed(Cause::RuleFailed, &error).cause),
        }
    }

    /// Whether the rules that need nothing learned allow an action of the reset agent. What was said of other actions stays.
    pub fn limits_allow(&self, moment: &Moment<'_>, action: &[f32]) -> bool {
        let allows = |rule: usize| {
            let juror: &Juror = &self.jurors[rule];
            let context = context(
                &self.present,
                &self.start_probabilities,
                self.discount,
                Phase::Reset,
                moment,
                action,
            );
            juror.needs.anything_learned()
                || juror
                    .rule
                    .evaluate(&context, &mut Reason::new(&mut []))
                    .is_ok_and(|judged| judged.verdict == Verdict::Allow && !judged.score.is_nan())
        };
        self.shape.holds(&allows)
    }

    fn rejection(&self, why: &mut Explanation) -> Abort {
        let mut first = None;
        why.clear();
        self.shape.blame(&|rule| self.jurors[rule].allows, &mut |rule| {
            let juror = &self.jurors[rule];
            if first.is_some() {
                why.append("; ");
            }
            why.append(juror.sentence());
            first.get_or_insert((rule, juror.score));
        });
        let (rule, score) = first.map_or((None, f32::NAN), |(rule, score)| (Some(rule), score));
        Abort { cause: Cause::Rejected, rule, score }
    }

    /// Collects the rows of some rules around `action`, whose gradients these are: of the values and of the probabilities.
    pub fn linearise(
        &self,
        program: &[usize],
        moment: &Moment<'_>,
        action: &[f32],
        [of_values, of_probabilities]: [&[f32]; 2],
        rows: &mut RowBuffer,
    ) -> Result<(), (Cause, Error)> {
        let context =
            context(&self.present, &self.start_probabilities, self.discount, self.phase, moment, action);
        for juror in program.iter().filter(|index| self.judges(**index)).map(|index| &self.jurors[*index]) {
            let own: &[f32] = match juror.needs {
                Needs { probabilities: true, .. } => of_probabilities,
                Needs { values: true, .. } => of_values,
                _ => &[],
            };
            rows.soften(juror.slack);
            juror.rule.linearise(&context, own, rows).map_err(|error| {
                let is_unable = error.kind() == ErrorKind::Unsupported;
                (if is_unable { Cause::NotLinearisable } else { Cause::RowsFailed }, error)
            })?;
        }
        Ok(())
    }
}

fn context<'a>(
    said: &'a Judgement,
    start_probabilities: &'a [f32],
    discount: f32,
    phase: Phase,
    moment: &Moment<'a>,
    proposed: &'a [f32],
) -> RuleContext<'a> {
    RuleContext {
        step: moment.step,
        observation: moment.observation,
        proposed,
        previous: moment.previous,
        values: &said.values,
        greedy_values: &said.greedy_values,
        forward_values: &said.forward_values,
        probabilities: &said.probabilities,
        greedy_probabilities: said.known_greedy_probabilities(),
        start_probabilities,
        discount,
        phase,
    }
}
