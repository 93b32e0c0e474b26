//! The shield alone: what it allows, and that everything that goes wrong aborts.

#![allow(clippy::unwrap_used, reason = "tests")]

mod common;

use common::{Rule, Scripted, shield};
use shield_api::{AbortRule, ActMode, Error, Learner, Needs, RuleContext, RuleVerdict, Verdict};
use shield_runtime::{
    decision::{Cause, Decision},
    shield::{Agents, Ladder, Moment},
};

const BAD: [f32; 3] = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY];

fn moment(observation: &[f32]) -> Moment<'_> {
    Moment { step: 100, observation, previous: None }
}

fn reset_agent(values: &'static [f32]) -> Scripted {
    Scripted::acting(|_, _| -1.0).valuing(values.len(), move |_, _| values.to_vec())
}

/// Whom a shield asks that has no forward learner.
fn only(reset: &mut Scripted) -> Agents<'_> {
    Agents { reset, forward: None, success: None }
}

/// Decides on `action` at observation 0.
fn decide(rules: Vec<Box<dyn AbortRule>>, mut agent: Scripted, action: &mut [f32]) -> Decision {
    let mut shield = shield(rules, &agent, 0);
    shield.filter(only(&mut agent), &moment(&[0.0]), action)
}

fn cause(decision: Decision) -> Option<Cause> {
    decision.abort().map(|abort| abort.cause)
}

#[test]
fn an_action_that_every_rule_allows_is_left_alone() {
    let mut action = [0.7];
    let decision = decide(vec![Rule::below(0.5), Rule::below(0.9)], reset_agent(&[1.0, 2.0]), &mut action);
    assert_eq!((decision, action), (Decision::Allow, [0.7]));
}

#[test]
fn one_rejecting_rule_aborts_and_the_buffer_holds_the_reset_agents_action() {
    let mut action = [0.7];
    let decision = decide(vec![Rule::below(0.5), Rule::below(1.5)], reset_agent(&[1.0, 2.0]), &mut action);
    let abort = decision.abort().unwrap();
    assert_eq!((abort.cause, abort.rule, abort.score), (Cause::Rejected, Some(1), 1.0));
    assert_eq!(action, [-1.0], "the reset agent's action");
}

#[test]
fn an_unusable_reset_action_gives_way_to_the_fallback() {
    for bad in [BAD[0], BAD[1], BAD[2], 1.5] {
        let agent = Scripted::acting(move |_, mode| if mode == ActMode::Greedy { bad } else { 0.0 });
        let mut action = [0.7];
        assert!(decide(vec![Rule::below(5.0)], agent, &mut action).abort().is_some());
        assert_eq!(action, [-0.25], "reset action {bad}");
    }
}

#[test]
fn non_finite_numbers_and_wrong_lengths_abort() {
    let rules = || vec![Rule::judging(|_| Ok(RuleVerdict::from_safe(true, 1.0)))];
    for bad in BAD {
        assert_eq!(
            cause(decide(rules(), reset_agent(&[1.0]), &mut [bad])),
            Some(Cause::InvalidAction),
            "{bad}"
        );
        let values = Scripted::acting(|_, _| -1.0).valuing(2, move |_, _| vec![1.0, bad]);
        assert_eq!(cause(decide(rules(), values, &mut [0.0])), Some(Cause::ValuesFailed), "{bad}");
        let mut agent = reset_agent(&[1.0]);
        let mut shield = shield(rules(), &agent, 0);
        let decision = shield.filter(only(&mut agent), &moment(&[bad]), &mut [0.0]);
        assert_eq!(cause(decision), Some(Cause::InvalidObservation), "{bad}");
        let mut forward = Scripted::acting(|_, _| 0.0).valuing(2, move |_, _| vec![1.0, bad]);
        let needs = Needs { forward_values: true, ..Needs::default() };
        let allow = Box::new(|_: &RuleContext<'_>| Ok(RuleVerdict::from_safe(true, 1.0)));
        let rule: Box<dyn AbortRule> = Box::new(Rule { needs, judge: allow });
        let mut curious = common::shield(vec![rule], &agent, 0);
        let agents = Agents { reset: &mut agent, forward: Some(&mut forward), success: None };
        let decision = curious.filter(agents, &moment(&[0.0]), &mut [0.0]);
        assert_eq!(cause(decision), Some(Cause::ValuesFailed), "{bad}");
    }
    for length in [0, 2] {
        let mut action = vec![0.5; length];
        assert_eq!(cause(decide(rules(), reset_agent(&[1.0]), &mut action)), Some(Cause::InvalidAction));
        assert!(
            action.iter().all(|value| *value != 0.5),
            "a rejected action stays in the buffer: {action:?}"
        );
        let mut agent = reset_agent(&[1.0]);
        let mut shield = shield(rules(), &agent, 0);
        let decision = shield.filter(only(&mut agent), &moment(&vec![0.0; length]), &mut [0.0]);
        assert_eq!(cause(decision), Some(Cause::InvalidObservation));
    }
    assert_eq!(cause(decide(rules(), reset_agent(&[1.0]), &mut [1.01])), Some(Cause::InvalidAction));
}

#[test]
fn a_failing_rule_or_agent_leads_to_an_abort() {
    let failing = Rule::judging(|_| Err(Error::failed("the rule has a headache")));
    let mut agent = reset_agent(&[1.0]);
    let mut broken = shield(vec![failing], &agent, 0);
    let decision = broken.filter(only(&mut agent), &moment(&[0.0]), &mut [0.0]);
    assert_eq!(decision.abort().map(|abort| (abort.cause, abort.rule)), Some((Cause::RuleFailed, Some(0))));
    assert_eq!(broken.reason(), "the rule has a headache");

    let not_a_number = Rule::judging(|_| Ok(RuleVerdict { verdict: Verdict::Allow, score: f32::NAN }));
    assert_eq!(cause(decide(vec![not_a_number], reset_agent(&[1.0]), &mut [0.0])), Some(Cause::RuleFailed));

    let silent = Scripted::acting(|_, _| -1.0).valuing(1, |_, _| Vec::new());
    assert_eq!(cause(decide(vec![Rule::below(0.0)], silent, &mut [0.0])), Some(Cause::ValuesFailed));
}

#[test]
fn the_warm_up_asks_no_rule_that_needs_learned_values_and_refuses_invalid_actions() {
    let mut agent = reset_agent(&[0.0]);
    let mut shield = shield(vec![Rule::below(5.0)], &agent, 200);
    assert_eq!(shield.filter(only(&mut agent), &moment(&[0.0]), &mut [0.3]), Decision::WarmUp);
    assert_eq!(
        cause(shield.filter(only(&mut agent), &moment(&[0.0]), &mut [f32::NAN])),
        Some(Cause::InvalidAction)
    );
    let later = Moment { step: 200, ..moment(&[0.0]) };
    assert_eq!(cause(shield.filter(only(&mut agent), &later, &mut [0.3])), Some(Cause::Rejected));
}

/// A limit of the user's: it needs nothing learned.
fn at_most(limit: f32) -> Box<dyn AbortRule> {
    let judge = move |context: &RuleContext<'_>| {
        Ok(RuleVerdict::from_safe(context.proposed[0] <= limit, context.proposed[0]))
    };
    Box::new(Rule { needs: Needs::default(), judge: Box::new(judge) })
}

