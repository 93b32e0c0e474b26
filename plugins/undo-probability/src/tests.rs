mod threshold;

use allocation_counter::measure;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use shield_api::{ErrorKind, PluginConfig, Verdict};

use self::threshold::play;
use super::*;
use crate::support::{assert_gradients_are_checked, create, judge, rows};

const COMBINATIONS: [&str; 5] = ["Optimistic", "Realist", "Pessimistic", "Quantile(0.5)", "KOfN(1)"];

fn rule(config: &str) -> UndoProbability {
    support::rule(config)
}

/// P(s, a) of each member, and what the reset agent's own action is worth here and was worth at the start.
fn context<'a>(now: &'a [f32], greedy: &'a [f32], start: &'a [f32]) -> RuleContext<'a> {
    RuleContext {
        probabilities: now,
        greedy_probabilities: greedy,
        start_probabilities: start,
        ..support::context(&[], &[0.5])
    }
}

/// Judged where the reset agent would be safer.
fn allows(rule: &UndoProbability, now: f32, start: f32) -> bool {
    judge(rule, &context(&[now], &[1.0], &[start])).0.verdict == Verdict::Allow
}

fn end_attempts(rule: &mut UndoProbability, outcomes: &[bool]) {
    for succeeded in outcomes {
        rule.observe_attempt(&ObservedAttempt { step: 0, succeeded: *succeeded }).unwrap();
    }
}

fn saved(rule: &UndoProbability) -> Vec<u8> {
    let mut bytes = Vec::new();
    rule.save(&mut bytes).unwrap();
    bytes
}

#[test]
fn an_action_is_executed_where_it_can_be_undone_often_enough() {
    for (config, now, start, is_allowed) in [
        ("()", 0.8, 1.0, true),
        ("()", 0.79, 1.0, false),
        ("(initial_threshold: 0.5)", 0.5, 1.0, true),
        // Of a start from which only 4 of 10 resets succeed, half is 2 of 10.
        ("(initial_threshold: 0.5)", 0.2, 0.4, true),
        ("(initial_threshold: 0.5)", 0.19, 0.4, false),
        ("(relative: false)", 0.7, 0.4, false),
        ("(relative: false)", 0.8, 0.0, true),
        ("(initial_threshold: 1.0)", 0.4, 0.4, true),
        // A loss of 0.02 is never worth an abort.
        ("(initial_threshold: 1.0)", 0.385, 0.4, true),
        ("(initial_threshold: 1.0)", 0.375, 0.4, false),
        ("()", 0.0, 0.02, true),
        ("(initial_threshold: 0.0, relative: false)", 0.0, 1.0, true),
        ("(adapt: false, initial_threshold: 0.3)", 0.3, 1.0, true),
    ] {
        assert_eq!(allows(&rule(config), now, start), is_allowed, "{config} {now} {start}");
    }
}

#[test]
fn each_way_to_combine_is_used_for_the_action_and_for_the_start() {
    let (now, start) = ([0.1, 0.4, 0.7], [0.4, 0.8, 0.9]);
    for (combine, score, verdict) in [
        ("Optimistic", 0.7, Verdict::Allow),
        ("Realist", 0.4, Verdict::Allow),
        ("Pessimistic", 0.1, Verdict::Reject),
        ("Quantile(0.5)", 0.4, Verdict::Allow),
        ("KOfN(2)", 0.4, Verdict::Allow),
        ("KOfN(3)", 0.1, Verdict::Reject),
    ] {
        let (judged, _) = judge(
            &rule(&format!("(initial_threshold: 0.5, combine: {combine})")),
            &context(&now, &[1.0; 3], &start),
        );
        assert_eq!((judged.score, judged.verdict), (score, verdict), "{combine}");
    }
}

#[test]
fn an_action_is_executed_where_taking_over_would_be_no_safer() {
    let verdict = |config: &str, now: &[f32], greedy: &[f32]| {
        judge(&rule(config), &context(now, greedy, &[1.0; 2])).0.verdict
    };
    assert_eq!(verdict("()", &[0.1, 0.1], &[0.1, 0.1]), Verdict::Allow);
    assert_eq!(verdict("()", &[0.1, 0.1], &[0.1, 0.11]), Verdict::Reject);
    // Before the reset agent's own action is valued, nothing speaks for a rejected action.
    assert_eq!(verdict("()", &[0.1, 0.1], &[]), Verdict::Reject);
    assert_eq!(verdict("()", &[0.9, 0.9], &[]), Verdict::Allow);
    // The members' differences are combined, not their probabilities: here −0.1 and 0.2, though the smallest of each is equal.
    let (now, greedy) = ([0.1, 0.4], [0.2, 0.2]);
    assert_eq!(verdict("(combine: Pessimistic)", &now, &greedy), Verdict::Reject);
    assert_eq!(verdict("(combine: Realist)", &now, &greedy), Verdict::Allow);
}

