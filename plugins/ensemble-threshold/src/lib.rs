//! The paper's abort rule (§4.2, §4.3): an action is executed only if the reset ensemble values it at `q_min` or more.
#![forbid(unsafe_code)]

use std::fmt::Write;

use serde::Deserialize;
use shield_api::{
    AbortRule, Checkpoint, Error, Needs, Plugin, Reason, Result, Rows, RuleContext, RuleVerdict, Setup,
    check_finite,
};

/// How the members' values become one (paper, §4.3).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
pub enum Combine {
    /// The largest value: abort only if every member wants to.
    Optimistic,
    /// The mean.
    Realist,
    /// The smallest value: abort if any member wants to.
    Pessimistic,
}

impl Combine {
    /// One value out of all of them. A member that is NaN or infinite says nothing about the action, so that nothing can be
    /// said of the ensemble either: NaN.
    fn value(self, values: &[f32]) -> f32 {
        if values.iter().any(|value| !value.is_finite()) {
            return f32::NAN;
        }
        match self {
            Self::Optimistic => values.iter().copied().fold(f32::NAN, f32::max),
            Self::Realist => mean(values.iter().copied(), values.len()),
            Self::Pessimistic => values.iter().copied().fold(f32::NAN, f32::min),
        }
    }

    fn words(self) -> &'static str {
        match self {
            Self::Optimistic => "largest",
            Self::Realist => "mean",
            Self::Pessimistic => "smallest",
        }
    }
}

fn mean(values: impl Iterator<Item = f32>, count: usize) -> f32 {
    (values.map(f64::from).sum::<f64>() / count as f64) as f32
}

shield_api::config! {
    /// Settings of the rule.
    pub struct Config {
        /// Q_min: the least reset value at which an action is executed (paper, appendix C: 10, where values lie in [0, 100)).
        q_min: f32 = 10.0,
        /// How the ensemble's values become one: Optimistic (the largest), Realist (the mean) or Pessimistic (the smallest;
        /// paper, appendix C).
        combine: Combine = Combine::Pessimistic => "Pessimistic",
    }
}

/// The rule. It holds no state.
#[derive(Debug)]
pub struct EnsembleThreshold {
    q_min: f32,
    combine: Combine,
}

impl Checkpoint for EnsembleThreshold {
    fn save(&self, _bytes: &mut Vec<u8>) -> Result<()> {
        Ok(())
    }

    fn load(&mut self, bytes: &[u8]) -> Result<()> {
        if bytes.is_empty() {
            return Ok(());
        }
        Err(Error::invalid_argument(format!("this rule has no state, but {} bytes are given", bytes.len())))
    }
}

impl Plugin for EnsembleThreshold {
    type Config = Config;

    fn create(config: Config, _setup: &Setup) -> Result<Self> {
        if !config.q_min.is_finite() {
            return Err(Error::invalid_config(format!("q_min is {}, but must be finite", config.q_min)));
        }
        Ok(Self { q_min: config.q_min, combine: config.combine })
    }
}

impl EnsembleThreshold {
    /// The row of a value `value` with gradient g at the proposed action a₀. Near a₀, Q(a) ≈ value + g·(a − a₀); so
    /// Q(a) ≥ q_min becomes −g·a ≤ value − g·a₀ − q_min.
    fn push_row(
        &self,
        proposed: &[f32],
        value: f32,
        gradient: impl Iterator<Item = f32>,
        row: &mut Vec<f32>,
        rows: &mut dyn Rows,
    ) -> Result<()> {
        row.clear();
        row.extend(gradient.map(|slope| -slope));
        let at_proposed: f64 = row.iter().zip(proposed).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum();
        rows.push(row, (f64::from(value) + at_proposed - f64::from(self.q_min)) as f32)
    }
}

fn require_values(values: &[f32]) -> Result<()> {
    if values.is_empty() {
        return Err(Error::invalid_argument("the reset ensemble's values are missing; this rule needs them"));
    }
    Ok(())
}

impl AbortRule for EnsembleThreshold {
    fn needs(&self) -> Needs {
        Needs { values: true, ..Needs::default() }
    }

    fn evaluate(&self, context: &RuleContext<'_>, reason: &mut Reason<'_>) -> Result<RuleVerdict> {
        require_values(context.values)?;
        let value = self.combine.value(context.values);
        // Written so that NaN rejects.
        let is_safe = value >= self.q_min;
        if !is_safe {
            let (which, members) = (self.combine.words(), context.values.len());
            write!(reason, "the {which} of {members} reset values is {value}, below q_min {}", self.q_min)
                .map_err(|error| Error::failed(error.to_string()))?;
        }
        Ok(RuleVerdict::from_safe(is_safe, value))
    }

    fn linearise(&self, context: &RuleContext<'_>, gradients: &[f32], rows: &mut dyn Rows) -> Result<()> {
        let (values, proposed) = (context.values, context.proposed);
        require_values(values)?;
        let width = proposed.len();
        check_finite("values", values, values.len())?;
        check_finite("gradients", gradients, values.len() * width)?;
        let gradient = |member: usize| gradients[member * width..(member + 1) * width].iter().copied();
        let mut row = Vec::with_capacity(width);
        match self.combine {
            Combine::Pessimistic => (0..values.len()).try_for_each(|member| {
                self.push_row(proposed, values[member], gradient(member), &mut row, rows)
            }),
            Combine::Realist => {
                let members = 0..values.len();
                let slopes = (0..width).map(|dimension| {
                    mean(members.clone().map(|member| gradients[member * width + dimension]), values.len())
                });
                self.push_row(proposed, self.combine.value(values), slopes, &mut row, rows)
            }
            Combine::Optimistic => {
                let best = (0..values.len()).max_by(|left, right| values[*left].total_cmp(&values[*right]));
                let best = best.unwrap_or(0);
                self.push_row(proposed, values[best], gradient(best), &mut row, rows)
            }
        }
    }
}