#[test]
fn a_rule_that_needs_nothing_learned_applies_from_the_first_step() {
    let mut agent = reset_agent(&[0.0]);
    let mut shield = shield(vec![Rule::below(5.0), at_most(0.4)], &agent, 200);
    let first = Moment { step: 0, ..moment(&[0.0]) };
    assert_eq!(shield.filter(only(&mut agent), &first, &mut [0.3]), Decision::WarmUp);
    let mut action = [0.5];
    let abort = shield.filter(only(&mut agent), &first, &mut action).abort().unwrap();
    assert_eq!((abort.cause, abort.rule, action), (Cause::Rejected, Some(1), [-1.0]));
}

#[test]
fn a_limit_holds_for_the_reset_agents_actions() {
    let mut agent = Scripted::acting(|_, mode| if mode == ActMode::Greedy { 0.2 } else { 0.9 });
    let mut limited = shield(vec![Rule::below(5.0), at_most(0.4)], &agent, 0);
    let mut action = [0.9];
    let decision = limited.limit(only(&mut agent), &moment(&[0.0]), &mut action).unwrap();
    assert_eq!((decision.abort().map(|abort| abort.rule), action), (Some(Some(1)), [0.2]));
    // Rules that need learned values do not judge it: the reset agent could never act where they reject everything.
    let mut action = [0.3];
    assert!(limited.limit(only(&mut agent), &moment(&[0.0]), &mut action).unwrap().abort().is_none());
    assert_eq!(action, [0.3]);

    let mut without = shield(vec![Rule::below(5.0)], &agent, 0);
    assert!(without.limit(only(&mut agent), &moment(&[0.0]), &mut [0.9]).is_none());
}

#[test]
fn a_reset_action_that_breaks_a_limit_gives_way_to_the_fallback() {
    let agent = Scripted::acting(|_, _| 0.8).valuing(1, |_, _| vec![0.0]);
    let mut action = [0.3];
    assert!(decide(vec![Rule::below(5.0), at_most(0.4)], agent, &mut action).abort().is_some());
    assert_eq!(action, [-0.25], "neither the proposed action nor the reset agent's");
}

#[test]
fn values_that_no_rule_needs_are_not_computed() {
    let count = std::sync::Arc::new(std::sync::atomic::AtomicU32::new(0));
    for (needs, expected) in [
        (Needs::default(), 0),
        (Needs { values: true, ..Needs::default() }, 1),
        (Needs { values: true, greedy_values: true, ..Needs::default() }, 2),
    ] {
        let counter = count.clone();
        counter.store(0, std::sync::atomic::Ordering::Relaxed);
        let mut agent = Scripted::acting(|_, _| -1.0).valuing(1, move |_, action| {
            counter.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
            vec![action]
        });
        let rule = Rule {
            needs,
            judge: Box::new(move |context| {
                assert_eq!(context.values, if needs.values { &[0.5][..] } else { &[] });
                assert_eq!(context.greedy_values, if needs.greedy_values { &[-1.0][..] } else { &[] });
                Ok(RuleVerdict::from_safe(true, 0.0))
            }),
        };
        let mut shield: Ladder = shield(vec![Box::new(rule)], &agent as &dyn Learner, 0);
        assert_eq!(shield.filter(only(&mut agent), &moment(&[0.0]), &mut [0.5]), Decision::Allow);
        assert_eq!(count.load(std::sync::atomic::Ordering::Relaxed), expected);
    }
}

#[test]
fn a_fallback_outside_the_action_space_is_refused_when_the_shield_is_built() {
    let agent = reset_agent(&[1.0]);
    let settings = shield_runtime::shield::LadderSettings {
        spaces: common::spaces(),
        warm_up_steps: 0,
        fallback_action: vec![2.0],
    };
    let rules: Vec<Box<dyn AbortRule>> = vec![Rule::below(0.0)];
    assert!(Ladder::new(rules, &agent, settings).is_err());
}
