//! What the tests of abort rules share. Each plugin's own tests include this file, because a plugin is a cdylib and cannot be linked
//! into another test.
#![allow(dead_code, reason = "no rule's tests need all of it")]

use shield_api::{
    AbortRule, Host, Plugin, PluginConfig, Reason, Result, Rows, RuleContext, RuleVerdict, Setup, Space,
    Spaces,
};

/// A rule with this configuration, for two dimensions of action.
pub fn create<R: Plugin>(config: &str) -> Result<R> {
    let spaces = Spaces { observation: Space::unbounded(1), action: Space::uniform(2, -1.0, 1.0) };
    R::create(R::Config::parse(config)?, &Setup::with_spaces(0, 1, Host::silent(), spaces))
}

/// The same, of a configuration that can be.
pub fn rule<R: Plugin>(config: &str) -> R {
    create(config).unwrap()
}

/// The reset ensemble's values of a proposed action.
pub fn context<'a>(values: &'a [f32], proposed: &'a [f32]) -> RuleContext<'a> {
    RuleContext { observation: &[0.0], proposed, values, discount: 0.99, ..RuleContext::default() }
}

/// The verdict, and the reason of a rejection.
pub fn judge(rule: &impl AbortRule, context: &RuleContext<'_>) -> (RuleVerdict, String) {
    let mut room = [0; 120];
    let mut reason = Reason::new(&mut room);
    let verdict = rule.evaluate(context, &mut reason).unwrap();
    let length = reason.len();
    (verdict, String::from_utf8(room[..length].to_vec()).unwrap())
}

/// The rows of a rule. One that cannot give them all gives none.
pub fn rows(
    rule: &impl AbortRule,
    context: &RuleContext<'_>,
    gradients: &[f32],
) -> Result<Vec<(Vec<f32>, f32)>> {
    struct Collected(Vec<(Vec<f32>, f32)>);
    impl Rows for Collected {
        fn push(&mut self, coefficients: &[f32], bound: f32) -> Result<()> {
            self.0.push((coefficients.to_vec(), bound));
            Ok(())
        }
    }
    let mut collected = Collected(Vec::new());
    let result = rule.linearise(context, gradients, &mut collected);
    assert!(result.is_ok() || collected.0.is_empty(), "{:?}", collected.0);
    result.map(|()| collected.0)
}

/// Two members and one dimension: gradients that are too few or not finite are refused.
pub fn assert_gradients_are_checked(rule: &impl AbortRule) {
    let probabilities = &[0.8, 0.9];
    let context = RuleContext {
        probabilities,
        greedy_probabilities: probabilities,
        start_probabilities: probabilities,
        ..context(&[8.0, 9.0], &[0.0])
    };
    assert!(rows(rule, &context, &[1.0, 1.0]).is_ok());
    for gradients in [&[1.0][..], &[1.0, f32::NAN], &[]] {
        assert!(rows(rule, &context, gradients).is_err(), "{gradients:?}");
    }
}

/// The state of a rule without state is taken back, and no other is.
pub fn assert_stateless(mut rule: impl AbortRule) {
    let mut bytes = Vec::new();
    rule.save(&mut bytes).unwrap();
    rule.load(&bytes).unwrap();
    assert!(rule.load(&[1]).is_err());
}
