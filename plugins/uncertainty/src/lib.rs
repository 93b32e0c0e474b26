//! An abort rule: where the reset ensemble's members disagree, nobody knows whether the action can be undone.
#![forbid(unsafe_code)]

use rule_kit::{Row, explain, mean, require_finite, require_values};
use serde::Deserialize;
use shield_api::{
    AbortRule, Error, Needs, Plugin, Reason, Result, Rows, RuleContext, RuleVerdict, Setup, check_finite,
};

/// How far apart the members are.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
pub enum Spread {
    /// The standard deviation over all members (of the population).
    Std,
    /// The largest value less the smallest.
    Range,
}

shield_api::config! {
    /// Settings of the rule.
    pub struct Config {
        /// The largest spread of the reset values at which an action is executed.
        limit: f32 = 5.0,
        /// How the spread is measured: Std (standard deviation) or Range (largest less smallest).
        spread: Spread = Spread::Std => "Std",
    }
}

/// The rule. It holds no state.
#[derive(Debug)]
pub struct Uncertainty {
    limit: f32,
    spread: Spread,
    row: Row,
}

rule_kit::stateless!(Uncertainty);

impl Plugin for Uncertainty {
    type Config = Config;

    fn create(config: Config, _setup: &Setup) -> Result<Self> {
        let Config { limit, spread } = config;
        require_finite("limit", limit)?;
        if limit < 0.0 {
            let message = format!("limit is {limit}, but must not be negative");
            return Err(Error::invalid_config(message).in_field("limit"));
        }
        Ok(Self { limit, spread, row: Row::default() })
    }
}

fn standard_deviation(values: &[f32]) -> f64 {
    let mean = mean(values.iter().copied());
    let squares = values.iter().map(|value| (f64::from(*value) - mean).powi(2));
    (squares.sum::<f64>() / values.len() as f64).sqrt()
}

/// The members of the largest and of the smallest value.
fn extremes(values: &[f32]) -> (usize, usize) {
    (0..values.len()).fold((0, 0), |(largest, smallest), member| {
        let value = values[member];
        (
            if value > values[largest] { member } else { largest },
            if value < values[smallest] { member } else { smallest },
        )
    })
}

impl Uncertainty {
    fn measure(&self, values: &[f32]) -> f64 {
        match self.spread {
            Spread::Std => standard_deviation(values),
            Spread::Range => {
                let (largest, smallest) = extremes(values);
                f64::from(values[largest]) - f64::from(values[smallest])
            }
        }
    }

    /// How much the spread grows with the values of each member: of the deviation σ, ∂σ/∂Qᵢ = (Qᵢ − mean) / (n σ); 0 where σ is 0, its least.
    fn sensitivity(&self, values: &[f32], member: usize) -> f64 {
        match self.spread {
            Spread::Std => {
                let deviation = standard_deviation(values);
                let distance = f64::from(values[member]) - mean(values.iter().copied());
                if deviation == 0.0 { 0.0 } else { distance / (values.len() as f64 * deviation) }
            }
            Spread::Range => {
                let (largest, smallest) = extremes(values);
                f64::from(u8::from(member == largest)) - f64::from(u8::from(member == smallest))
            }
        }
    }
}

impl AbortRule for Uncertainty {
    fn needs(&self) -> Needs {
        Needs { values: true, ..Needs::default() }
    }

    fn evaluate(&self, context: &RuleContext<'_>, reason: &mut Reason<'_>) -> Result<RuleVerdict> {
        let values = context.values;
        require_values(values)?;
        let is_finite = values.iter().all(|value| value.is_finite());
        let spread = if is_finite { self.measure(values) as f32 } else { f32::NAN };
        // Written so that NaN rejects.
        let is_safe = spread <= self.limit;
        if !is_safe {
            let (measure, members, limit) = (self.spread, values.len(), self.limit);
            let words = format_args!("the {measure:?} of {members} reset values is {spread}, above {limit}");
            explain(reason, words)?;
        }
        Ok(RuleVerdict::from_safe(is_safe, spread))
    }

    /// One row: the spread around the proposed action to first order.
    fn linearise(&self, context: &RuleContext<'_>, gradients: &[f32], rows: &mut dyn Rows) -> Result<()> {
        let (values, proposed) = (context.values, context.proposed);
        require_values(values)?;
        let width = proposed.len();
        check_finite("values", values, values.len())?;
        check_finite("gradients", gradients, values.len() * width)?;
        let slope = |dimension: usize| {
            let of_member = |member: usize| f64::from(gradients[member * width + dimension]);
            let members = 0..values.len();
            members.map(|member| self.sensitivity(values, member) * of_member(member)).sum::<f64>() as f32
        };
        let spread = self.measure(values) as f32;
        self.row.push_at_most(proposed, spread, (0..width).map(slope), self.limit, rows)
    }
}

