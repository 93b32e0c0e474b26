//! How the threshold follows the outcomes of attempts, and which risk comes of it.

use super::*;

#[test]
fn each_outcome_moves_the_threshold_by_what_was_not_accepted() {
    for (config, outcomes, expected) in [
        ("()", &[][..], 0.8),
        ("(accepted_risk: 0.1)", &[], 0.9),
        ("(hard_resets_per_1000: 2.0)", &[], 0.8),
        ("()", &[false], 0.8 + 0.05 * 0.8),
        ("()", &[false, true], 0.8 + 0.05 * 0.6),
        ("(accepted_risk: 0.4, adaptation_rate: 0.5, initial_threshold: 0.5)", &[false], 0.5 + 0.5 * 0.6),
        // Above its beginning it comes down as fast as the accepted risk says, and not further; below by a share of itself.
        ("(accepted_risk: 0.2, adaptation_rate: 1.0)", &[false, true], 0.8),
        ("()", &[true, true], 0.8 * 0.9975 * 0.9975),
        ("(accepted_risk: 0.01, initial_threshold: 0.5)", &[true], 0.5 * 0.9995),
        ("(initial_threshold: 0.0)", &[true], 0.0),
        ("(adapt: false)", &[false, false, true], 0.8),
        ("()", &[false, false, false, false, false], 1.0),
    ] {
        let mut rule = rule(config);
        end_attempts(&mut rule, outcomes);
        assert!((rule.threshold() - expected).abs() < 1e-6, "{config}: {}", rule.threshold());
    }
    // However far it had come down, a failure brings it back to its beginning.
    let mut rule = rule("()");
    end_attempts(&mut rule, &[true; 400]);
    assert!(rule.threshold() < 0.3, "{}", rule.threshold());
    end_attempts(&mut rule, &[false]);
    assert!((rule.threshold() - 0.8).abs() < 1e-6, "{}", rule.threshold());
}

#[test]
fn a_budget_accepts_failures_by_the_steps_since_the_last_attempt() {
    let mut rule = rule("(hard_resets_per_1000: 4.0)");
    let slowest = 0.8 * (1.0 - 0.05 * 0.05);
    let mut expect = |step: u64, succeeded: bool, moved: f64| {
        rule.observe(&ObservedDecision { step: step - 100, aborted: false, action: &[0.0] }).unwrap();
        let before = rule.threshold();
        rule.observe_attempt(&ObservedAttempt { step, succeeded }).unwrap();
        assert!(
            (rule.threshold() - before - moved).abs() < 1e-7,
            "step {step}: {before} {}",
            rule.threshold()
        );
    };
    // The first decision was made at step 100: 100 steps, of which each accepts 0.004 failures.
    expect(200, true, slowest - 0.8);
    expect(350, false, 0.05 * (1.0 - 0.6));
    expect(450, false, 0.05 * (1.0 - 0.4));
    // More than one failure per attempt there cannot be.
    expect(1450, false, 0.0);
    expect(1450, true, 0.0);
    // A host whose steps begin anew.
    expect(150, true, 0.0);
}

/// A world with a forward agent that goes on until it is rejected. P is what a critic says; the attempt fails where a coin of `failure(P)` says so.
pub fn play(rule: &mut UndoProbability, attempts: u64, failure: impl Fn(f64) -> f64) -> (u64, u64) {
    let mut rng = Pcg64::seed_from_u64(7);
    let (mut failures, mut step) = (0, 0);
    for _ in 0..attempts {
        let mut probability = 1.0_f32;
        while allows(rule, probability, 1.0) && probability > 0.0 {
            rule.observe(&ObservedDecision { step, aborted: false, action: &[0.0] }).unwrap();
            probability = (probability - rng.random_range(0.0..0.05)).max(0.0);
            step += 1;
        }
        step += rng.random_range(10..100);
        let succeeded = rng.random_range(0.0..1.0) >= failure(f64::from(probability));
        failures += u64::from(!succeeded);
        rule.observe_attempt(&ObservedAttempt { step, succeeded }).unwrap();
    }
    (failures, step)
}

