//! An abort rule of the user's own making: linear constraints A a ≤ b on the action, and how fast it may change.
#![forbid(unsafe_code)]

use std::{
    cell::RefCell,
    fmt::{self, Display},
};

use rule_kit::{dot, explain};
use serde::Deserialize;
use shield_api::{
    AbortRule, Error, Needs, Plugin, Reason, Result, Rows, RuleContext, RuleVerdict, Setup, Space,
    check_finite, check_length,
};

/// One constraint, a·action ≤ b.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Constraint {
    /// A coefficient for each dimension of the action.
    pub a: Vec<f32>,
    /// What the sum must not exceed.
    pub b: f32,
}

shield_api::config! {
    /// Settings of the rule.
    pub struct Config {
        /// Constraints a·action ≤ b, for example [(a: [1.0, 1.0], b: 0.5)].
        constraints: Vec<Constraint> = Vec::new() => "[]",
        /// How much each dimension may change from the action executed before; after a hard reset it is free.
        max_change: Option<Vec<f32>> = None,
    }
}

/// The rule. It holds no state: the host knows the action executed before.
#[derive(Debug)]
pub struct LinearConstraints {
    constraints: Vec<Constraint>,
    max_change: Vec<f32>,
    /// A row under construction; kept, so that a projection allocates nothing.
    row: RefCell<Vec<f32>>,
}

rule_kit::stateless!(LinearConstraints);

impl Plugin for LinearConstraints {
    type Config = Config;

    fn create(config: Config, setup: &Setup) -> Result<Self> {
        let Space::Box { low, .. } = &setup.spaces()?.action else {
            return Err(Error::invalid_config("the actions are discrete; linear constraints need a box"));
        };
        let width = low.len();
        let Config { constraints, max_change } = config;
        for (index, Constraint { a, b }) in constraints.iter().enumerate() {
            if a.len() != width || a.iter().chain([b]).any(|value| !value.is_finite()) {
                let message =
                    format!("constraints[{index}] needs {width} finite coefficients and a finite bound");
                return Err(Error::invalid_config(message).in_field(format!("constraints[{index}]")));
            }
        }
        let is_possible = |change: &f32| change.is_finite() && *change >= 0.0;
        if max_change.iter().any(|changes| changes.len() != width || !changes.iter().all(is_possible)) {
            let message = format!("max_change needs {width} values that are finite and not negative");
            return Err(Error::invalid_config(message).in_field("max_change"));
        }
        if constraints.is_empty() && max_change.is_none() {
            return Err(Error::invalid_config(
                "give constraints, max_change or both; without, nothing is rejected",
            ));
        }
        Ok(Self { constraints, max_change: max_change.unwrap_or_default(), row: RefCell::default() })
    }
}

/// What can be broken.
#[derive(Debug, Clone, Copy)]
enum Limit {
    Sum(usize),
    Change(usize),
}

impl Display for Limit {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Sum(index) => write!(formatter, "the action exceeds constraints[{index}]"),
            Self::Change(dimension) => {
                write!(formatter, "the change of action[{dimension}] exceeds max_change")
            }
        }
    }
}

impl LinearConstraints {
    /// The limits of change that apply, each with its dimension and the action executed before.
    fn changes<'a>(&'a self, context: &RuleContext<'a>) -> impl Iterator<Item = (usize, f32, f32)> + use<'a> {
        let previous = context.previous.unwrap_or_default();
        let limits = self.max_change.iter().zip(previous).enumerate();
        limits.map(|(dimension, (limit, previous))| (dimension, *limit, *previous))
    }
}

impl AbortRule for LinearConstraints {
    fn needs(&self) -> Needs {
        Needs::default()
    }

    /// The score is the room that the tightest limit leaves; below 0 it is broken.
    fn evaluate(&self, context: &RuleContext<'_>, reason: &mut Reason<'_>) -> Result<RuleVerdict> {
        let action = context.proposed;
        check_finite("the action", action, action.len())?;
        for Constraint { a, .. } in &self.constraints {
            check_length("the action", action, a.len())?;
        }
        let constraints = self.constraints.iter().enumerate();
        let rooms = constraints
            .map(|(index, Constraint { a, b })| (f64::from(*b) - dot(a, action), Limit::Sum(index)));
        let changes = self.changes(context).map(|(dimension, limit, previous)| {
            let change = f64::from(action[dimension]) - f64::from(previous);
            (f64::from(limit) - change.abs(), Limit::Change(dimension))
        });
        let tightest = rooms.chain(changes).min_by(|(one, _), (other, _)| one.total_cmp(other));
        // After a hard reset, with limits of change alone, nothing limits the action.
        let Some((room, limit)) = tightest else { return Ok(RuleVerdict::from_safe(true, f32::MAX)) };
        // Written so that NaN rejects.
        let is_safe = room >= 0.0;
        if !is_safe {
            explain(reason, format_args!("{limit} by {}", -room))?;
        }
        Ok(RuleVerdict::from_safe(is_safe, room as f32))
    }