shield_api::export_plugin! {
    abort_rule "uncertainty" => Uncertainty {
        description: "Rejects actions on whose value the reset ensemble's members disagree", deterministic: true
    }
}

#[cfg(test)]
#[path = "../../../tests/rules/support.rs"]
mod support;

#[cfg(test)]
mod tests {
    use shield_api::{ErrorKind, PluginConfig, Verdict};

    use super::*;
    use crate::support::{
        assert_gradients_are_checked, assert_stateless, context, create, judge, rows, rule,
    };

    fn measure(config: &str, values: &[f32]) -> RuleVerdict {
        judge(&rule::<Uncertainty>(config), &context(values, &[0.0])).0
    }

    fn row(config: &str, values: &[f32], proposed: &[f32], gradients: &[f32]) -> (Vec<f32>, f32) {
        let rows = rows(&rule::<Uncertainty>(config), &context(values, proposed), gradients).unwrap();
        <[_; 1]>::try_from(rows).unwrap().into_iter().next().unwrap()
    }

    #[test]
    fn the_chosen_spread_is_compared_with_its_limit() {
        let values = [2.0, 4.0, 4.0, 4.0, 5.0, 5.0, 7.0, 9.0];
        for (config, score, verdict) in [
            ("()", 2.0, Verdict::Allow),
            ("(limit: 1.99)", 2.0, Verdict::Reject),
            ("(limit: 2.0)", 2.0, Verdict::Allow),
            ("(spread: Range)", 7.0, Verdict::Reject),
            ("(spread: Range, limit: 7.0)", 7.0, Verdict::Allow),
        ] {
            let judged = measure(config, &values);
            assert_eq!((judged.score, judged.verdict), (score, verdict), "{config}");
        }
        assert_eq!(measure("(limit: 0.0)", &[3.0]).verdict, Verdict::Allow, "one member agrees with itself");
    }

    #[test]
    fn non_finite_values_are_rejected_and_missing_ones_are_errors() {
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            for spread in ["Std", "Range"] {
                let judged = measure(&format!("(spread: {spread})"), &[1.0, bad]);
                assert!(judged.verdict == Verdict::Reject && judged.score.is_nan(), "{spread} {bad}");
            }
        }
        let missing = context(&[], &[0.0]);
        assert!(rule::<Uncertainty>("()").evaluate(&missing, &mut Reason::new(&mut [])).is_err());
    }

    #[test]
    fn the_row_is_the_spread_to_first_order() {
        // Members linear in the action: Q₀ = 1 + a₀, Q₁ = 2 − a₁, Q₂ = 6.
        let gradients = [1.0, 0.0, 0.0, -1.0, 0.0, 0.0];
        let values = |action: [f32; 2]| [1.0 + action[0], 2.0 - action[1], 6.0];
        let proposed = [0.2, 0.1];
        for spread in ["Std", "Range"] {
            let config = format!("(limit: 1.5, spread: {spread})");
            let (row, bound) = row(&config, &values(proposed), &proposed, &gradients);
            let spread_at = |action| f64::from(measure(&config, &values(action)).score);
            let excess = |action: [f32; 2]| f64::from(row[0] * action[0] + row[1] * action[1] - bound);
            for action in [proposed, [0.21, 0.1], [0.2, 0.11], [0.19, 0.09]] {
                let expected = spread_at(action) - 1.5;
                assert!((excess(action) - expected).abs() < 1e-4, "{spread} {action:?}");
            }
        }
        assert_eq!(row("()", &[3.0, 3.0], &[0.5], &[1.0, -1.0]), (vec![0.0], 5.0), "all agree");
    }

    #[test]
    fn truncated_and_nan_gradients_give_no_row() {
        assert_gradients_are_checked(&rule::<Uncertainty>("()"));
    }

    #[test]
    fn an_invalid_limit_is_refused() {
        for text in ["(limit: NaN)", "(limit: inf)", "(limit: -1.0)"] {
            assert_eq!(create::<Uncertainty>(text).unwrap_err().kind(), ErrorKind::InvalidConfig, "{text}");
        }
        assert!(Config::parse("(spread: Variance)").is_err());
    }

    #[test]
    fn a_foreign_state_is_refused() {
        assert_stateless(rule::<Uncertainty>("()"));
    }
}