#[test]
fn the_realised_risk_is_the_accepted_one_whatever_the_critic_says() {
    const ATTEMPTS: u64 = 4_000;
    let (timid, daring) = (|p: f64| (1.0 - p).powi(2), |p: f64| 1.0 - p.powi(2));
    for (name, failure) in [("too timid", timid as fn(f64) -> f64), ("too daring", daring)] {
        for accepted in [0.1, 0.2, 0.4] {
            let free = "combine: Realist, initial_threshold: 0.0, adaptation_rate: 0.02";
            let mut rule = rule(&format!("(accepted_risk: {accepted}, {free})"));
            let (failures, _) = play(&mut rule, ATTEMPTS, failure);
            // Gibbs and Candès 2021, proposition 4.1, for a threshold that never leaves [0, 1]; a daring critic drives it to 1 at times.
            let bound = 1.0 / (0.02 * ATTEMPTS as f64) + 0.01;
            let realised = failures as f64 / ATTEMPTS as f64;
            assert!((realised - accepted).abs() < bound, "{name}, {accepted}: {realised}");
        }
    }
}

#[test]
fn a_threshold_that_returns_after_failures_keeps_the_realised_risk_below_the_accepted_one() {
    const ATTEMPTS: u64 = 4_000;
    let (timid, daring) = (|p: f64| (1.0 - p).powi(2), |p: f64| 1.0 - p.powi(2));
    for (name, failure) in [("too timid", timid as fn(f64) -> f64), ("too daring", daring)] {
        for accepted in [0.1, 0.2, 0.4] {
            let (failures, _) = play(&mut rule(&format!("(accepted_risk: {accepted})")), ATTEMPTS, failure);
            let realised = failures as f64 / ATTEMPTS as f64;
            assert!(realised < accepted + 0.03, "{name}, {accepted}: {realised}");
        }
    }
}

#[test]
fn attempts_that_fail_at_the_highest_threshold_are_not_made_up_for() {
    // A reset agent that fails every second time, wherever it begins.
    let mut rule = rule("(accepted_risk: 0.1)");
    let (failures, _) = play(&mut rule, 1_000, |_| 0.5);
    assert!((450..550).contains(&failures), "{failures}");
    assert!(allows(&rule, 1.0, 1.0), "it does not lock");
}

#[test]
fn the_budget_of_hard_resets_is_kept() {
    for budget in [2.0, 3.0, 5.0] {
        let free = "initial_threshold: 0.0, adaptation_rate: 0.02";
        let mut rule = rule(&format!("(hard_resets_per_1000: {budget:?}, {free})"));
        let (failures, steps) = play(&mut rule, 4_000, |p| 1.0 - p);
        let allowance = budget * steps as f64 / 1000.0;
        assert!((failures as f64 - allowance).abs() < 1.0 / 0.02, "{budget}: {failures} of {allowance}");
    }
}

#[test]
fn a_rule_that_aborts_at_the_start_unlocks_itself() {
    // No attempt has ever succeeded: the threshold is as high as it can be, and the action a little worse than the start.
    for config in ["()", "(hard_resets_per_1000: 2.0)"] {
        let mut rule = rule(config);
        end_attempts(&mut rule, &[false; 50]);
        assert_eq!(rule.threshold(), 1.0);
        // To abort where nothing has to be undone is an attempt that succeeds, one step later.
        let mut step = 0;
        while !allows(&rule, 0.8, 0.9) {
            step += 1;
            rule.observe_attempt(&ObservedAttempt { step, succeeded: true }).unwrap();
            assert!(step < 2_000, "{config}");
        }
        assert!(step > 0);
    }
}

#[test]
fn a_critic_that_knows_nothing_locks_only_an_absolute_threshold() {
    // Everywhere the same low estimate, and a reset agent that promises a little more.
    let knows_nothing = context(&[0.1; 3], &[0.11; 3], &[0.1; 3]);
    let verdict = |config: &str| judge(&rule(config), &knows_nothing).0.verdict;
    assert_eq!(verdict("(initial_threshold: 1.0)"), Verdict::Allow);
    assert_eq!(verdict("(initial_threshold: 1.0, relative: false)"), Verdict::Reject);
}

#[test]
fn the_realised_risk_is_that_of_the_last_100_attempts() {
    let mut rule = rule("()");
    assert_eq!(rule.history.realised_risk(), None);
    end_attempts(&mut rule, &[false, true, true, true]);
    assert_eq!(rule.history.realised_risk(), Some(0.25));
    end_attempts(&mut rule, &[true; 96]);
    assert_eq!(rule.history.realised_risk(), Some(0.01));
    end_attempts(&mut rule, &[true]);
    assert_eq!(rule.history.realised_risk(), Some(0.0));
    end_attempts(&mut rule, &[false; 150]);
    assert_eq!(rule.history.realised_risk(), Some(1.0));
}
