//! A success critic written in C, a rule in C that is given its estimates, and every way to describe them wrongly.

use shield_api::*;
use shield_runtime::plugin::{LoadedAbortRule, LoadedSuccessCritic, PluginError, Registry, Selection};

use crate::fixtures::{c_critic, c_fixture, check_refusal, setup};

fn critic(name: &str, defines: &[&str]) -> Result<LoadedSuccessCritic, PluginError> {
    let selection = Selection::new("c/critic").at(c_critic(name, defines));
    Registry::default().success_critic(&selection, "()", &setup())
}

fn rule(name: &str, defines: &[&str]) -> Result<LoadedAbortRule, PluginError> {
    let selection = Selection::new("c/gentle").at(c_fixture(name, defines));
    Registry::default().abort_rule(&selection, "()", &setup())
}

fn context<'a>(proposed: &'a [f32], probabilities: &'a [f32]) -> RuleContext<'a> {
    RuleContext {
        observation: &[0.0, 0.0],
        proposed,
        values: &[1.0],
        probabilities,
        greedy_probabilities: &[1.0],
        start_probabilities: &[1.0],
        ..RuleContext::default()
    }
}

fn judge(rule: &LoadedAbortRule, probability: f32) -> RuleVerdict {
    rule.evaluate(&context(&[0.25], &[probability]), &mut Reason::new(&mut [0; 64])).unwrap()
}

fn batch<'a>(outcomes: &'a [f32]) -> AttemptBatch<'a> {
    AttemptBatch {
        size: 2,
        observations: &[0.0; 4],
        actions: &[0.0; 2],
        next_observations: &[0.0; 4],
        next_actions: &[0.0; 2],
        successes: &[0.0; 2],
        continuations: &[1.0; 2],
        outcomes,
        outcome_weights: &[1.0, 0.25],
        masks: &[1.0; 4],
    }
}

#[test]
fn a_success_critic_in_c_estimates_differentiates_learns_and_keeps_its_state() {
    let mut critic = critic("good", &[]).unwrap();
    assert_eq!(critic.info().members, 2);
    let (mut probabilities, mut gradients) = ([0.0; 2], [0.0; 2]);
    critic.gradients(&[0.0; 2], &[1.0], &mut probabilities, &mut gradients).unwrap();
    assert_eq!((probabilities, gradients), ([0.25; 2], [-0.25; 2]));
    let mut before = Vec::new();
    critic.save(&mut before).unwrap();

    critic.update(&batch(&[1.0, 0.0])).unwrap();
    critic.probabilities(&[0.0; 2], &[0.0], &mut probabilities).unwrap();
    assert_eq!(probabilities, [0.8; 2], "by their weights");
    critic.load(&before).unwrap();
    critic.probabilities(&[0.0; 2], &[0.0], &mut probabilities).unwrap();
    assert_eq!(probabilities, [0.5; 2]);
}

#[test]
fn a_success_critic_in_c_may_have_no_gradient() {
    let mut critic = critic("no_gradient", &["NO_GRADIENT"]).unwrap();
    let error = critic.gradients(&[0.0; 2], &[0.0], &mut [0.0; 2], &mut [0.0; 2]).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Unsupported);
}

#[test]
fn an_estimate_in_c_outside_of_0_to_1_is_an_error() {
    for (name, estimate) in [("nan", "NAN"), ("above", "1.5f"), ("below", "-0.25f"), ("infinite", "INFINITY")]
    {
        let define = format!("ESTIMATE={estimate}");
        let mut critic = critic(name, &[&define]).unwrap();
        let error = critic.probabilities(&[0.0; 2], &[0.0], &mut [0.0; 2]).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Failed);
        assert!(error.message().starts_with("c/critic: `probabilities` gave "), "{error}");
    }
}

#[test]
fn a_success_critic_must_have_a_complete_extension() {
    for (name, define, expected) in [
        ("no_extension", "NO_EXTENSION", "it has no extension \"shield.success_critic/1\""),
        ("null_update", "NULL_UPDATE", "`update` of its success-critic table is a null function pointer"),
        ("extension_size", "EXTENSION_SIZE=24", "its success-critic table says struct_size 24, expected 16"),
    ] {
        let error = critic(name, &[define]).unwrap_err().to_string();
        assert!(error.starts_with("c/critic: ") && error.contains(expected), "{error}");
    }
}

