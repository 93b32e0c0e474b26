//! An abort rule: an action must not be much worse for the reset than what the reset agent itself would do.
#![forbid(unsafe_code)]

use rule_kit::{Combine, Differences, Row, explain, require_finite};
use shield_api::{AbortRule, Needs, Plugin, Reason, Result, Rows, RuleContext, RuleVerdict, Setup};

shield_api::config! {
    /// Settings of the rule.
    pub struct Config {
        /// The least advantage Q(s, a) − V(s) at which an action is executed, where V(s) = Q(s, π_reset(s)); usually below 0.
        min_advantage: f32 = -5.0,
        /// How the members' advantages become one: Optimistic (the largest), Realist (the mean), Pessimistic (the smallest),
        /// Quantile(q) (0 is the smallest, 1 the largest) or KOfN(k) (so many members must agree).
        combine: Combine = Combine::Pessimistic => "Pessimistic",
    }
}

/// The rule. It holds no state but buffers.
#[derive(Debug)]
pub struct Advantage {
    min_advantage: f32,
    combine: Combine,
    advantages: Differences,
    row: Row,
}

rule_kit::stateless!(Advantage);

impl Plugin for Advantage {
    type Config = Config;

    fn create(config: Config, _setup: &Setup) -> Result<Self> {
        let Config { min_advantage, combine } = config;
        require_finite("min_advantage", min_advantage)?;
        combine.check("combine")?;
        Ok(Self { min_advantage, combine, advantages: Differences::default(), row: Row::default() })
    }
}

impl Advantage {
    /// Hands the advantage of each member to `use_them`.
    fn with_advantages<T>(
        &self,
        context: &RuleContext<'_>,
        use_them: impl FnOnce(&[f32]) -> Result<T>,
    ) -> Result<T> {
        self.advantages.with(context.values, context.greedy_values, use_them)
    }
}

impl AbortRule for Advantage {
    fn needs(&self) -> Needs {
        Needs { values: true, greedy_values: true, ..Needs::default() }
    }

    fn evaluate(&self, context: &RuleContext<'_>, reason: &mut Reason<'_>) -> Result<RuleVerdict> {
        let advantage = self.with_advantages(context, |advantages| self.combine.value(advantages))?;
        // Written so that NaN rejects.
        let is_safe = advantage >= self.min_advantage;
        if !is_safe {
            let (which, members, least) = (self.combine.words(), context.values.len(), self.min_advantage);
            explain(
                reason,
                format_args!("the {which} of {members} advantages is {advantage}, below {least}"),
            )?;
        }
        Ok(RuleVerdict::from_safe(is_safe, advantage))
    }

    /// V(s) does not depend on the action: the gradients of the advantages are those of the values.
    fn linearise(&self, context: &RuleContext<'_>, gradients: &[f32], rows: &mut dyn Rows) -> Result<()> {
        self.with_advantages(context, |advantages| {
            self.combine.push_rows(context, advantages, gradients, self.min_advantage, &self.row, rows)
        })
    }
}

shield_api::export_plugin! {
    abort_rule "advantage" => Advantage {
        description: "Rejects actions that are much worse for the reset than the reset agent's own", deterministic: true
    }
}

#[cfg(test)]
#[path = "../../../tests/rules/support.rs"]
mod support;

#[cfg(test)]
mod tests {
    use shield_api::{ErrorKind, Verdict};

    use super::*;
    use crate::support::{assert_stateless, context, create, judge, rows, rule};

    fn compare(config: &str, values: &[f32], greedy_values: &[f32]) -> RuleVerdict {
        let context = RuleContext { greedy_values, ..context(values, &[0.5]) };
        judge(&rule::<Advantage>(config), &context).0
    }

    #[test]
    fn the_combined_advantage_of_the_members_is_compared() {
        // Advantages of −1, −6 and 2.
        let (values, greedy) = ([9.0, 4.0, 12.0], [10.0, 10.0, 10.0]);
        for (config, score, verdict) in [
            ("()", -6.0, Verdict::Reject),
            ("(min_advantage: -6.0)", -6.0, Verdict::Allow),
            ("(combine: Optimistic, min_advantage: 2.5)", 2.0, Verdict::Reject),
            ("(combine: Realist)", -5.0 / 3.0, Verdict::Allow),
            ("(combine: Quantile(0.5))", -1.0, Verdict::Allow),
            ("(combine: KOfN(2))", -1.0, Verdict::Allow),
        ] {
            let judged = compare(config, &values, &greedy);
            assert_eq!((judged.score, judged.verdict), (score, verdict), "{config}");
        }
    }

    #[test]
    fn non_finite_values_are_rejected_and_missing_ones_are_errors() {
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            assert!(compare("()", &[bad, 1.0], &[1.0, 1.0]).score.is_nan());
            assert_eq!(compare("()", &[1.0, 1.0], &[bad, 1.0]).verdict, Verdict::Reject);
        }
        for (values, greedy_values) in [(&[][..], &[][..]), (&[1.0], &[]), (&[1.0, 2.0], &[1.0])] {
            let context = RuleContext { greedy_values, ..context(values, &[0.5]) };
            assert!(rule::<Advantage>("()").evaluate(&context, &mut Reason::new(&mut [])).is_err());
        }
    }

    #[test]
    fn the_row_holds_where_the_linearised_advantage_suffices() {
        // Around 0.5 the advantage is −8 + 4 (a − 0.5): at least −5 from a = 1.25.
        let context = RuleContext { greedy_values: &[10.0], ..context(&[2.0], &[0.5]) };
        assert_eq!(rows(&rule::<Advantage>("()"), &context, &[4.0]), Ok(vec![(vec![-4.0], -5.0)]));
    }

    #[test]
    fn an_invalid_bound_or_combination_is_refused() {
        for text in [
            "(min_advantage: NaN)",
            "(min_advantage: -inf)",
            "(combine: KOfN(0))",
            "(combine: Quantile(2.0))",
        ] {
            assert_eq!(create::<Advantage>(text).unwrap_err().kind(), ErrorKind::InvalidConfig, "{text}");
        }
    }

    #[test]
    fn a_foreign_state_is_refused() {
        assert_stateless(rule::<Advantage>("()"));
    }
}
