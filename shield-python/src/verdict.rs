//! A decision as the package takes it.

use shield_runtime::{decision::Decision, drop_in::DropIn};

/// What was decided: verdict, the means of the reset ensemble's values and of the undo probabilities, the rule's number (−1: none), cause and
/// reason.
pub type Verdict<'a> = (&'static str, f32, f32, i64, String, String);

/// What a decision says, beside what the shield compared.
pub fn verdict(drop_in: &DropIn, decision: Decision) -> Verdict<'static> {
    let name = match decision {
        Decision::Allow => "allow",
        Decision::WarmUp => "warm_up",
        Decision::Project(_) => "project",
        Decision::Abort(_) => "abort",
        Decision::Resetting => "resetting",
    };
    let rejection = decision.abort().or(decision.projection().map(|projection| projection.rejection));
    let (value, probability) = (drop_in.reset_value(), drop_in.undo_probability());
    let Some(rejection) = rejection else {
        return (name, value, probability, -1, String::new(), String::new());
    };
    let rule = rejection.rule.and_then(|rule| i64::try_from(rule).ok()).unwrap_or(-1);
    (name, value, probability, rule, rejection.cause.to_string(), drop_in.reason().to_owned())
}
