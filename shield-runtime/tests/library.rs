//! The shield in a program of one's own, and around an environment.
#![allow(clippy::unwrap_used, reason = "a test")]

mod common;

use common::{EPISODE, Line, PIT, Rule, Scripted, spaces};
use shield_api::{AbortRule, Phase, ResetSignal, RuleVerdict};
use shield_runtime::{
    cycle::HardResetDue,
    decision::{Cause, Decision},
    drop_in::{DropIn, DropInBuilder, Learning},
    experience::Experience,
    shielded::{Shielded, ShieldedStep, StepEnd},
};

/// Rejects what leads into the pit.
fn no_pit() -> Box<dyn AbortRule> {
    Rule::judging(|context| {
        let falls = context.observation[0] >= (PIT - 1) as f32 && context.proposed[0] > 0.0;
        Ok(RuleVerdict::from_safe(!falls, context.observation[0]))
    })
}

/// Walks left.
fn homing() -> Scripted {
    Scripted::acting(|_, _| -1.0)
}

fn builder(agent: Scripted) -> DropInBuilder {
    DropIn::builder(spaces(), Box::new(agent)).rule(no_pit()).attempt_length(EPISODE as u64)
}

/// Cell 0 is home.
fn signal(cell: f32) -> Option<ResetSignal> {
    Some(ResetSignal { reward: 1.0 - cell / 10.0, in_reset_set: cell == 0.0 })
}

#[test]
fn a_program_that_executes_the_buffer_never_falls_and_is_brought_back() {
    let mut shield = builder(homing()).build().unwrap();
    let (mut cell, mut seen) = (0.0_f32, Vec::new());
    for _ in 0..14 {
        let mut action = [1.0];
        let decision = shield.filter(&[cell], &mut action).unwrap();
        seen.push(match decision {
            Decision::Allow => 'f',
            Decision::Abort(_) => 'a',
            Decision::Resetting => 'r',
            other => panic!("{other:?}"),
        });
        cell = (cell + action[0]).max(0.0);
        shield.observe(&[cell], signal(cell), false).unwrap();
        assert!(cell < PIT as f32 && !shield.needs_hard_reset());
    }
    assert_eq!(seen.into_iter().collect::<String>(), "fffarrfffarrff");
}

#[test]
fn the_last_failed_attempt_requires_a_hard_reset_before_any_action() {
    // It walks the wrong way.
    let lost = || Scripted::acting(|_, _| 0.5);
    let step = |shield: &mut DropIn| {
        let mut action = [0.0];
        let decision = shield.filter(&[1.0], &mut action).unwrap();
        shield.observe(&[1.0], signal(1.0), false).unwrap();
        (decision, action)
    };
    for (limit, episodes) in [(Some(1), 1), (Some(3), 3)] {
        let mut shield = builder(lost()).reset_attempts(limit).build().unwrap();
        assert_eq!(step(&mut shield).0, Decision::Allow);
        for episode in 0..episodes {
            assert!(!shield.needs_hard_reset(), "after {episode} episodes of {limit:?}");
            shield.begin_reset();
            for _ in 0..EPISODE {
                assert_eq!(shield.phase(), Phase::Reset);
                assert_eq!(step(&mut shield), (Decision::Resetting, [0.5]));
            }
        }
        assert_eq!(shield.hard_reset_due(), Some(HardResetDue::CycleOver));
        let mut action = [0.25];
        let abort = shield.filter(&[0.0], &mut action).unwrap().abort().unwrap();
        assert_eq!((abort.cause, action), (Cause::AwaitsHardReset, [0.0]));
        shield.hard_reset_done(&[0.0]).unwrap();
        assert!(!shield.needs_hard_reset());
        assert_eq!(shield.filter(&[0.0], &mut [0.25]).unwrap(), Decision::Allow);
    }
    let mut patient = builder(lost()).reset_attempts(None).build().unwrap();
    step(&mut patient);
    for _ in 0..5 * EPISODE {
        patient.begin_reset();
        step(&mut patient);
        assert!(!patient.needs_hard_reset());
    }
}

