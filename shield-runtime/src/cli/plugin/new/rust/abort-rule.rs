//! `{{id}}`: forbids pushing hard.
#![forbid(unsafe_code)]

use shield_api::*;
use std::fmt::Write as _;


config! {
    /// Settings of `{{id}}`.
    pub struct Settings {
        /// The largest magnitude that is allowed in any dimension of an action.
        limit: f32 = 0.9,
    }
}

/// The rule.
struct {{type}} {
    limit: f32,
}

impl Plugin for {{type}} {
    type Config = Settings;

    fn create(settings: Settings, _setup: &Setup) -> Result<Self> {
        if !(settings.limit > 0.0 && settings.limit.is_finite()) {
            return Err(Error::invalid_config(format!("`limit` is {}; it must be above 0", settings.limit)));
        }
        Ok(Self { limit: settings.limit })
    }
}

impl AbortRule for {{type}} {
    fn needs(&self) -> Needs {
        // `values: true` asks for the reset ensemble's values of the proposed action.
        Needs::default()
    }

    fn evaluate(&self, context: &RuleContext<'_>, reason: &mut Reason<'_>) -> Result<RuleVerdict> {
        check_finite("action", context.proposed, context.proposed.len())?;
        let largest = context.proposed.iter().fold(0.0, |largest: f32, value| largest.max(value.abs()));
        let is_safe = largest <= self.limit;
        if !is_safe {
            write!(reason, "the action reaches {largest}, more than {}", self.limit).ok();
        }
        Ok(RuleVerdict::from_safe(is_safe, largest))
    }

    /// |a| ≤ limit, two rows for each dimension: from these, the host finds the nearest action that is allowed.
    fn linearise(&self, context: &RuleContext<'_>, _gradients: &[f32], rows: &mut dyn Rows) -> Result<()> {
        let mut row = vec![0.0; context.proposed.len()];
        for dimension in 0..row.len() {
            for sign in [1.0, -1.0] {
                row[dimension] = sign;
                rows.push(&row, self.limit)?;
            }
            row[dimension] = 0.0;
        }
        Ok(())
    }
}

/// There is no state beyond the configuration: nothing to save, and nothing to load.
impl Checkpoint for {{type}} {
    fn save(&self, _bytes: &mut Vec<u8>) -> Result<()> {
        Ok(())
    }

    fn load(&mut self, bytes: &[u8]) -> Result<()> {
        if bytes.is_empty() { Ok(()) } else { Err(Error::invalid_argument("there is no state to load")) }
    }
}

shield_api::export_plugin! {
    abort_rule "{{id}}" => {{type}} { description: "Forbids pushing hard", deterministic: true }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hard_push_is_rejected_and_says_why() {
        let rule = {{type}} { limit: 0.5 };
        let context = |proposed| RuleContext { proposed, ..RuleContext::default() };
        let mut room = [0; 100];
        let mut reason = Reason::new(&mut room);
        assert_eq!(rule.evaluate(&context(&[0.4]), &mut reason).unwrap().verdict, Verdict::Allow);
        assert_eq!(rule.evaluate(&context(&[-0.7]), &mut reason).unwrap().verdict, Verdict::Reject);
        assert!(!reason.is_empty());
    }
}
