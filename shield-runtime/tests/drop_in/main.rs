//! The shield in somebody else's loop.
#![allow(clippy::unwrap_used, reason = "a test")]

#[path = "../common/mod.rs"]
mod common;
mod files;
mod frozen;

use std::{fs, ops::Range, path::Path, thread};

use common::{EPISODE, Rule, Scripted, Seen, spaces};
use shield_api::{
    AbortRule, Checkpoint, Error, ErrorKind, Phase, ResetSignal, ResetTask, RuleVerdict, Space, Spaces,
};
use shield_runtime::{
    decision::{Cause, Decision},
    drop_in::{DropIn, DropInBuilder, Learning},
    drop_in_files,
    experience::Experience,
    experiment::{DropInFile, Endings, OnResetFailure, OnResetSuccess, Override, Updates},
};

/// Rejects actions above a half.
fn moderate() -> Box<dyn AbortRule> {
    Rule::judging(|context| Ok(RuleVerdict::from_safe(context.proposed[0] <= 0.5, context.proposed[0])))
}

fn builder(agent: Scripted) -> DropInBuilder {
    DropIn::builder(spaces(), Box::new(agent)).rule(moderate()).attempt_length(EPISODE as u64)
}

fn learning(updates: Updates, endings: Endings) -> Learning {
    let experience = Experience::new(100, &spaces(), [0, 1], 1.0).unwrap();
    Learning { updates, endings, ..Learning::new(experience, 1, 0) }
}

fn signal(cell: f32) -> Option<ResetSignal> {
    Some(ResetSignal { reward: 1.0 - cell / 10.0, in_reset_set: cell == 0.0 })
}

/// One step of a loop in which every action leads by as much.
fn step(drop_in: &mut DropIn, cell: &mut f32, proposed: f32) -> Decision {
    let mut action = [proposed];
    let decision = drop_in.filter(&[*cell], &mut action).unwrap();
    *cell = (*cell + action[0]).max(0.0);
    drop_in.observe(&[*cell], signal(*cell), false).unwrap();
    decision
}

fn metric(drop_in: &DropIn, wanted: &str) -> f64 {
    let mut found = f64::NAN;
    drop_in.metrics(&mut |name, value| {
        if name == wanted {
            found = value
        }
    });
    found
}

#[test]
fn steps_episodes_and_aborts_are_counted() {
    let mut drop_in = builder(Scripted::acting(|_, _| -1.0)).build().unwrap();
    let mut cell = 0.0;
    for proposed in [0.5, 0.5, 0.5] {
        assert_eq!(step(&mut drop_in, &mut cell, proposed), Decision::Allow);
    }
    assert!(
        matches!(step(&mut drop_in, &mut cell, 0.75), Decision::Abort(abort) if abort.cause == Cause::Rejected)
    );
    assert_eq!((drop_in.phase(), cell), (Phase::Reset, 0.5));
    assert_eq!(step(&mut drop_in, &mut cell, 0.5), Decision::Resetting);
    assert_eq!((drop_in.phase(), cell), (Phase::Forward, 0.0));
    assert!(!drop_in.begin_reset(), "there is nothing to undo");
    step(&mut drop_in, &mut cell, 0.5);
    assert!(drop_in.begin_reset());
    let names =
        ["steps", "forward_steps", "forward_episodes", "reset_episodes", "early_aborts", "hard_resets"];
    let found = names.map(|name| metric(&drop_in, name));
    assert_eq!(found, [6.0, 4.0, 2.0, 2.0, 1.0, 0.0]);
    assert_eq!(metric(&drop_in, "reset_successes"), 1.0);
}

#[test]
fn the_agent_learns_from_the_configured_steps_and_endings() {
    let usual = Endings::default();
    let strict = Endings { on_success: OnResetSuccess::Terminal, on_failure: OnResetFailure::Zero };
    // Two forward steps, then a reset episode that fails (it stays), continuations of what is learned from.
    for (updates, endings, learned, last) in [
        (Updates::Both, usual, 2 + EPISODE, 1.0),
        (Updates::Active, usual, EPISODE, 1.0),
        (Updates::Both, strict, 2 + EPISODE, 0.0),
    ] {
        let agent = Scripted::acting(|_, _| 0.0);
        let seen = agent.seen.clone();
        let mut drop_in = builder(agent).learning(learning(updates, endings)).build().unwrap();
        let mut cell = 1.0;
        for _ in 0..2 {
            step(&mut drop_in, &mut cell, 0.5);
        }
        drop_in.begin_reset();
        for _ in 0..EPISODE {
            step(&mut drop_in, &mut cell, 0.5);
        }
        assert!(drop_in.needs_hard_reset());
        assert_eq!(seen.lock().unwrap().len(), learned, "{updates:?}");
        // Uniform draws of a memory that holds the last step among others: it is seen sooner or later.
        for _ in 0..200 {
            drop_in.hard_reset_done(&[1.0]).unwrap();
            step(&mut drop_in, &mut 1.0, 0.5);
            drop_in.begin_reset();
            step(&mut drop_in, &mut 1.0, 0.5);
        }
        let continuations = seen.lock().unwrap().iter().map(|seen| seen.1).fold(1.0, f32::min);
        assert_eq!(continuations, last, "{endings:?}");
    }
}