#[test]
fn a_failing_reset_agent_gives_way_to_the_fallback_action() {
    let in_attempt = |agent: Scripted| {
        let mut shield = builder(agent).fallback_action(vec![-0.25]).build().unwrap();
        shield.filter(&[1.0], &mut [0.0]).unwrap();
        shield.observe(&[1.0], signal(1.0), false).unwrap();
        assert!(shield.begin_reset());
        shield
    };
    for bad in [f32::NAN, f32::NEG_INFINITY, 1.5] {
        let mut shield = in_attempt(Scripted::acting(move |_, _| bad));
        let mut action = [0.9];
        let abort = shield.filter(&[0.0], &mut action).unwrap().abort().unwrap();
        assert_eq!((abort.cause, action), (Cause::ResetFailed, [-0.25]), "{bad}");
    }
    let mut shield = in_attempt(homing());
    assert!(shield.filter(&[f32::NAN], &mut [0.0]).unwrap().abort().is_some());
}

#[test]
fn an_invalid_shield_is_refused() {
    assert!(DropIn::builder(spaces(), Box::new(homing())).build().is_err(), "without a rule");
    assert!(builder(homing()).reset_attempts(Some(0)).build().is_err());
    assert!(builder(homing()).attempt_length(0).build().is_err());
    assert!(builder(homing()).fallback_action(vec![2.0]).build().is_err());
}

#[test]
fn an_agent_in_a_shielded_environment_never_falls_and_needs_no_hard_reset() {
    let line = Line::new();
    let (log, resets) = (line.log.clone(), line.resets.clone());
    let agent = homing();
    let seen = agent.seen.clone();
    let experience = Experience::new(10, &spaces(), [0, 1], 1.0).unwrap();
    let learning = Learning { updates_per_step: 2, ..Learning::new(experience, 1, 7) };
    let mut line = Shielded::new(line, None, builder(agent).learning(learning).build().unwrap()).unwrap();
    let mut observation = [f32::NAN];
    let mut aborts = 0;
    line.reset(0, &mut observation).unwrap();
    for _ in 0..40 {
        let before = observation;
        let ShieldedStep { outcome, end, decision, reason } = line.step(&[1.0], &mut observation).unwrap();
        assert!(!outcome.irreversible && end != StepEnd::Terminated);
        assert_eq!(reason.is_empty(), end == StepEnd::Continues);
        if end == StepEnd::Truncated {
            aborts += 1;
            assert!(matches!(decision, Decision::Abort(_)));
            assert_eq!((observation, outcome.forward_reward), (before, 0.0), "it was executed");
            line.reset(aborts, &mut observation).unwrap();
            assert_eq!(observation, [0.0]);
        }
    }
    assert_eq!((aborts, line.hard_resets(), resets.lock().unwrap().len()), (10, 0, 1));
    let log = log.lock().unwrap();
    assert_eq!(seen.lock().unwrap().len(), 2 * log.len(), "it learns from every step");
    assert!(log.iter().all(|(cell, action)| *cell < PIT - 1 || *action < 0.0));
}

#[test]
fn a_shielded_environment_is_hard_reset_after_a_failed_attempt_or_its_end() {
    let line = Line::new();
    let resets = line.resets.clone();
    let shield = builder(Scripted::acting(|_, _| 1.0)).build().unwrap();
    let mut line = Shielded::new(line, None, shield).unwrap();
    let mut observation = [f32::NAN];
    line.reset(0, &mut observation).unwrap();
    line.step(&[1.0], &mut observation).unwrap();
    line.reset(1, &mut observation).unwrap();
    assert_eq!((line.hard_resets(), resets.lock().unwrap().len(), observation), (1, 2, [0.0]));
    // An environment that cannot go on is reset at once.
    let mut ending = Line::new();
    ending.terminates_at = Some(1);
    let mut ending = Shielded::new(ending, None, builder(homing()).build().unwrap()).unwrap();
    ending.reset(0, &mut observation).unwrap();
    assert_eq!(ending.step(&[1.0], &mut observation).unwrap().end, StepEnd::Terminated);
    ending.reset(1, &mut observation).unwrap();
    assert_eq!((ending.hard_resets(), observation), (1, [0.0]));
}
