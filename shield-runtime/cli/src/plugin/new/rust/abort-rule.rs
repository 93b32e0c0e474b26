<% extends "rust/base.rs" %>
<% block setup %>_setup<% endblock %>
<% block summary %>forbids pushing hard<% endblock %>
<% block description %>Forbids pushing hard<% endblock %>

<% block imports %>
use std::fmt::Write as _;
<% endblock %>

<% block settings %>
        /// The largest magnitude that is allowed in any dimension of an action.
        limit: f32 = 0.9,
<% endblock %>

<% block instance %>
/// The rule.
struct [[ type ]] {
    limit: f32,
}
<% endblock %>

<% block create %>
        if !(settings.limit > 0.0 && settings.limit.is_finite()) {
            let message = format!("`limit` is {}; it must be above 0", settings.limit);
            return Err(Error::invalid_config(message).in_field("limit"));
        }
        Ok(Self { limit: settings.limit })
<% endblock %>

<% block abilities %>
impl AbortRule for [[ type ]] {
    fn needs(&self) -> Needs {
        // `values: true` asks for the reset ensemble's values of the proposed action, `probabilities: true` for its undo probabilities.
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
<% endblock %>

<% block tests %>
    #[test]
    fn a_hard_push_is_rejected_with_a_reason() {
        let rule = [[ type ]] { limit: 0.5 };
        let context = |proposed| RuleContext { proposed, ..RuleContext::default() };
        let mut room = [0; 100];
        let mut reason = Reason::new(&mut room);
        assert_eq!(rule.evaluate(&context(&[0.4]), &mut reason).unwrap().verdict, Verdict::Allow);
        assert_eq!(rule.evaluate(&context(&[-0.7]), &mut reason).unwrap().verdict, Verdict::Reject);
        assert!(!reason.is_empty());
    }
<% endblock %>