#[test]
fn no_action_is_executed_between_a_fault_and_the_hard_reset() {
    let mut drop_in = builder(Scripted::acting(|_, _| -1.0)).build().unwrap();
    assert!(drop_in.observe(&[0.0], signal(0.0), false).is_err(), "nothing was decided");
    drop_in.hard_reset_done(&[0.0]).unwrap();
    for (next, given) in [
        (vec![f32::NAN], signal(0.0)),
        (vec![0.0, 0.0], signal(0.0)),
        (vec![0.0], None),
        (vec![0.0], Some(ResetSignal { reward: f32::NAN, in_reset_set: false })),
    ] {
        drop_in.filter(&[0.0], &mut [0.5]).unwrap();
        assert!(drop_in.observe(&next, given, false).is_err());
        assert!(drop_in.needs_hard_reset());
        let mut action = [0.5];
        let refused = drop_in.filter(&[0.0], &mut action).unwrap();
        assert_eq!((refused.abort().unwrap().cause, action), (Cause::AwaitsHardReset, [0.0]));
        drop_in.hard_reset_done(&[0.0]).unwrap();
    }
    // The environment has ended.
    drop_in.filter(&[0.0], &mut [0.5]).unwrap();
    drop_in.observe(&[1.0], signal(1.0), true).unwrap();
    assert!(drop_in.needs_hard_reset() && !drop_in.begin_reset());
    assert!(drop_in.hard_reset_done(&[f32::INFINITY]).is_err() && drop_in.needs_hard_reset());
}

#[test]
fn a_panicked_rule_is_an_error_and_its_reason_stays() {
    let broken = Rule::judging(|_| Err(Error::new(ErrorKind::Panicked, "the rule panicked")));
    let shield = DropIn::builder(spaces(), Box::new(Scripted::acting(|_, _| -1.0))).rule(broken);
    let mut drop_in = shield.build().unwrap();
    let mut action = [0.5];
    let error = drop_in.filter(&[0.0], &mut action).unwrap_err();
    assert!(error.message().contains("cannot decide any more"), "{error}");
    assert_eq!(action, [-1.0]);
    // Whatever comes then, the cause stays.
    assert!(drop_in.observe(&[0.0], signal(0.0), false).is_err() && drop_in.needs_hard_reset());
    let error = drop_in.filter(&[0.0], &mut action).unwrap_err();
    assert!(error.message().contains("the rule panicked"), "{error}");
}

#[test]
fn a_failing_reset_agent_is_counted_and_explained() {
    let failing = Scripted::acting(|_, _| f32::NEG_INFINITY);
    let mut drop_in = builder(failing).build().unwrap();
    let mut cell = 0.0;
    step(&mut drop_in, &mut cell, 0.5);
    assert_eq!(drop_in.reason(), "");
    assert!(drop_in.begin_reset());
    let mut action = [0.5];
    let decision = drop_in.filter(&[cell], &mut action).unwrap();
    assert_eq!((decision.abort().unwrap().cause, action), (Cause::ResetFailed, [0.0]));
    assert_eq!(drop_in.reason(), "no action today");
    assert_eq!(metric(&drop_in, "failed_closed"), 1.0);
}

#[test]
fn a_reason_ends_with_its_action() {
    let mut drop_in = builder(Scripted::acting(|_, _| 0.25)).build().unwrap();
    let mut cell = 0.0;
    step(&mut drop_in, &mut cell, 0.75);
    assert_ne!(drop_in.reason(), "");
    assert_eq!(step(&mut drop_in, &mut cell, 0.75), Decision::Resetting);
    assert_eq!(drop_in.reason(), "");
}

/// What a text is refused for.
fn fault(text: &str) -> String {
    DropInFile::from_text("x.ron", text, &[]).unwrap_err().to_string()
}

