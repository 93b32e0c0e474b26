//! The rules, and what they say of an action.

mod asking;
mod judgement;
mod valuing;

pub use judgement::Judgement;

use shield_api::{AbortRule, Error, Learner, Needs, ObservedAttempt, ObservedDecision, Phase, Result};

use super::rules::{RuleTree, Shape};
use crate::controller::check_needs;

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

/// Which rules judge an action.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Scope {
    /// Every rule.
    All,
    /// The rules that need no learned values: in the warm-up.
    WarmUp,
    /// The rules that need nothing learned: of the reset agent's own actions.
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
    /// Where the last reset ended: the success critic's estimates for the reset agent's own action.
    start_probabilities: Vec<f32>,
    /// Nothing was decided since the last reset.
    is_at_start: bool,
    /// The estimates for the reset agent's own action are computed for every decision, also where no rule needs them.
    is_thorough: bool,
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
        for (index, (rule, priority)) in rules.into_iter().enumerate() {
            check_needs(rule.needs(), info)
                .map_err(|error| Error::invalid_config(format!("rule {index}: {}", error.message())))?;
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
            probabilities: Vec::new(),
            greedy_probabilities: Vec::new(),
            start_probabilities: Vec::new(),
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
            start_probabilities: Vec::new(),
            is_at_start: true,
            is_thorough: false,
            greedy_action: vec![0.0; action_len],
            forward_values: Vec::new(),
        })
    }

    pub fn needs(&self) -> Needs {
        self.needs
    }

    /// Makes room for the estimates of a success critic with so many members.
    pub fn expect_probabilities(&mut self, members: usize) {
        let room = |is_needed: bool| vec![f32::NAN; if is_needed { members } else { 0 }];
        for judgement in [&mut self.present, &mut self.proposed] {
            judgement.probabilities = room(self.needs.probabilities);
            judgement.greedy_probabilities = room(self.needs.any_greedy_probabilities());
            judgement.start_probabilities = room(self.needs.any_greedy_probabilities());
        }
        self.start_probabilities = room(self.needs.any_greedy_probabilities());
    }

    /// Whether the estimates for the reset agent's own action are computed for every decision.
    pub fn be_thorough(&mut self, is_thorough: bool) {
        self.is_thorough = is_thorough;
    }

    /// The estimates of the next decision are those of the start.
    pub fn begin_cycle(&mut self) {
        self.is_at_start = true;
    }

    /// The estimates at the start; `None` before the first decision since the last reset.
    pub fn start_probabilities(&self) -> Option<&[f32]> {
        (!self.is_at_start).then_some(&self.start_probabilities)
    }

    /// Goes on from estimates at the start that were kept, of as many members.
    pub fn go_on_from(&mut self, start_probabilities: Option<&[f32]>) {
        let kept = start_probabilities.filter(|start| start.len() == self.start_probabilities.len());
        self.is_at_start = kept.is_none();
        if let Some(start) = kept {
            self.start_probabilities.copy_from_slice(start);
        }
    }

    /// Whether some rule needs nothing learned, and so holds for every agent from the first step.
    pub fn has_limits(&self) -> bool {
        self.has_limits
    }

    /// What must be computed for the rules that judge now.
    fn present_needs(&self) -> Needs {
        match self.scope {
            Scope::All => self.needs,
            Scope::WarmUp => Needs {
                probabilities: self.needs.probabilities,
                greedy_probabilities: self.needs.greedy_probabilities,
                greedy_on_rejection: self.needs.greedy_on_rejection,
                ..Needs::default()
            },
            Scope::Limits => Needs::default(),
        }
    }

    fn judges(&self, index: usize) -> bool {
        let needs = self.jurors[index].needs;
        match self.scope {
            Scope::All => true,
            Scope::WarmUp => !learned_values(needs),
            Scope::Limits => !needs.anything_learned(),
        }
    }

    /// Whether some rule is not asked in the warm-up.
    pub fn has_warm_up(&self) -> bool {
        learned_values(self.needs)
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
        if self.scope != Scope::Limits && !self.is_at_start {
            self.proposed.start_probabilities.copy_from_slice(&self.start_probabilities);
        }
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

    pub fn observe(&mut self, decision: &ObservedDecision<'_>) -> Result<()> {
        // Every rule is told, whatever another answers.
        self.jurors.iter_mut().map(|juror| juror.rule.observe(decision)).fold(Ok(()), Result::and)
    }

    /// Tells every rule how an attempt ended.
    pub fn observe_attempt(&mut self, attempt: &ObservedAttempt) -> Result<()> {
        self.jurors.iter_mut().map(|juror| juror.rule.observe_attempt(attempt)).fold(Ok(()), Result::and)
    }

    /// The rules themselves, in the order of the experiment, for their states.
    pub fn rules(&mut self) -> impl Iterator<Item = &mut dyn AbortRule> {
        self.jurors.iter_mut().map(|juror| &mut *juror.rule as &mut dyn AbortRule)
    }
}

fn learned_values(needs: Needs) -> bool {
    needs.values || needs.greedy_values || needs.forward_values
}