shield_api::export_plugin! {
    abort_rule "ensemble-threshold" => EnsembleThreshold {
        description: "Rejects actions that the reset ensemble values below q_min", deterministic: true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use shield_api::{ErrorKind, Host, PluginConfig, Verdict};

    fn rule(config: &str) -> EnsembleThreshold {
        let setup = Setup::new(0, 1, Host::silent());
        EnsembleThreshold::create(Config::parse(config).unwrap(), &setup).unwrap()
    }

    fn context<'a>(values: &'a [f32], proposed: &'a [f32]) -> RuleContext<'a> {
        RuleContext {
            step: 0,
            observation: &[0.0],
            proposed,
            previous: None,
            values,
            greedy_values: &[],
            forward_values: &[],
            discount: 0.99,
        }
    }

    fn judge(config: &str, values: &[f32]) -> (Verdict, f32, String) {
        let mut room = [0; 120];
        let mut reason = Reason::new(&mut room);
        let judged = rule(config).evaluate(&context(values, &[0.0]), &mut reason).unwrap();
        let length = reason.len();
        (judged.verdict, judged.score, String::from_utf8(room[..length].to_vec()).unwrap())
    }

    fn rows(config: &str, values: &[f32], proposed: &[f32], gradients: &[f32]) -> Vec<(Vec<f32>, f32)> {
        struct Collected(Vec<(Vec<f32>, f32)>);
        impl Rows for Collected {
            fn push(&mut self, coefficients: &[f32], bound: f32) -> Result<()> {
                self.0.push((coefficients.to_vec(), bound));
                Ok(())
            }
        }
        let mut collected = Collected(Vec::new());
        rule(config).linearise(&context(values, proposed), gradients, &mut collected).unwrap();
        collected.0
    }

    #[test]
    fn each_way_to_combine_compares_another_value() {
        let values = [3.21, 12.0, 14.79];
        for (combine, score, verdict) in [
            ("Optimistic", 14.79, Verdict::Allow),
            ("Realist", 10.0, Verdict::Allow),
            ("Pessimistic", 3.21, Verdict::Reject),
        ] {
            let judged = judge(&format!("(combine: {combine})"), &values);
            assert_eq!((judged.0, judged.1), (verdict, score), "{combine}");
        }
    }

    #[test]
    fn the_default_is_the_papers() {
        assert_eq!(judge("()", &[10.0, 20.0]).0, Verdict::Allow);
        let (verdict, _, reason) = judge("()", &[3.21, 20.0]);
        assert_eq!(verdict, Verdict::Reject);
        assert_eq!(reason, "the smallest of 2 reset values is 3.21, below q_min 10");
        assert_eq!(judge("(q_min: 3.0)", &[3.21, 20.0]).0, Verdict::Allow);
    }

    #[test]
    fn a_member_that_is_not_a_number_rejects_whatever_the_others_say() {
        for combine in ["Optimistic", "Realist", "Pessimistic"] {
            for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
                for values in [[bad, 50.0], [50.0, bad]] {
                    let (verdict, score, _) = judge(&format!("(combine: {combine})"), &values);
                    assert!(verdict == Verdict::Reject && score.is_nan(), "{combine} {values:?}");
                }
            }
        }
    }

    #[test]
    fn without_values_there_is_no_verdict() {
        let mut reason = Reason::new(&mut []);
        let error = rule("()").evaluate(&context(&[], &[0.0]), &mut reason).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::InvalidArgument);
    }

    #[test]
    fn a_threshold_that_is_not_finite_is_refused() {
        for text in ["(q_min: NaN)", "(q_min: inf)", "(q_min: -inf)"] {
            let config = Config::parse(text).unwrap();
            let error = EnsembleThreshold::create(config, &Setup::new(0, 1, Host::silent())).unwrap_err();
            assert_eq!(error.kind(), ErrorKind::InvalidConfig);
            assert!(error.message().contains("q_min is"), "{error}");
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
    fn gradients_that_are_cut_or_not_numbers_give_no_rows() {
        struct Refusing;
        impl Rows for Refusing {
            fn push(&mut self, _: &[f32], _: f32) -> Result<()> {
                panic!("no row may be pushed");
            }
        }
        for gradients in [&[1.0][..], &[1.0, f32::NAN], &[]] {
            let context = context(&[8.0, 9.0], &[0.0]);
            assert!(rule("()").linearise(&context, gradients, &mut Refusing).is_err(), "{gradients:?}");
        }
    }

    #[test]
    fn its_empty_state_is_kept_and_a_foreign_one_refused() {
        let mut bytes = Vec::new();
        let mut rule = rule("()");
        rule.save(&mut bytes).unwrap();
        rule.load(&bytes).unwrap();
        assert!(rule.load(&[1]).is_err());
    }
}