#[test]
fn an_unusable_configuration_is_refused_with_its_place() {
    const RULES: &str = "rules: [(plugin: \"r\")]";
    let with = |fields: &str| format!("DropIn(\n reset: (plugin: \"a\"),\n {fields}\n)");
    for (fields, wanted) in [
        ("shield: (rules: [])", "x.ron:3:18: a shield without any rule"),
        (&format!("shield: ({RULES}, on_abort: Truncate)"), "x.ron:3:45: what an agent of yours learns"),
        (&format!("shield: ({RULES}, projection: Best)"), "the values of an agent of yours"),
        (&format!("shield: ({RULES}), episode_length: 0"), "at least one step"),
        (&format!("shield: ({RULES}, attempt_length: Steps(0))"), "an attempt needs at least one step"),
        (
            &format!("shield: ({RULES}), calibration_resets: 3"),
            "x.ron:3:56: there is no reset task that would learn",
        ),
        (&format!("shield: ({RULES}), threads: 0"), "at least one thread"),
        (&format!("shield: ({RULES}), hard_reset_cost: -1.0"), "the cost of a hard reset is -1"),
        ("shield: (), experience: (failure_share: 1.5)", "x.ron:3:42: 1.5 is not a share between 0 and 1"),
        (&format!("shield: ({RULES}), evaluation: None"), "x.ron:3:"),
        (&format!("shield: ({RULES}), pins: {{\"b\": \"{}\"}}", "0".repeat(64)), "no plugin of that id"),
        (
            &format!("shield: ({RULES}), spaces: (observation: Unbounded(0), action: Discrete(2))"),
            "observation space",
        ),
        (
            &format!("shield: ({RULES}), reset_task: (plugin: \"t\", isolate: true)"),
            "only environments and policies",
        ),
    ] {
        let found = fault(&with(fields));
        assert!(found.contains(wanted), "{fields}: {found}");
    }
    let sets = [Override::new("shield.warm_up_steps", "7", "warm_up_steps=7").unwrap()];
    let file = DropInFile::from_text("x.ron", &with(&format!("shield: ({RULES})")), &sets).unwrap();
    assert_eq!(file.config.shield.warm_up_steps, 7);
    let wrong = [Override::new("shield.warm_up_steps", "-7", "warm_up_steps=-7").unwrap()];
    let error = DropInFile::from_text("x.ron", &with(&format!("shield: ({RULES})")), &wrong).unwrap_err();
    assert!(error.to_string().starts_with("warm_up_steps=-7:"), "{error}");
}

#[test]
fn what_keeps_the_shield_from_helping_is_found_once_and_kept() {
    let mut drop_in = builder(Scripted::acting(|_, _| -1.0)).build().unwrap();
    // Hard resets that nobody needed, at starts that the caller knows to be outside.
    for _ in 0..20 {
        drop_in.hard_reset_done_at(&[3.0], Some(false)).unwrap();
        let mut cell = 3.0;
        for _ in 0..100 {
            step(&mut drop_in, &mut cell, 0.0);
        }
    }
    let names = |drop_in: &DropIn| drop_in.findings().map(|finding| finding.name()).collect::<Vec<_>>();
    assert_eq!(names(&drop_in), ["resets-requested", "starts-outside"]);
    let state = drop_in.state().unwrap();
    let mut other = builder(Scripted::acting(|_, _| -1.0)).build().unwrap();
    assert_eq!(names(&other), [""; 0]);
    assert!(other.restore(state).is_ok());
    assert_eq!(names(&other), names(&drop_in));
}

/// Knows as reset what it was shown as a start.
struct Starts(Vec<f32>);

impl Checkpoint for Starts {}

impl ResetTask for Starts {
    fn evaluate(&mut self, _: &[f32], _: &[f32], next: &[f32]) -> shield_api::Result<ResetSignal> {
        Ok(ResetSignal { reward: 0.0, in_reset_set: self.0.contains(&next[0]) })
    }

    fn observe_start(&mut self, observation: &[f32]) -> shield_api::Result<()> {
        self.0.push(observation[0]);
        Ok(())
    }
}

#[test]
fn a_further_start_is_told_to_the_reset_task_alone() {
    let agent = Scripted::acting(|_, _| -1.0);
    let mut drop_in = builder(agent).reset_task(Box::new(Starts(Vec::new()))).build().unwrap();
    drop_in.observe_start(&[1.0]).unwrap();
    assert!(!drop_in.is_placed() && drop_in.observe_start(&[f32::NAN]).is_err());
    drop_in.hard_reset_done(&[0.0]).unwrap();
    drop_in.filter(&[0.0], &mut [0.5]).unwrap();
    drop_in.observe(&[2.0], None, false).unwrap();
    assert!(drop_in.begin_reset());
    drop_in.filter(&[2.0], &mut [0.0]).unwrap();
    drop_in.observe(&[1.0], None, false).unwrap();
    assert_eq!((metric(&drop_in, "reset_successes"), metric(&drop_in, "hard_resets")), (1.0, 0.0));
    let mut without_task = builder(Scripted::acting(|_, _| -1.0)).build().unwrap();
    assert!(without_task.observe_start(&[1.0]).is_ok() && !without_task.is_placed());
}

#[test]
fn entries_into_irreversible_states_are_counted_and_change_nothing() {
    let mut drop_in = builder(Scripted::acting(|_, _| 0.0)).build().unwrap();
    for irreversible in [false, true, true, false, true] {
        drop_in.filter(&[1.0], &mut [0.5]).unwrap();
        drop_in.observe_and_count(&[1.0], signal(1.0), false, irreversible).unwrap();
    }
    assert_eq!((drop_in.counters().irreversible_entries, drop_in.counters().steps), (2, 5));
    assert!(!drop_in.needs_hard_reset() && drop_in.phase() == Phase::Forward);
}