#[test]
fn a_probability_that_is_none_rejects_the_action() {
    for config in COMBINATIONS.map(|combine| format!("(combine: {combine})")) {
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -0.1, 1.1] {
            let (good, spoilt) = ([0.9, 0.9], [0.9, bad]);
            for context in [
                context(&spoilt, &good, &good),
                context(&good, &spoilt, &good),
                context(&good, &good, &spoilt),
            ] {
                let error = rule(&config).evaluate(&context, &mut Reason::new(&mut [])).unwrap_err();
                assert!(error.message().contains("probabilities[1] is"), "{config} {error}");
            }
        }
    }
    let absolute = rule("(relative: false)");
    assert!(absolute.evaluate(&context(&[0.9], &[0.9], &[]), &mut Reason::new(&mut [])).is_ok());
}

#[test]
fn an_action_that_is_not_finite_or_missing_probabilities_are_errors() {
    let fails = |context: &RuleContext<'_>| {
        rule("()").evaluate(context, &mut Reason::new(&mut [])).unwrap_err().kind()
            == ErrorKind::InvalidArgument
    };
    let usual = context(&[0.9; 2], &[0.9; 2], &[0.9; 2]);
    assert!(fails(&RuleContext { proposed: &[f32::NAN], ..usual }));
    for context in [
        context(&[], &[], &[]),
        context(&[0.9; 2], &[0.9; 2], &[]),
        context(&[0.9; 2], &[0.9; 1], &[0.9; 2]),
        context(&[0.9; 2], &[0.9; 2], &[0.9; 3]),
    ] {
        assert!(fails(&context), "{context:?}");
    }
}

#[test]
fn a_rejection_says_how_many_such_actions_could_be_undone() {
    let (_, reason) = judge(&rule("(initial_threshold: 0.8)"), &context(&[0.6], &[0.9], &[1.0]));
    assert_eq!(reason, "6 of 10 such actions could be undone; 8 of 10 are required");
    let (_, reason) = judge(&rule("()"), &context(&[0.8], &[0.9], &[1.0]));
    assert_eq!(reason, "");
}

#[test]
fn every_setting_out_of_range_or_without_effect_is_refused() {
    for (text, field) in [
        ("(accepted_risk: 0.0)", "accepted_risk"),
        ("(accepted_risk: 1.0)", "accepted_risk"),
        ("(accepted_risk: NaN)", "accepted_risk"),
        ("(accepted_risk: 0.1, adapt: false)", "accepted_risk"),
        ("(hard_resets_per_1000: 0.0)", "hard_resets_per_1000"),
        ("(hard_resets_per_1000: inf)", "hard_resets_per_1000"),
        ("(hard_resets_per_1000: NaN)", "hard_resets_per_1000"),
        ("(hard_resets_per_1000: 1.0, adapt: false)", "hard_resets_per_1000"),
        ("(accepted_risk: 0.2, hard_resets_per_1000: 1.0)", "hard_resets_per_1000"),
        ("(combine: KOfN(0))", "combine"),
        ("(combine: Quantile(NaN))", "combine"),
        ("(adaptation_rate: 0.0)", "adaptation_rate"),
        ("(adaptation_rate: NaN)", "adaptation_rate"),
        ("(adaptation_rate: 1.5)", "adaptation_rate"),
        ("(initial_threshold: -0.1)", "initial_threshold"),
        ("(initial_threshold: 1.1)", "initial_threshold"),
        ("(initial_threshold: NaN)", "initial_threshold"),
    ] {
        let error = create::<UndoProbability>(text).unwrap_err();
        assert_eq!((error.kind(), error.field()), (ErrorKind::InvalidConfig, Some(field)), "{text}: {error}");
    }
    assert!(Config::parse("(risk: 0.1)").is_err());
}

#[test]
fn rows_hold_where_the_linearised_probability_suffices() {
    // Around 0.5: P₀ = 0.3 + 0.4 (a − 0.5) and P₁ = 0.2 − 0.2 (a − 0.5); half of 0.8 is required.
    const HALF: &str = "initial_threshold: 0.5";
    let context = context(&[0.3, 0.2], &[0.9; 2], &[0.8; 2]);
    let found = |config: &str| rows(&rule(&format!("({HALF}, {config})")), &context, &[0.4, -0.2]).unwrap();
    let near = |found: &[(Vec<f32>, f32)], expected: &[(f32, f32)]| {
        assert_eq!(found.len(), expected.len(), "{found:?}");
        for ((row, bound), (slope, limit)) in found.iter().zip(expected) {
            assert!((row[0] - slope).abs() < 1e-6 && (bound - limit).abs() < 1e-6, "{found:?}");
        }
    };
    near(&found("combine: Realist"), &[(-0.1, 0.25 - 0.05 - 0.4)]);
    near(&found("combine: Pessimistic"), &[(-0.4, 0.3 - 0.2 - 0.4), (0.2, 0.2 + 0.1 - 0.4)]);
    near(&found("combine: Optimistic"), &[(-0.4, 0.3 - 0.2 - 0.4)]);
    near(&found("combine: Realist, relative: false"), &[(-0.1, 0.25 - 0.05 - 0.5)]);
}

