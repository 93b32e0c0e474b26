//! The paper's abort rule (§4.2, §4.3): an action is executed only if the reset ensemble values it at `q_min` or more.
#![forbid(unsafe_code)]

mod threshold;

use rule_kit::{Combine, Row, explain};
use shield_api::{AbortRule, Needs, Plugin, Reason, Result, Rows, RuleContext, RuleVerdict, Setup};

use crate::threshold::{Schedule, Threshold};

shield_api::config! {
    /// Settings of the rule.
    pub struct Config {
        /// Q_min: the least reset value at which an action is executed (paper, appendix C: 10, where values lie in [0, 100)).
        q_min: f32 = 10.0,
        /// How the ensemble's values become one: Optimistic (the largest), Realist (the mean), Pessimistic (the smallest; paper,
        /// appendix C), Quantile(q) (0 is the smallest, 1 the largest) or KOfN(k) (so many members must agree).
        combine: Combine = Combine::Pessimistic => "Pessimistic",
        /// Q_min is a share of 1/(1 − γ), the largest value that rewards in [0, 1] can have.
        relative: bool = false,
        /// How Q_min changes over the steps of the run: Constant, Linear or Cosine.
        schedule: Schedule = Schedule::Constant => "Constant",
        /// Q_min at the end of the schedule.
        final_q_min: Option<f32> = None,
        /// Environment steps that the schedule takes.
        schedule_steps: u64 = 0,
    }
}

/// The rule. It holds no state.
#[derive(Debug)]
pub struct EnsembleThreshold {
    threshold: Threshold,
    combine: Combine,
    row: Row,
}

rule_kit::stateless!(EnsembleThreshold);

impl Plugin for EnsembleThreshold {
    type Config = Config;

    fn create(config: Config, _setup: &Setup) -> Result<Self> {
        config.combine.check("combine")?;
        Ok(Self { threshold: Threshold::new(&config)?, combine: config.combine, row: Row::default() })
    }
}

impl AbortRule for EnsembleThreshold {
    fn needs(&self) -> Needs {
        Needs { values: true, ..Needs::default() }
    }

    fn evaluate(&self, context: &RuleContext<'_>, reason: &mut Reason<'_>) -> Result<RuleVerdict> {
        let value = self.combine.value(context.values)?;
        let q_min = self.threshold.at(context.step, context.discount);
        // Written so that NaN rejects.
        let is_safe = value >= q_min;
        if !is_safe {
            let (which, members) = (self.combine.words(), context.values.len());
            let words = format_args!("the {which} of {members} reset values is {value}, below q_min {q_min}");
            explain(reason, words)?;
        }
        Ok(RuleVerdict::from_safe(is_safe, value))
    }

    fn linearise(&self, context: &RuleContext<'_>, gradients: &[f32], rows: &mut dyn Rows) -> Result<()> {
        let q_min = self.threshold.at(context.step, context.discount);
        self.combine.push_rows(context, context.values, gradients, q_min, &self.row, rows)
    }
}

shield_api::export_plugin! {
    abort_rule "ensemble-threshold" => EnsembleThreshold {
        description: "Rejects actions that the reset ensemble values below q_min", deterministic: true
    }
}

#[cfg(test)]
#[path = "../../../tests/rules/support.rs"]
mod support;

#[cfg(test)]
mod tests {
    use shield_api::{ErrorKind, PluginConfig, Verdict};

    use super::*;
    use crate::support::{self, assert_gradients_are_checked, assert_stateless, context, create};

    fn rule(config: &str) -> EnsembleThreshold {
        support::rule(config)
    }

    fn judge(config: &str, values: &[f32]) -> (Verdict, f32, String) {
        let (judged, reason) = support::judge(&rule(config), &context(values, &[0.0]));
        (judged.verdict, judged.score, reason)
    }

    fn rows(config: &str, values: &[f32], proposed: &[f32], gradients: &[f32]) -> Vec<(Vec<f32>, f32)> {
        support::rows(&rule(config), &context(values, proposed), gradients).unwrap()
    }

    #[test]
    fn each_way_to_combine_compares_its_own_value() {
        let values = [3.21, 12.0, 14.79];
        for (combine, score, verdict) in [
            ("Quantile(0.0)", 3.21, Verdict::Reject),
            ("Quantile(0.49)", 3.21, Verdict::Reject),
            ("Quantile(0.5)", 12.0, Verdict::Allow),
            ("Quantile(1.0)", 14.79, Verdict::Allow),
            ("KOfN(1)", 14.79, Verdict::Allow),
            ("KOfN(2)", 12.0, Verdict::Allow),
            ("KOfN(3)", 3.21, Verdict::Reject),
            ("Optimistic", 14.79, Verdict::Allow),
            ("Realist", 10.0, Verdict::Allow),
            ("Pessimistic", 3.21, Verdict::Reject),
        ] {
            let judged = judge(&format!("(combine: {combine})"), &values);
            assert_eq!((judged.0, judged.1), (verdict, score), "{combine}");
        }
    }

    #[test]
    fn the_default_compares_the_smallest_value_with_10() {
        assert_eq!(judge("()", &[10.0, 20.0]).0, Verdict::Allow);
        let (verdict, _, reason) = judge("()", &[3.21, 20.0]);
        assert_eq!(verdict, Verdict::Reject);
        assert_eq!(reason, "the smallest of 2 reset values is 3.21, below q_min 10");
        assert_eq!(judge("(q_min: 3.0)", &[3.21, 20.0]).0, Verdict::Allow);
    }

