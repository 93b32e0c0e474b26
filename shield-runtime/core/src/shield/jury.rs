//! The rules, and what they need to judge an action.

use shield_api::{
    AbortRule, ActMode, Error, ErrorKind, Learner, Needs, ObservedDecision, Phase, Reason, Result,
    RuleContext, Verdict, check_finite,
};

use super::{
    Agents, GivenValues, Moment,
    explanation::Explanation,
    rows::RowBuffer,
    rules::{RuleTree, Shape},
};
use crate::decision::{Abort, Cause};

/// Room for the sentence of one rule.
const SENTENCE: usize = 256;

/// One rule with what it said last.
struct Juror {
    rule: Box<dyn AbortRule>,
    needs: Needs,
    /// The column of its slack in a projection, and its priority.
    slack: Option<(usize, f32)>,
    allows: bool,
    score: f32,
    sentence: Box<[u8; SENTENCE]>,
    sentence_len: usize,
}

impl Juror {
    fn sentence(&self) -> &str {
        std::str::from_utf8(&self.sentence[..self.sentence_len]).unwrap_or("")
    }
}

/// What the rules were told of an action, and what they said.
#[derive(Debug, Clone, Default)]
pub struct Judgement {
    /// The reset ensemble's values of the action; empty if no rule needs them.
    pub values: Vec<f32>,
    /// The reset ensemble's values of the reset agent's own action; empty if no rule needs them.
    pub greedy_values: Vec<f32>,
    /// The forward ensemble's values of the action; empty if no rule needs them.
    pub forward_values: Vec<f32>,
    /// What each rule compared, in the order of the experiment; NaN where it was not asked.
    pub scores: Vec<f32>,
}

impl Judgement {
    fn forget(&mut self) {
        for numbers in [&mut self.values, &mut self.greedy_values, &mut self.forward_values, &mut self.scores]
        {
            numbers.fill(f32::NAN);
        }
    }

    fn copy_from(&mut self, other: &Self) {
        self.values.clone_from(&other.values);
        self.greedy_values.clone_from(&other.greedy_values);
        self.forward_values.clone_from(&other.forward_values);
        self.scores.clone_from(&other.scores);
    }
}

/// Which rules judge an action.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Scope {
    /// Every rule.
    All,
    /// The rules that need nothing learned: in the warm-up, and of the reset agent's own actions.
    Limits,
}

/// All rules with the buffers to ask them without allocating.
pub(super) struct Jury {
    jurors: Vec<Juror>,
    shape: Shape,
    needs: Needs,
    discount: f32,
    /// Whose action is judged.
    pub phase: Phase,
    scope: Scope,
    /// Whether some rule needs nothing learned.
    has_limits: bool,
    present: Judgement,
    /// Of the action that was proposed.
    proposed: Judgement,
    greedy_action: Vec<f32>,
    /// Of an action that may be executed instead.
    forward_values: Vec<f32>,
}

impl Jury {
    pub fn new(tree: RuleTree, reset_agent: &dyn Learner, action_len: usize) -> Result<Self> {
        let info = reset_agent.info();
        let mut rules = Vec::new();
        let shape = Shape::of(tree, &mut rules)?;
        let mut columns = 0;
        let mut jurors = Vec::with_capacity(rules.len());
        for (rule, priority) in rules {
            let slack = priority.map(|priority| {
                columns += 1;
                (columns - 1, priority)
            });
            let (allows, score, sentence) = (false, f32::NAN, Box::new([0; SENTENCE]));
            jurors.push(Juror { needs: rule.needs(), rule, slack, allows, score, sentence, sentence_len: 0 });
        }
        let needs = jurors.iter().fold(Needs::default(), |all, juror| all.union(juror.needs));
        let has_limits = jurors.iter().any(|juror| !juror.needs.anything_learned());
        let present = Judgement {
            values: vec![f32::NAN; if needs.values { info.members } else { 0 }],
            greedy_values: vec![f32::NAN; if needs.greedy_values { info.members } else { 0 }],
            forward_values: Vec::new(),
            scores: vec![f32::NAN; jurors.len()],
        };
        Ok(Self {
            jurors,
            shape,
            needs,
            discount: info.discount,
            phase: Phase::Forward,
            scope: Scope::All,
            has_limits,
            proposed: present.clone(),
            present,
            greedy_action: vec![0.0; action_len],
            forward_values: Vec::new(),
        })
    }

    pub fn needs(&self) -> Needs {
        self.needs
    }

    /// Whether some rule needs nothing learned, and so holds for every agent from the first step.
    pub fn has_limits(&self) -> bool {
        self.has_limits
    }

    /// What must be computed for the rules that judge now.
    fn present_needs(&self) -> Needs {
        match self.scope {
            Scope::All => self.needs,
            Scope::Limits => Needs::default(),
        }
    }

    fn judges(&self, index: usize) -> bool {
        self.scope == Scope::All || !self.jurors[index].needs.anything_learned()
    }

    /// The priorities of the soft rules, in the order of their columns.
    pub fn priorities(&self) -> impl Iterator<Item = f32> {
        self.jurors.iter().filter_map(|juror| juror.slack.map(|(_, priority)| priority))
    }

    /// Every set of rules that together allow an action.
    pub fn programs(&self) -> Result<Vec<Vec<usize>>> {
        self.shape.programs()
    }

    /// Keeps what was said last as said of the proposed action.
    pub fn note_proposed(&mut self) {
        self.proposed.copy_from(&self.present);
    }

    pub fn proposed(&self) -> &Judgement {
        &self.proposed
    }

