//! A million steps of a policy that proposes anything, NaN included, under rules that reject or fail at random: through every door for Rust,
//! the environment receives only what the rules allowed at that very state, or what the reset agent does.
#![allow(clippy::unwrap_used, reason = "a test")]

mod common;

use std::{
    collections::HashSet,
    sync::{Arc, Mutex},
};

use common::{EPISODE, Line, PIT, Rule, Scripted, spaces};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use shield_api::{AbortRule, Error, Phase, ResetSignal, RuleVerdict};
use shield_runtime::{
    cycle::HardResetDue,
    decision::Decision,
    drop_in::{DropIn, DropInBuilder},
    shielded::{Shielded, StepEnd},
};

const STEPS: usize = 1_000_000;
/// What the reset agent does; no other action is exactly this one.
const HOME: f32 = -1.0;
const FALLBACK: f32 = -0.25;

/// Step, observation and action, as bits.
type Approved = Arc<Mutex<HashSet<(u64, u32, u32)>>>;

/// Rejects, fails and answers NaN at random, and notes what it allows.
fn moody(approved: Approved, seed: u64) -> Box<dyn AbortRule> {
    let coin = Mutex::new(Pcg64::seed_from_u64(seed));
    Rule::judging(move |context| {
        match coin.lock().unwrap().random_range(0..10) {
            0 => return Err(Error::failed("broken")),
            1 => return Ok(RuleVerdict::from_safe(true, f32::NAN)),
            2 | 3 => return Ok(RuleVerdict::from_safe(false, 0.0)),
            _ => {}
        }
        let key = (context.step, context.observation[0].to_bits(), context.proposed[0].to_bits());
        approved.lock().unwrap().insert(key);
        Ok(RuleVerdict::from_safe(true, 1.0))
    })
}

fn shield(approved: &Approved) -> DropInBuilder {
    DropIn::builder(spaces(), Box::new(Scripted::acting(|_, _| HOME)))
        .rule(moody(approved.clone(), 12))
        .rule(Rule::judging(|context| Ok(RuleVerdict::from_safe(context.proposed[0] < 0.9, 0.0))))
        .attempt_length(EPISODE as u64)
        .fallback_action(vec![FALLBACK])
}

fn anything(rng: &mut Pcg64) -> f32 {
    match rng.random_range(0..20) {
        0 => f32::NAN,
        1 => f32::INFINITY,
        2 => 1.0 + f32::EPSILON,
        3 => f32::NEG_INFINITY,
        _ => rng.random_range(-0.99..=1.0),
    }
}

#[test]
fn a_drop_in_lets_no_unapproved_action_through() {
    let approved = Approved::default();
    let mut shield = shield(&approved).build().unwrap();
    let mut rng = Pcg64::seed_from_u64(11);
    let (mut cell, mut checked, mut made) = (0_i32, 0_u64, 0_u64);
    for _ in 0..STEPS {
        // A caller who forgets, interrupts and errs.
        match rng.random_range(0..100) {
            0 => drop(shield.begin_reset()),
            1 => shield.require_hard_reset(HardResetDue::Lost),
            2 => drop(shield.observe(&[f32::NAN], None, false)),
            3 => drop(shield.filter(&[0.0, 1.0], &mut [0.0])),
            _ => {}
        }
        if shield.needs_hard_reset() && rng.random_bool(0.5) {
            cell = 0;
            shield.hard_reset_done(&[0.0]).unwrap();
        }
        let (is_forward, is_due) = (shield.phase() == Phase::Forward, shield.needs_hard_reset());
        let mut action = [anything(&mut rng)];
        let decision = shield.filter(&[cell as f32], &mut action).unwrap();
        match decision {
            Decision::Allow => {
                let key = (made, (cell as f32).to_bits(), action[0].to_bits());
                assert!(is_forward && !is_due && approved.lock().unwrap().contains(&key) && action[0] < 0.9);
                checked += 1;
            }
            Decision::Abort(_) => assert!(action == [HOME] || action == [FALLBACK], "{action:?}"),
            Decision::Resetting => assert!(!is_forward && action == [HOME]),
            other => panic!("{other:?}"),
        }
        if is_due {
            assert_eq!(action, [FALLBACK], "it moves while a hard reset is due");
        } else if rng.random_range(0..50) > 0 {
            cell = (cell + if action[0] > 0.0 { 1 } else { -1 }).clamp(0, PIT);
            let signal = ResetSignal { reward: 0.0, in_reset_set: cell == 0 };
            shield.observe(&[cell as f32], Some(signal), rng.random_range(0..100) == 0).unwrap();
            made += 1;
        }
    }
    let counters = *shield.counters();
    assert_eq!(counters.steps, made);
    assert!(checked > 100_000, "only {checked} allowed actions were checked");
    assert!(
        counters.failed_closed > 10_000 && counters.hard_resets > 1_000 && counters.reset_episodes > 10_000
    );
}

#[test]
fn a_shielded_environment_receives_no_unapproved_action() {
    let approved = Approved::default();
    let line = Line::new();
    let log = line.log.clone();
    let mut line = Shielded::new(line, None, shield(&approved).build().unwrap()).unwrap();
    let mut rng = Pcg64::seed_from_u64(13);
    let mut observation = [f32::NAN];
    line.reset(0, &mut observation).unwrap();
    let mut checked = 0_u64;
    for seed in 0..STEPS {
        let before = log.lock().unwrap().len();
        let (end, decision) = {
            let step = line.step(&[anything(&mut rng)], &mut observation).unwrap();
            assert_eq!(step.end == StepEnd::Truncated, !step.reason.is_empty());
            (step.end, step.decision)
        };
        let executed: Vec<(i32, f32)> = log.lock().unwrap()[before..].to_vec();
        if decision == Decision::Allow {
            let [(cell, action)] = executed[..] else { panic!("{executed:?} was executed") };
            let key = (before as u64, (cell as f32).to_bits(), action.to_bits());
            assert!(approved.lock().unwrap().contains(&key) && action < 0.9);
            checked += 1;
        } else {
            assert_eq!((executed.len(), end), (0, StepEnd::Truncated), "an aborted action was executed");
        }
        let before = before + executed.len();
        if end != StepEnd::Continues || rng.random_range(0..30) == 0 {
            line.reset(seed as u64, &mut observation).unwrap();
            assert!(log.lock().unwrap()[before..].iter().all(|(_, action)| *action == HOME));
        }
    }
    assert!(checked > 100_000, "only {checked} allowed actions were checked");
}