    #[test]
    fn a_non_finite_value_of_any_member_rejects_the_action() {
        for combine in ["Optimistic", "Realist", "Pessimistic", "Quantile(0.5)", "KOfN(1)"] {
            for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
                for values in [[bad, 50.0], [50.0, bad]] {
                    let (verdict, score, _) = judge(&format!("(combine: {combine})"), &values);
                    assert!(verdict == Verdict::Reject && score.is_nan(), "{combine} {values:?}");
                }
            }
        }
    }

    #[test]
    fn missing_values_are_an_error() {
        let mut reason = Reason::new(&mut []);
        let error = rule("()").evaluate(&context(&[], &[0.0]), &mut reason).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::InvalidArgument);
    }

    #[test]
    fn an_invalid_threshold_schedule_or_combination_is_refused() {
        for text in ["(q_min: NaN)", "(q_min: inf)", "(q_min: -inf)"] {
            let error = create::<EnsembleThreshold>(text).unwrap_err();
            assert_eq!(error.kind(), ErrorKind::InvalidConfig);
            assert!(error.message().contains("q_min is"), "{error}");
        }
        for text in [
            "(combine: Quantile(1.5))",
            "(combine: Quantile(NaN))",
            "(combine: KOfN(0))",
            "(final_q_min: Some(20.0))",
            "(schedule_steps: 10)",
            "(schedule: Linear)",
            "(schedule: Linear, final_q_min: Some(20.0))",
            "(schedule: Cosine, schedule_steps: 10)",
            "(schedule: Cosine, schedule_steps: 10, final_q_min: Some(inf))",
        ] {
            let made = create::<EnsembleThreshold>(text);
            assert_eq!(made.unwrap_err().kind(), ErrorKind::InvalidConfig, "{text}");
        }
        assert!(Config::parse("(q_max: 1.0)").is_err());
        assert!(Config::parse("(combine: Median)").is_err());
    }

    #[test]
    fn rows_hold_where_the_linearised_value_reaches_the_threshold() {
        // Two members over two dimensions: Q = 8 + 2·δ₀ and Q = 9 − δ₁ around a₀ = (0.5, −0.5).
        let (values, proposed, gradients) = ([8.0, 9.0], [0.5, -0.5], [2.0, 0.0, 0.0, -1.0]);
        assert_eq!(
            rows("()", &values, &proposed, &gradients),
            // −2·a₀ ≤ 8 − 1 − 10 and a₁ ≤ 9 − 0.5 − 10.
            [(vec![-2.0, -0.0], -3.0), (vec![-0.0, 1.0], -1.5)]
        );
        assert_eq!(rows("(combine: Optimistic)", &values, &proposed, &gradients), [(vec![-0.0, 1.0], -1.5)]);
        // The mean: Q = 8.5 + δ₀ − δ₁ / 2.
        assert_eq!(rows("(combine: Realist)", &values, &proposed, &gradients), [(vec![-1.0, 0.5], -2.25)]);
    }

    #[test]
    fn a_quorum_has_a_row_for_each_of_its_best_members() {
        let (values, gradients) = ([8.0, 9.0, 7.0, 9.0], [1.0, 2.0, 3.0, 4.0]);
        let slopes = |combine: &str| {
            let rows = rows(&format!("(combine: {combine})"), &values, &[0.0], &gradients);
            rows.into_iter().map(|(row, _)| -row[0]).collect::<Vec<_>>()
        };
        assert_eq!(slopes("KOfN(1)"), [2.0]);
        assert_eq!(slopes("KOfN(3)"), [1.0, 2.0, 4.0]);
        assert_eq!(slopes("Quantile(0.34)"), [1.0, 2.0, 4.0]);
        assert_eq!(slopes("Quantile(0.0)").len(), 4);
    }

    #[test]
    fn a_quorum_larger_than_the_ensemble_is_an_error() {
        let mut reason = Reason::new(&mut []);
        let error =
            rule("(combine: KOfN(3))").evaluate(&context(&[1.0, 2.0], &[0.0]), &mut reason).unwrap_err();
        assert!(error.message().contains("3 of 2"), "{error}");
    }

    #[test]
    fn q_min_follows_its_schedule_and_then_stays() {
        let q_min = |config: &str, step| {
            let context = RuleContext { step, ..context(&[-1e9], &[0.0]) };
            let (_, reason) = support::judge(&rule(config), &context);
            reason.rsplit(' ').next().unwrap().parse::<f32>().unwrap()
        };
        let rising = "q_min: 10.0, final_q_min: Some(20.0), schedule_steps: 100";
        for (schedule, expected) in
            [("Linear", [10.0, 12.5, 15.0, 20.0, 20.0]), ("Cosine", [10.0, 11.464466, 15.0, 20.0, 20.0])]
        {
            for (step, expected) in [0, 25, 50, 100, 5_000].into_iter().zip(expected) {
                assert_eq!(
                    q_min(&format!("({rising}, schedule: {schedule})"), step),
                    expected,
                    "{schedule} {step}"
                );
            }
        }
        // γ is 0.99: values lie below 100.
        assert!((q_min("(q_min: 0.1, relative: true)", 0) - 10.0).abs() < 1e-4);
    }

    #[test]
    fn a_relative_threshold_without_discount_rejects_everything() {
        let endless = RuleContext { discount: 1.0, ..context(&[1e30], &[0.0]) };
        let (judged, _) = support::judge(&rule("(q_min: 0.1, relative: true)"), &endless);
        assert_eq!(judged.verdict, Verdict::Reject);
    }

    #[test]
    fn truncated_and_nan_gradients_give_no_rows() {
        assert_gradients_are_checked(&rule("()"));
    }

    #[test]
    fn its_empty_state_is_restored_and_a_foreign_one_refused() {
        assert_stateless(rule("()"));
    }
}