    /// Forgets what was said of an earlier action. From now on the rules of this scope judge.
    pub fn begin(&mut self, phase: Phase, scope: Scope) {
        (self.phase, self.scope) = (phase, scope);
        self.present.forget();
        self.proposed.forget();
    }

    /// Computes what the rules need of the state alone, once per decision.
    pub fn value_state(&mut self, agents: &mut Agents<'_>, moment: &Moment<'_>) -> Result<()> {
        if !self.present_needs().greedy_values {
            return Ok(());
        }
        let values = &mut self.present.greedy_values;
        agents.reset.act(moment.observation, ActMode::Greedy, &mut self.greedy_action)?;
        agents.reset.q_values(moment.observation, &self.greedy_action, values)?;
        check_finite("the reset values", values, values.len())
    }

    /// Values an action and lets every rule judge it. A rejection by rules is explained by them, everything else by its error.
    pub fn judge(
        &mut self,
        agents: &mut Agents<'_>,
        moment: &Moment<'_>,
        action: &[f32],
        why: &mut Explanation,
    ) -> Result<(), Abort> {
        self.value_action(agents, moment, action).map_err(|error| why.failed(Cause::ValuesFailed, &error))?;
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

    fn take(&mut self, given: &GivenValues<'_>) -> Result<()> {
        let needs = self.present_needs();
        let Judgement { values, greedy_values, forward_values, .. } = &mut self.present;
        if needs.values {
            check_finite("the reset values", given.values, values.len())?;
            values.copy_from_slice(given.values);
        }
        if needs.greedy_values {
            check_finite("the reset values", given.greedy_values, greedy_values.len())?;
            greedy_values.copy_from_slice(given.greedy_values);
        }
        if needs.forward_values {
            check_finite("the forward values", given.forward_values, given.forward_values.len())?;
            given.forward_values.clone_into(forward_values);
        }
        Ok(())
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
        let context = context(&self.present, self.discount, self.phase, moment, action);
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
            let context = context(&self.present, self.discount, Phase::Reset, moment, action);
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

    fn value_action(&mut self, agents: &mut Agents<'_>, moment: &Moment<'_>, action: &[f32]) -> Result<()> {
        let needs = self.present_needs();
        if needs.values {
            let values = &mut self.present.values;
            agents.reset.q_values(moment.observation, action, values)?;
            check_finite("the reset values", values, values.len())?;
        }
        if let Some(forward) = agents.forward.as_deref_mut().filter(|_| needs.forward_values) {
            let values = &mut self.present.forward_values;
            values.resize(forward.info().members, f32::NAN);
            forward.q_values(moment.observation, action, values)?;
            check_finite("the forward values", values, values.len())?;
        }
        Ok(())
    }

    /// The mean of the forward ensemble's values of an action.
    pub fn forward_mean(
        &mut self,
        agents: &mut Agents<'_>,
        moment: &Moment<'_>,
        action: &[f32],
    ) -> Result<f32> {
        let Some(forward) = agents.forward.as_deref_mut() else {
            return Err(Error::failed("the forward agent is a policy, which values nothing"));
        };
        let values = &mut self.forward_values;
        values.resize(forward.info().members, f32::NAN);
        forward.q_values(moment.observation, action, values)?;
        check_finite("the forward values", values, values.len())?;
        Ok((values.iter().copied().map(f64::from).sum::<f64>() / values.len() as f64) as f32)
    }

    /// Computes ∂Q/∂action of each member at `action` into `gradients`, if some rule needs the values.
    pub fn differentiate(
        &mut self,
        agents: &mut Agents<'_>,
        moment: &Moment<'_>,
        action: &[f32],
        gradients: &mut [f32],
    ) -> Result<()> {
        if !self.present_needs().values {
            return Ok(());
        }
        let values = &mut self.present.values;
        agents.reset.q_gradients(moment.observation, action, values, gradients)?;
        check_finite("the reset values", values, values.len())?;
        check_finite("the gradients", gradients, gradients.len())
    }

    /// Collects the rows of some rules around `action`, whose gradients these are.
    pub fn linearise(
        &self,
        program: &[usize],
        moment: &Moment<'_>,
        action: &[f32],
        gradients: &[f32],
        rows: &mut RowBuffer,
    ) -> Result<(), (Cause, Error)> {
        let context = context(&self.present, self.discount, self.phase, moment, action);
        for juror in program.iter().filter(|index| self.judges(**index)).map(|index| &self.jurors[*index]) {
            let own: &[f32] = if juror.needs.values { gradients } else { &[] };
            rows.soften(juror.slack);
            juror.rule.linearise(&context, own, rows).map_err(|error| {
                let is_unable = error.kind() == ErrorKind::Unsupported;
                (if is_unable { Cause::NotLinearisable } else { Cause::RowsFailed }, error)
            })?;
        }
        Ok(())
    }

    pub fn observe(&mut self, decision: &ObservedDecision<'_>) -> Result<()> {
        // Every rule is told, whatever another answers.
        self.jurors.iter_mut().map(|juror| juror.rule.observe(decision)).fold(Ok(()), Result::and)
    }

    /// The rules themselves, in the order of the experiment, for their states.
    pub fn rules(&mut self) -> impl Iterator<Item = &mut dyn AbortRule> {
        self.jurors.iter_mut().map(|juror| &mut *juror.rule as &mut dyn AbortRule)
    }
}

fn context<'a>(
    said: &'a Judgement,
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
        discount,
        phase,
        ..RuleContext::default()
    }
}