#[test]
fn a_success_critic_sets_the_table_of_a_learner_alone() {
    for (name, define, expected) in [
        ("no_table", "NO_TABLE", "the learner table alone must be set, but these are: []"),
        ("two_tables", "TWO_TABLES", "these are: [learner, policy]"),
        ("kind", "KIND=2", "it says the kind \"success-critic\" and the number 2"),
    ] {
        check_refusal(&c_critic(name, &[define]), &[expected]);
    }
}

#[test]
fn a_rule_in_c_is_given_probabilities_and_told_how_attempts_end() {
    let mut rule =
        rule("undo", &["UNDO", "NEEDS=(SHIELD_NEED_PROBABILITIES|SHIELD_NEED_GREEDY_PROBABILITIES)"])
            .unwrap();
    let needs = Needs { probabilities: true, greedy_probabilities: true, ..Needs::default() };
    assert_eq!(rule.needs(), needs);
    assert_eq!(judge(&rule, 0.75), RuleVerdict { verdict: Verdict::Allow, score: 0.75 });
    assert_eq!(judge(&rule, 0.375).verdict, Verdict::Reject, "less than half of the start");

    struct Collected(Vec<(Vec<f32>, f32)>);
    impl Rows for Collected {
        fn push(&mut self, coefficients: &[f32], bound: f32) -> Result<()> {
            self.0.push((coefficients.to_vec(), bound));
            Ok(())
        }
    }
    let mut rows = Collected(Vec::new());
    let of_two = context(&[0.25], &[0.75, 0.5]);
    rule.linearise(&of_two, &[-2.0, -1.0], &mut rows).unwrap();
    assert_eq!(rows.0, [(vec![-2.0], 0.75)]);
    let error = rule.linearise(&of_two, &[-2.0], &mut rows).unwrap_err();
    assert_eq!(
        error.message(),
        "c/gentle: gradients has 1 values, expected 2",
        "one for each estimate, not each value"
    );

    rule.observe_attempt(&ObservedAttempt { step: 7, succeeded: true }).unwrap();
    rule.observe_attempt(&ObservedAttempt { step: 5, succeeded: false }).unwrap();
    let mut bytes = Vec::new();
    rule.save(&mut bytes).unwrap();
    assert_eq!(bytes, [5, 0, 0, 0]);
}

#[test]
fn a_rule_without_the_extension_works_and_is_told_nothing_of_attempts() {
    let mut rule = rule("as_in_1_0", &[]).unwrap();
    assert_eq!(judge(&rule, 0.0).verdict, Verdict::Allow, "it is given no probabilities");
    let saved = |rule: &LoadedAbortRule| {
        let mut bytes = Vec::new();
        rule.save(&mut bytes).map(|()| bytes).unwrap()
    };
    let before = saved(&rule);
    rule.observe_attempt(&ObservedAttempt { step: 5, succeeded: false }).unwrap();
    assert_eq!(saved(&rule), before);
}

/// The functions of 1.0 judge where no probabilities are needed; of attempts it is told all the same.
#[test]
fn a_rule_may_have_the_extension_for_attempts_alone() {
    let mut rule = rule("attempts_alone", &["UNDO"]).unwrap();
    assert_eq!(judge(&rule, 0.0).verdict, Verdict::Allow);
    rule.observe_attempt(&ObservedAttempt { step: 5, succeeded: false }).unwrap();
    let mut bytes = Vec::new();
    rule.save(&mut bytes).unwrap();
    assert_eq!(bytes, [5, 0, 0, 0]);
}

#[test]
fn a_rule_that_needs_probabilities_must_have_a_complete_extension() {
    for (name, defines, expected) in [
        ("needs_8", &["NEEDS=8"][..], "there is no extension \"shield.abort_rule.undo/1\", which takes them"),
        ("needs_16", &["NEEDS=16"], "there is no extension \"shield.abort_rule.undo/1\", which takes them"),
        (
            "null_attempt",
            &["UNDO", "NEEDS=8", "NULL_OBSERVE_ATTEMPT"],
            "`observe_attempt` of its undo-rule table is a null function pointer",
        ),
        (
            "undo_size",
            &["UNDO", "NEEDS=8", "EXTENSION_SIZE=24"],
            "its undo-rule table says struct_size 24, expected 32",
        ),
    ] {
        let error = rule(name, defines).unwrap_err().to_string();
        assert!(error.starts_with("c/gentle: ") && error.contains(expected), "{name}: {error}");
    }
}