#[test]
fn gradients_and_probabilities_that_are_none_give_no_rows() {
    for combine in COMBINATIONS {
        let rule = rule(&format!("(combine: {combine})"));
        assert_gradients_are_checked(&rule);
        for context in [
            context(&[0.9, f32::NAN], &[0.9; 2], &[0.9; 2]),
            context(&[0.9; 2], &[0.9; 2], &[0.9, f32::NAN]),
            context(&[], &[], &[]),
        ] {
            assert!(rows(&rule, &context, &[0.1, 0.1]).is_err(), "{context:?}");
        }
    }
}

#[test]
fn judging_allocates_nothing_after_the_first_time() {
    let rule = rule("(combine: Quantile(0.5))");
    let (mut room, members) = ([0; 120], [0.1; 20]);
    let context = context(&members, &[0.2; 20], &[1.0; 20]);
    let mut judge = || rule.evaluate(&context, &mut Reason::new(&mut room)).unwrap().verdict;
    assert_eq!(judge(), Verdict::Reject);
    let count = measure(|| assert_eq!(judge(), Verdict::Reject)).count_total;
    assert_eq!(count, 0);
}

#[test]
fn its_state_is_restored_also_into_other_settings() {
    let mut first = rule("(hard_resets_per_1000: 5.0)");
    play(&mut first, 137, |p| 1.0 - p);
    let bytes = saved(&first);
    for config in
        ["(hard_resets_per_1000: 5.0)", "(accepted_risk: 0.1, combine: Pessimistic, relative: false)"]
    {
        let mut other = rule(config);
        other.load(&bytes).unwrap();
        assert_eq!(saved(&other), bytes);
        assert_eq!(other.threshold(), first.threshold());
    }
    let mut stays = rule("(adapt: false, initial_threshold: 0.3)");
    stays.load(&bytes).unwrap();
    assert!((stays.threshold() - 0.3).abs() < 1e-6);

    let mut second = rule("(hard_resets_per_1000: 5.0)");
    second.load(&bytes).unwrap();
    assert_eq!(play(&mut first, 50, |p| 1.0 - p), play(&mut second, 50, |p| 1.0 - p));
    assert_eq!(saved(&first), saved(&second));
}

#[test]
fn a_foreign_or_impossible_state_is_refused_and_changes_nothing() {
    let mut rule = rule("()");
    rule.observe(&ObservedDecision { step: 3, aborted: false, action: &[0.0] }).unwrap();
    end_attempts(&mut rule, &[false, true]);
    let bytes = saved(&rule);
    let header = b"shield/undo-probability/1\n".len();
    // Threshold, whether steps have begun, and the last step, the attempts, the failures, the last outcomes.
    let [threshold, begun, attempts, failures, recent] = [0, 8, 17, 25, 33].map(|offset| header + offset);
    let with = |at: usize, part: &[u8]| {
        let mut bytes = bytes.clone();
        bytes[at..at + part.len()].copy_from_slice(part);
        bytes
    };
    let mut bad: Vec<Vec<u8>> = (0..bytes.len()).map(|length| bytes[..length].to_vec()).collect();
    bad.push([&bytes[..], &[0]].concat());
    bad.push(with(0, b"S"));
    bad.push(with(header - 2, b"2"));
    bad.extend([f64::NAN, f64::INFINITY, -0.1, 1.1].map(|value| with(threshold, &value.to_le_bytes())));
    bad.extend([0, 2].map(|flag: u8| with(begun, &[flag])));
    bad.extend([0, 1].map(|count: u64| with(attempts, &count.to_le_bytes())));
    bad.extend([0, 2].map(|count: u64| with(failures, &count.to_le_bytes())));
    bad.extend([0, 0b111, 0b100].map(|bits: u128| with(recent, &bits.to_le_bytes())));
    for bytes in bad {
        assert!(rule.load(&bytes).is_err(), "{bytes:?}");
    }
    assert_eq!(saved(&rule), bytes);
    rule.load(&bytes).unwrap();
}
