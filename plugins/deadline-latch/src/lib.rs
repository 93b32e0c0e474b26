//! An abort rule: after an abort, every forward action is rejected for some steps, whatever the other rules say.
#![forbid(unsafe_code)]

use rule_kit::explain;
use shield_api::{
    AbortRule, Checkpoint, Error, Needs, ObservedDecision, Phase, Plugin, Reason, Result, Rows, RuleContext,
    RuleVerdict, Setup, check_finite,
};

shield_api::config! {
    /// Settings of the rule.
    pub struct Config {
        /// For how many environment steps after an abort every action is rejected.
        steps: u64 = 10,
    }
}

/// The rule, open or latched.
#[derive(Debug)]
pub struct DeadlineLatch {
    steps: u64,
    /// The first step at which it is open again.
    opens_at: u64,
}

impl DeadlineLatch {
    /// Steps until it opens; 0 if it is open.
    fn remaining(&self, step: u64) -> u64 {
        self.opens_at.saturating_sub(step)
    }
}

impl Checkpoint for DeadlineLatch {
    fn save(&self, bytes: &mut Vec<u8>) -> Result<()> {
        bytes.extend_from_slice(&self.opens_at.to_le_bytes());
        Ok(())
    }

    fn load(&mut self, bytes: &[u8]) -> Result<()> {
        let state = bytes.try_into().map_err(|_| {
            Error::invalid_argument(format!("the state of this rule has 8 bytes, not {}", bytes.len()))
        })?;
        self.opens_at = u64::from_le_bytes(state);
        Ok(())
    }
}

impl Plugin for DeadlineLatch {
    type Config = Config;

    fn create(config: Config, _setup: &Setup) -> Result<Self> {
        if config.steps == 0 {
            let message = "with 0 steps the rule would never reject; it needs at least 1";
            return Err(Error::invalid_config(message).in_field("steps"));
        }
        Ok(Self { steps: config.steps, opens_at: 0 })
    }
}

impl AbortRule for DeadlineLatch {
    fn needs(&self) -> Needs {
        Needs::default()
    }

    fn evaluate(&self, context: &RuleContext<'_>, reason: &mut Reason<'_>) -> Result<RuleVerdict> {
        // It does not look at the action, but nothing that is no number is allowed by any rule.
        check_finite("action", context.proposed, context.proposed.len())?;
        // It keeps the reset agent in charge, and so never stands in its way.
        let remaining = if context.phase == Phase::Forward { self.remaining(context.step) } else { 0 };
        if remaining > 0 {
            explain(reason, format_args!("an abort keeps the latch closed for {remaining} more steps"))?;
        }
        Ok(RuleVerdict::from_safe(remaining == 0, remaining as f32))
    }

    /// No rows while it is open: it does not restrict the action. While it is latched no action is allowed, so that none can be found.
    fn linearise(&self, context: &RuleContext<'_>, _gradients: &[f32], _rows: &mut dyn Rows) -> Result<()> {
        match self.remaining(context.step) {
            0 => Ok(()),
            _ => Err(Error::unsupported("an action while the latch is closed")),
        }
    }

    fn observe(&mut self, decision: &ObservedDecision<'_>) -> Result<()> {
        // Its own rejections are aborts too: they must not keep it closed for ever.
        if decision.aborted && self.remaining(decision.step) == 0 {
            self.opens_at = decision.step.saturating_add(self.steps).saturating_add(1);
        }
        Ok(())
    }
}

shield_api::export_plugin! {
    abort_rule "deadline-latch" => DeadlineLatch {
        description: "Rejects every forward action for some steps after an abort", deterministic: true
    }
}

#[cfg(test)]
#[path = "../../../tests/rules/support.rs"]
mod support;

#[cfg(test)]
mod tests {
    use shield_api::{ErrorKind, Verdict};

    use super::*;
    use crate::support::{self, create, rows};

    fn rule(config: &str) -> DeadlineLatch {
        support::rule(config)
    }

    fn context(step: u64) -> RuleContext<'static> {
        RuleContext { step, ..support::context(&[], &[0.0]) }
    }

    fn judge(rule: &DeadlineLatch, step: u64) -> Verdict {
        support::judge(rule, &context(step)).0.verdict
    }

    fn observe(rule: &mut DeadlineLatch, step: u64, aborted: bool) {
        rule.observe(&ObservedDecision { step, aborted, action: &[0.0] }).unwrap();
    }

    #[test]
    fn an_abort_closes_the_latch_for_the_given_steps() {
        let mut rule = rule("(steps: 3)");
        for step in 0..5 {
            assert_eq!(judge(&rule, step), Verdict::Allow);
            observe(&mut rule, step, false);
        }
        observe(&mut rule, 5, true);
        for step in 6..9 {
            assert_eq!(judge(&rule, step), Verdict::Reject, "step {step}");
            // The shield aborts because of this rule: that is no new abort.
            observe(&mut rule, step, true);
        }
        assert_eq!(judge(&rule, 9), Verdict::Allow);
        observe(&mut rule, 9, true);
        assert_eq!(judge(&rule, 12), Verdict::Reject);
        assert_eq!(judge(&rule, 13), Verdict::Allow);
    }

    #[test]
    fn a_closed_latch_allows_the_reset_agents_exploration() {
        let mut rule = rule("()");
        observe(&mut rule, 0, true);
        let exploring = RuleContext { phase: Phase::Reset, ..context(1) };
        let (judged, _) = support::judge(&rule, &exploring);
        assert_eq!((judged.verdict, judge(&rule, 1)), (Verdict::Allow, Verdict::Reject));
    }

    #[test]
    fn only_an_open_latch_can_be_linearised() {
        let mut rule = rule("()");
        assert_eq!(rows(&rule, &context(0), &[]), Ok(vec![]));
        observe(&mut rule, 0, true);
        assert_eq!(rows(&rule, &context(1), &[]).unwrap_err().kind(), ErrorKind::Unsupported);
    }

    #[test]
    fn its_state_is_restored_and_a_foreign_one_refused() {
        let mut closed = rule("()");
        observe(&mut closed, 100, true);
        let mut bytes = Vec::new();
        closed.save(&mut bytes).unwrap();
        let mut other = rule("()");
        assert!(other.load(&bytes[1..]).is_err() && other.load(&[]).is_err());
        assert_eq!(judge(&other, 101), Verdict::Allow, "a refused state changes nothing");
        other.load(&bytes).unwrap();
        assert_eq!(judge(&other, 101), Verdict::Reject);
    }

    #[test]
    fn a_latch_of_no_steps_is_refused() {
        let made = create::<DeadlineLatch>("(steps: 0)");
        assert_eq!(made.unwrap_err().kind(), ErrorKind::InvalidConfig);
    }
}