    fn linearise(&self, context: &RuleContext<'_>, _gradients: &[f32], rows: &mut dyn Rows) -> Result<()> {
        for Constraint { a, b } in &self.constraints {
            rows.push(a, *b)?;
        }
        let mut row = self.row.borrow_mut();
        row.clear();
        row.resize(context.proposed.len(), 0.0);
        for (dimension, limit, previous) in self.changes(context) {
            for sign in [1.0, -1.0] {
                row[dimension] = sign;
                rows.push(&row, limit + sign * previous)?;
            }
            row[dimension] = 0.0;
        }
        Ok(())
    }
}

shield_api::export_plugin! {
    abort_rule "linear-constraints" => LinearConstraints {
        description: "Rejects actions outside the user's linear constraints and rate limits", deterministic: true
    }
}

#[cfg(test)]
#[path = "../../../tests/rules/support.rs"]
mod support;

#[cfg(test)]
mod tests {
    use shield_api::{ErrorKind, Host, PluginConfig, Spaces, Verdict};

    use super::*;
    use crate::support::{self, assert_stateless, create, rows};

    fn rule(config: &str) -> LinearConstraints {
        support::rule(config)
    }

    fn context<'a>(proposed: &'a [f32], previous: Option<&'a [f32]>) -> RuleContext<'a> {
        RuleContext { previous, ..support::context(&[], proposed) }
    }

    fn judge(config: &str, proposed: [f32; 2], previous: Option<&[f32]>) -> (Verdict, f32, String) {
        let (judged, reason) = support::judge(&rule(config), &context(&proposed, previous));
        (judged.verdict, judged.score, reason)
    }

    const SUM: &str = "(constraints: [(a: [1.0, 1.0], b: 0.5), (a: [-1.0, 0.0], b: 0.25)])";

    #[test]
    fn an_action_is_rejected_only_when_it_breaks_a_constraint() {
        assert_eq!(judge(SUM, [0.25, 0.25], None), (Verdict::Allow, 0.0, String::new()));
        let (verdict, score, reason) = judge(SUM, [0.5, 0.25], None);
        assert_eq!((verdict, score), (Verdict::Reject, -0.25));
        assert_eq!(reason, "the action exceeds constraints[0] by 0.25");
        assert_eq!(judge(SUM, [-0.5, 0.0], None).2, "the action exceeds constraints[1] by 0.25");
    }

    #[test]
    fn a_jump_is_rejected_except_after_a_hard_reset() {
        let config = "(max_change: Some([0.25, 1.0]))";
        assert_eq!(judge(config, [1.0, 1.0], None).0, Verdict::Allow);
        assert_eq!(judge(config, [0.25, -1.0], Some(&[0.5, 0.0])).0, Verdict::Allow);
        for jump in [[1.0, 0.0], [0.0, 0.0]] {
            let (verdict, score, reason) = judge(config, jump, Some(&[0.5, 0.0]));
            assert_eq!((verdict, score), (Verdict::Reject, -0.25), "{jump:?}");
            assert_eq!(reason, "the change of action[0] exceeds max_change by 0.25");
        }
    }

    #[test]
    fn rows_hold_where_the_rule_allows() {
        let config = "(constraints: [(a: [1.0, 1.0], b: 0.5)], max_change: Some([0.25, 1.0]))";
        let (rule, previous) = (rule(config), [0.5, 0.0]);
        let rows = rows(&rule, &context(&[0.0, 0.0], Some(&previous)), &[]).unwrap();
        assert_eq!(rows.len(), 5);
        for step in 0..400 {
            let action = [(step % 20) as f32 / 10.0 - 1.0, (step / 20) as f32 / 10.0 - 1.0];
            let (judged, _) = support::judge(&rule, &context(&action, Some(&previous)));
            let room = rows.iter().map(|(row, bound)| f64::from(*bound) - dot(row, &action));
            let least = room.fold(f64::INFINITY, f64::min);
            assert!((f64::from(judged.score) - least).abs() < 1e-6, "{action:?}");
        }
    }

    #[test]
    fn a_non_finite_or_truncated_action_is_an_error() {
        let rule = rule(SUM);
        for bad in [&[f32::NAN, 0.0][..], &[0.0, f32::NEG_INFINITY], &[0.0]] {
            let judged = rule.evaluate(&context(bad, None), &mut Reason::new(&mut []));
            assert!(judged.is_err(), "{bad:?}");
        }
    }

    #[test]
    fn an_invalid_configuration_is_refused() {
        for text in [
            "()",
            "(constraints: [(a: [1.0], b: 0.0)])",
            "(constraints: [(a: [1.0, NaN], b: 0.0)])",
            "(constraints: [(a: [1.0, 0.0], b: inf)])",
            "(max_change: Some([1.0]))",
            "(max_change: Some([1.0, -0.1]))",
        ] {
            let error = create::<LinearConstraints>(text).unwrap_err();
            assert_eq!(error.kind(), ErrorKind::InvalidConfig, "{text}");
        }
        let discrete = Spaces { observation: Space::unbounded(1), action: Space::Discrete { n: 2 } };
        let setup = Setup::with_spaces(0, 1, Host::silent(), discrete);
        let config = Config::parse("(max_change: Some([1.0]))").unwrap();
        assert!(LinearConstraints::create(config, &setup).is_err());
        assert!(Config::parse("(constraints: [(a: [1.0, 0.0], c: 1.0)])").is_err());
    }

    #[test]
    fn a_foreign_state_is_refused() {
        assert_stateless(rule(SUM));
    }
}
