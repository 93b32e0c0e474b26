//! An abort rule: an action is executed only if the reset agent could probably undo it. How probably follows from the risk that the user accepts.
#![forbid(unsafe_code)]

mod risk;
mod words;

use rule_kit::{Combine, Differences, Row, explain, require_probabilities};
use shield_api::{
    AbortRule, Checkpoint, Error, Host, Needs, ObservedAttempt, ObservedDecision, Plugin, Reason, Result,
    Rows, RuleContext, RuleVerdict, Setup, check_finite,
};

use crate::{
    risk::{Adaptation, History},
    words::TooFew,
};

shield_api::config! {
    /// Settings of the rule.
    pub struct Config {
        /// The share of attempts to reset that may fail, between 0 and 1. None: 0.2, unless hard_resets_per_1000 is set.
        accepted_risk: Option<f32> = None,
        /// Instead of a share, a budget: how many attempts may fail per 1,000 environment steps. Each of them costs a hard reset.
        hard_resets_per_1000: Option<f32> = None,
        /// How the members' probabilities become one: Optimistic (the largest), Realist (the mean), Pessimistic (the smallest),
        /// Quantile(q) (0 is the smallest, 1 the largest) or KOfN(k) (so many members must agree).
        combine: Combine = Combine::Pessimistic => "Pessimistic",
        /// The threshold follows the outcomes of attempts, so that the accepted risk is kept (Gibbs and Candès 2021).
        adapt: bool = true,
        /// η: how far one outcome moves the threshold.
        adaptation_rate: f32 = 0.05,
        /// The threshold before the first attempt, and the least after one that failed; without adaptation, for ever. None: 1 − accepted_risk, or
        /// 0.8 with a budget.
        initial_threshold: Option<f32> = None,
        /// The threshold is a share of the undo probability at the start of the reset cycle; else it is a probability itself.
        relative: bool = true,
    }
}

/// A loss of probability that is never worth an abort. Where the way back is out of reach anyhow, less than that is at stake.
const NEGLIGIBLE: f64 = 0.02;

/// The rule, with what became of the attempts so far.
#[derive(Debug)]
pub struct UndoProbability {
    host: Host,
    combine: Combine,
    is_relative: bool,
    initial_threshold: f64,
    adaptation: Option<Adaptation>,
    history: History,
    differences: Differences,
    row: Row,
}

impl Plugin for UndoProbability {
    type Config = Config;

    fn create(config: Config, setup: &Setup) -> Result<Self> {
        config.combine.check("combine")?;
        let adaptation = Adaptation::new(&config)?;
        let initial_threshold = risk::initial_threshold(&config);
        let Config { combine, relative, .. } = config;
        if !(0.0..=1.0).contains(&initial_threshold) {
            let message = format!("initial_threshold is {initial_threshold}, but must lie in [0, 1]");
            return Err(Error::invalid_config(message).in_field("initial_threshold"));
        }
        let initial_threshold = f64::from(initial_threshold);
        Ok(Self {
            host: setup.host,
            combine,
            is_relative: relative,
            initial_threshold,
            adaptation,
            history: History::new(initial_threshold),
            differences: Differences::default(),
            row: Row::default(),
        })
    }
}

impl Checkpoint for UndoProbability {
    fn save(&self, bytes: &mut Vec<u8>) -> Result<()> {
        self.history.write(bytes);
        Ok(())
    }

    fn load(&mut self, bytes: &[u8]) -> Result<()> {
        self.history = History::read(bytes)?;
        Ok(())
    }
}

impl UndoProbability {
    /// The threshold in force. A state from a run that adapted does not move one that stays.
    fn threshold(&self) -> f64 {
        if self.adaptation.is_some() { self.history.threshold } else { self.initial_threshold }
    }

    /// The least undo probability at which an action is executed.
    fn required(&self, context: &RuleContext<'_>) -> Result<f32> {
        let (start, members) = (context.start_probabilities, context.probabilities.len());
        if !self.is_relative {
            return Ok(self.threshold() as f32);
        }
        require_probabilities("start_probabilities", start, members)?;
        let start = f64::from(self.combine.value(start)?);
        Ok((self.threshold() * start).min(start - NEGLIGIBLE) as f32)
    }

    /// Whether the reset agent, taking over now, would be no safer than it is after the proposed action.
    fn gains_nothing(&self, context: &RuleContext<'_>) -> Result<bool> {
        let (proposed, greedy) = (context.probabilities, context.greedy_probabilities);
        let difference =
            self.differences.with(proposed, greedy, |differences| self.combine.value(differences))?;
        Ok(difference >= 0.0)
    }
}

impl AbortRule for UndoProbability {
    fn needs(&self) -> Needs {
        Needs { probabilities: true, greedy_on_rejection: true, ..Needs::default() }
    }

    fn evaluate(&self, context: &RuleContext<'_>, reason: &mut Reason<'_>) -> Result<RuleVerdict> {
        let members = context.probabilities.len();
        check_finite("action", context.proposed, context.proposed.len())?;
        require_probabilities("probabilities", context.probabilities, members)?;
        let (probability, required) = (self.combine.value(context.probabilities)?, self.required(context)?);
        // The first time the rule is asked without them.
        let is_asked_again = !context.greedy_probabilities.is_empty();
        if is_asked_again {
            require_probabilities("greedy_probabilities", context.greedy_probabilities, members)?;
        }
        let is_safe = probability >= required || (is_asked_again && self.gains_nothing(context)?);
        if !is_safe {
            explain(reason, format_args!("{}", TooFew { probability, required }))?;
        }
        Ok(RuleVerdict::from_safe(is_safe, probability))
    }

    /// The start does not depend on the action: the rows ask for a fixed probability.
    fn linearise(&self, context: &RuleContext<'_>, gradients: &[f32], rows: &mut dyn Rows) -> Result<()> {
        let probabilities = context.probabilities;
        require_probabilities("probabilities", probabilities, probabilities.len())?;
        let required = self.required(context)?;
        self.combine.push_rows(context, probabilities, gradients, required, &self.row, rows)
    }

    fn observe(&mut self, decision: &ObservedDecision<'_>) -> Result<()> {
        self.history.begin(decision.step);
        self.host.metric("threshold", self.threshold());
        if let Some(risk) = self.history.realised_risk() {
            self.host.metric("realised_risk", risk);
        }
        if let Some(risk) = self.adaptation.as_ref().and_then(Adaptation::accepted_risk) {
            self.host.metric("accepted_risk", risk);
        }
        Ok(())
    }

    fn observe_attempt(&mut self, attempt: &ObservedAttempt) -> Result<()> {
        self.history.record(attempt, self.adaptation.as_ref());
        Ok(())
    }
}

shield_api::export_plugin! {
    abort_rule "undo-probability" => UndoProbability {
        description: "Rejects actions that could too seldom be undone; the accepted risk sets how seldom", deterministic: true
    }
}

#[cfg(test)]
#[path = "../../../tests/rules/support.rs"]
mod support;

#[cfg(test)]
mod tests;
