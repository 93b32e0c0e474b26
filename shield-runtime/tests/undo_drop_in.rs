//! The drop-in with a success critic, in a caller's loop and around an environment: aborts with nothing to undo, and what is kept.
#![allow(clippy::unwrap_used, reason = "a test")]

mod common;

use std::sync::{Arc, Mutex};

use common::{
    EPISODE, Line, Scripted,
    critic::{ALIKE, Lessons, Odds, Testimony, Witness, memory, told},
    spaces,
};
use shield_api::{Phase, ResetSignal};
use shield_runtime::{
    cycle::HardResetDue,
    decision::{Cause, Decision},
    drop_in::{DropIn, DropInBuilder, Learning},
    drop_in_files,
    experience::{Experience, UndoSettings},
    shielded::{Shielded, StepEnd},
};

/// A shield in a loop in which an action leads by as much; 0 is the reset set. Proposals above a half are rejected.
struct Loop {
    shield: DropIn,
    cell: f32,
    testimony: Arc<Mutex<Testimony>>,
}

/// With a reset agent that goes by `way`.
fn builder(way: f32) -> (DropInBuilder, Arc<Mutex<Testimony>>) {
    let rule = Witness::allowing(|context| context.proposed[0] <= 0.5);
    let testimony = rule.testimony.clone();
    let agent = Scripted::acting(move |_, _| way);
    let builder = DropIn::builder(spaces(), Box::new(agent))
        .success_critic(Box::new(Odds::of(|_, _| 0.75)))
        .rule(Box::new(rule))
        .attempt_length(EPISODE as u64);
    (builder, testimony)
}

fn learning(capacity: usize, settings: UndoSettings) -> Learning {
    Learning::new(memory(capacity, settings), 1, 0)
}

impl Loop {
    fn new((builder, testimony): (DropInBuilder, Arc<Mutex<Testimony>>)) -> Self {
        let mut shield = builder.build().unwrap();
        shield.hard_reset_done(&[0.0]).unwrap();
        Self { shield, cell: 0.0, testimony }
    }

    /// The shield decides, and nothing is executed unless it is allowed.
    fn propose(&mut self, proposed: f32) -> Decision {
        self.shield.filter(&[self.cell], &mut [proposed]).unwrap()
    }

    /// The shield decides, and whatever is in the buffer is executed.
    fn step(&mut self, proposed: f32) -> Decision {
        self.step_into(proposed, false)
    }

    fn step_into(&mut self, proposed: f32, terminated: bool) -> Decision {
        let mut action = [proposed];
        let decision = self.shield.filter(&[self.cell], &mut action).unwrap();
        self.cell = (self.cell + action[0]).max(0.0);
        let signal = ResetSignal { reward: 0.0, in_reset_set: self.cell == 0.0 };
        self.shield.observe(&[self.cell], Some(signal), terminated).unwrap();
        decision
    }

    /// Steps, forward steps, attempts and hard resets.
    fn counts(&self) -> [u64; 4] {
        let counters = self.shield.counters();
        [counters.steps, counters.forward_steps, counters.reset_episodes, counters.hard_resets]
    }
}

fn is_rejected(decision: Decision) -> bool {
    decision.abort().is_some_and(|abort| abort.cause == Cause::Rejected)
}

#[test]
fn an_abort_with_nothing_to_undo_leaves_the_caller_in_charge() {
    let mut shield = Loop::new(builder(-1.0));
    for _ in 0..3 {
        assert!(is_rejected(shield.propose(1.0)));
        assert_eq!((shield.shield.phase(), shield.shield.begin_reset()), (Phase::Forward, false));
    }
    assert_eq!((told(&shield.testimony), shield.counts()), (vec![(0, true); 3], [0, 0, 0, 0]));
    assert_eq!(shield.step(0.5), Decision::Allow);
    // Now there is something to undo.
    assert!(is_rejected(shield.propose(1.0)));
    assert_eq!(shield.shield.phase(), Phase::Reset);
    assert_eq!(shield.step(1.0), Decision::Resetting);
    assert_eq!((shield.shield.phase(), shield.counts()), (Phase::Forward, [2, 1, 1, 0]));
    assert_eq!(told(&shield.testimony)[3..], [(2, true)]);
    // The attempt has succeeded: nothing is to be undone again.
    assert!(is_rejected(shield.propose(1.0)));
    assert_eq!((shield.shield.phase(), shield.counts()), (Phase::Forward, [2, 1, 1, 0]));
}

#[test]
fn a_caller_may_execute_what_stands_in_for_the_rejected_action() {
    for (way, learns) in [(-1.0, false), (-1.0, true), (0.25, false), (0.25, true)] {
        let (made, testimony) = builder(way);
        let made = if learns { made.learning(learning(100, ALIKE)) } else { made };
        let mut shield = Loop::new((made, testimony));
        let leaves = way > 0.0;
        // It is a step, but not one of the caller's.
        assert!(is_rejected(shield.step(1.0)));
        assert_eq!((shield.counts(), shield.shield.phase()), ([1, 0, 0, 0], Phase::Forward));
        assert_eq!(told(&shield.testimony), [(0, true)]);
        // In the reset set there is nothing to undo still; outside of it there is.
        assert!(is_rejected(shield.propose(1.0)));
        let phase = if leaves { Phase::Reset } else { Phase::Forward };
        assert_eq!(shield.shield.phase(), phase, "{way}");
        assert_eq!(shield.shield.counters().reset_episodes, u64::from(leaves));
        assert_eq!(shield.shield.begin_reset(), leaves);
        if leaves {
            // It goes the wrong way: the attempt fails, and the step before it is one that could not be undone.
            (0..EPISODE).for_each(|_| assert_eq!(shield.step(1.0), Decision::Resetting));
            assert_eq!(told(&shield.testimony), [(0, true), (1 + EPISODE as u64, false)]);
            assert_eq!(shield.shield.hard_reset_due(), Some(HardResetDue::CycleOver));
        } else {
            assert_eq!(told(&shield.testimony), [(0, true), (1, true)]);
        }
    }
}

#[test]
fn a_step_in_place_of_a_rejected_action_may_end_the_environment() {
    let mut shield = Loop::new(builder(-1.0));
    assert!(is_rejected(shield.step_into(1.0, true)));
    assert_eq!(shield.shield.hard_reset_due(), Some(HardResetDue::Terminated));
    assert_eq!((told(&shield.testimony), shield.counts()), (vec![(0, true), (1, false)], [1, 0, 0, 0]));
}

#[test]
fn only_ten_aborts_in_a_row_hand_over() {
    for learns in [false, true] {
        let (made, testimony) = builder(-1.0);
        let made = if learns { made.learning(learning(100, ALIKE)) } else { made };
        let mut shield = Loop::new((made, testimony));
        for round in 0..4 {
            (0..6).for_each(|_| assert!(is_rejected(shield.propose(1.0))));
            assert_eq!(shield.shield.phase(), Phase::Forward, "round {round}");
            assert_eq!(shield.step(0.5), Decision::Allow);
            assert!(shield.shield.begin_reset());
            assert_eq!(shield.step(0.5), Decision::Resetting);
        }
        assert_eq!(shield.shield.counters().reset_episodes, 4);
        (0..10).for_each(|_| assert!(is_rejected(shield.propose(1.0))));
        assert_eq!(shield.shield.phase(), Phase::Forward);
        assert!(is_rejected(shield.propose(1.0)));
        assert_eq!(shield.shield.phase(), Phase::Reset);
        assert_eq!(shield.step(1.0), Decision::Resetting);
        assert_eq!((shield.shield.phase(), shield.shield.counters().hard_resets), (Phase::Forward, 0));
    }
}

#[test]
fn what_is_executed_while_a_hard_reset_is_awaited_belongs_to_no_attempt() {
    let (made, testimony) = builder(-1.0);
    let mut shield = Loop::new((made.learning(learning(100, ALIKE)), testimony));
    shield.step(0.5);
    shield.step_into(0.5, true);
    assert_eq!(told(&shield.testimony), [(2, false)]);
    for _ in 0..3 {
        let decision = shield.step_into(0.5, true);
        assert_eq!(decision.abort().unwrap().cause, Cause::AwaitsHardReset);
        assert!(shield.shield.needs_hard_reset());
    }
    assert_eq!(told(&shield.testimony), [(2, false)]);
}

#[test]
fn a_caller_who_resets_in_the_middle_cuts_the_attempt_short() {
    let mut shield = Loop::new(builder(-0.25));
    for cut in [
        |shield: &mut DropIn| shield.hard_reset_done(&[0.0]).unwrap(),
        |shield: &mut DropIn| {
            shield.require_hard_reset(HardResetDue::Lost);
            shield.hard_reset_done(&[0.0]).unwrap();
        },
    ] {
        (0..2).for_each(|_| assert_eq!(shield.step(0.5), Decision::Allow));
        assert!(shield.shield.begin_reset());
        assert_eq!(shield.step(0.5), Decision::Resetting);
        cut(&mut shield.shield);
        shield.cell = 0.0;
        assert_eq!((told(&shield.testimony), shield.shield.phase()), (vec![], Phase::Forward));
        // There is nothing to undo again.
        assert!(is_rejected(shield.propose(1.0)));
        assert_eq!(shield.shield.phase(), Phase::Forward);
        shield.testimony.lock().unwrap().attempts.clear();
    }
}

#[test]
fn around_an_environment_an_abort_with_nothing_to_undo_resets_nothing() {
    let line = Line::new();
    let (log, resets) = (line.log.clone(), line.resets.clone());
    let (made, testimony) = builder(-1.0);
    let mut line = Shielded::new(line, None, made.build().unwrap()).unwrap();
    let mut observation = [f32::NAN];
    line.reset(0, &mut observation).unwrap();
    for seed in 1..=10 {
        let step = line.step(&[1.0], &mut observation).unwrap();
        assert!(step.end == StepEnd::Truncated && is_rejected(step.decision));
        line.reset(seed, &mut observation).unwrap();
        assert_eq!(observation, [0.0]);
    }
    assert_eq!((log.lock().unwrap().len(), line.shield().counters().reset_episodes), (0, 0));
    assert_eq!(told(&testimony), [(0, true); 10]);
    // After ten in a row the reset agent takes over.
    assert_eq!(line.step(&[1.0], &mut observation).unwrap().end, StepEnd::Truncated);
    line.reset(11, &mut observation).unwrap();
    assert_eq!(*log.lock().unwrap(), [(0, -1.0)]);
    // Then it begins anew, and an allowed action has something to undo.
    assert_eq!(line.step(&[1.0], &mut observation).unwrap().end, StepEnd::Truncated);
    line.reset(12, &mut observation).unwrap();
    assert_eq!(line.step(&[0.5], &mut observation).unwrap().end, StepEnd::Continues);
    assert_eq!(line.step(&[1.0], &mut observation).unwrap().end, StepEnd::Truncated);
    line.reset(13, &mut observation).unwrap();
    assert_eq!(*log.lock().unwrap(), [(0, -1.0), (0, 0.5), (1, -1.0)]);
    assert_eq!((line.hard_resets(), resets.lock().unwrap().len(), observation), (0, 1, [0.0]));
}

#[test]
fn an_unusable_success_critic_is_refused() {
    let (made, _) = builder(-1.0);
    let forgets = Experience::new(10, &spaces(), [0, 1], 1.0).unwrap();
    let error = made.learning(Learning::new(forgets, 1, 0)).build().err().unwrap().to_string();
    assert!(error.contains("`with_undo`"), "{error}");
    let rule = Witness::allowing(|_| true);
    let made = DropIn::builder(spaces(), Box::new(Scripted::acting(|_, _| -1.0))).rule(Box::new(rule));
    let error = made.build().err().unwrap().to_string();
    assert!(error.contains("name a success critic"), "{error}");
}

/// A shield that has made attempts, with its critic's lessons and updates.
struct Kept {
    inside: Loop,
    lessons: Lessons,
    updates: Arc<Mutex<u64>>,
}

const SHARES: UndoSettings = UndoSettings {
    bootstrap_probability: 0.5,
    failure_share: 0.5,
    success_share: 0.25,
    outcome_half_life: 5.0,
};

/// The reset agent goes back from below 1.25, and further away from there.
fn kept(capacity: usize) -> Kept {
    let rule = Witness::allowing(|context| context.proposed[0] <= 0.5);
    let odds = Odds::of(|_, _| 0.75);
    let (testimony, lessons, updates) = (rule.testimony.clone(), odds.lessons.clone(), odds.updates.clone());
    let agent = Scripted::acting(|cell, _| if cell < 1.25 { -0.5 } else { 0.5 });
    let learning = Learning { updates_per_step: 20, ..learning(capacity, SHARES) };
    let shield = DropIn::builder(spaces(), Box::new(agent))
        .success_critic(Box::new(odds))
        .rule(Box::new(rule))
        .attempt_length(EPISODE as u64)
        .learning(learning);
    Kept { inside: Loop::new((shield, testimony)), lessons, updates }
}

impl Kept {
    /// Cycles that end with a success where they make one or two steps forward, else with a failure.
    fn cycles(&mut self, numbers: std::ops::Range<usize>) {
        for number in numbers {
            (0..1 + number % 4).for_each(|_| assert_eq!(self.inside.step(0.5), Decision::Allow));
            assert!(self.inside.shield.begin_reset());
            while self.inside.shield.phase() == Phase::Reset {
                self.inside.step(0.5);
            }
            if self.inside.shield.needs_hard_reset() {
                self.inside.cell = 0.0;
                self.inside.shield.hard_reset_done(&[0.0]).unwrap();
            }
        }
    }
}

#[test]
fn a_shield_that_is_loaded_goes_on_with_critic_attempts_and_rules() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("state");
    // The memory is not full, and has forgotten most.
    for capacity in [1_000, 60] {
        let mut saved = kept(capacity);
        saved.cycles(0..10);
        drop_in_files::save(&mut saved.inside.shield, &file).unwrap();
        let mut loaded = kept(capacity);
        drop_in_files::load(&mut loaded.inside.shield, &file).unwrap();
        assert!(loaded.inside.shield.needs_hard_reset());
        assert_eq!(*loaded.updates.lock().unwrap(), *saved.updates.lock().unwrap());
        let attempts = |kept: &Kept| kept.inside.testimony.lock().unwrap().attempts.len();
        assert_eq!((attempts(&saved), attempts(&loaded)), (10, 10));
        // From a hard reset on, both are taught the same.
        for kept in [&mut saved, &mut loaded] {
            kept.lessons.lock().unwrap().clear();
            kept.inside.shield.require_hard_reset(HardResetDue::Lost);
            kept.inside.shield.hard_reset_done(&[0.0]).unwrap();
            kept.inside.cell = 0.0;
            kept.cycles(10..20);
        }
        let (lessons, expected) = (loaded.lessons.lock().unwrap(), saved.lessons.lock().unwrap());
        assert!(expected.iter().any(|lesson| lesson.outcome == 1.0));
        assert!(expected.iter().any(|lesson| lesson.outcome == 0.0 && lesson.weight > 0.0));
        assert!(expected.len() > 1_000 && *lessons == *expected, "room for {capacity}");
    }
}

#[test]
fn attempts_are_loaded_into_more_and_into_less_room() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("state");
    for cycles in [3, 10, 40] {
        let mut saved = kept(60);
        saved.cycles(0..cycles);
        drop_in_files::save(&mut saved.inside.shield, &file).unwrap();
        for capacity in [1_000, 61, 59, 30, 5] {
            let mut loaded = kept(capacity);
            drop_in_files::load(&mut loaded.inside.shield, &file).unwrap();
            loaded.inside.shield.hard_reset_done(&[0.0]).unwrap();
            loaded.cycles(cycles..cycles + 8);
            for lesson in loaded.lessons.lock().unwrap().iter() {
                let is_home = lesson.next_observation == 0.0;
                assert_eq!(lesson.success, f32::from(u8::from(is_home)), "{lesson:?}");
                // Whatever was executed far out was not undone; what lies near has no failure.
                let outcome = if lesson.observation >= 1.25 { 0.0 } else { lesson.outcome };
                assert!(lesson.weight == 0.0 || lesson.outcome == outcome, "{lesson:?}");
                assert!(!is_home || lesson.weight == 0.0 || lesson.outcome == 1.0, "{lesson:?}");
            }
        }
    }
}

#[test]
fn a_state_without_the_critic_of_the_shield_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("state");
    let without = || {
        let rule = common::Rule::below(0.5);
        DropIn::builder(spaces(), Box::new(Scripted::acting(|_, _| -1.0))).rule(rule).build().unwrap()
    };
    let with = || builder(-1.0).0.build().unwrap();
    drop_in_files::save(&mut without(), &file).unwrap();
    let error = drop_in_files::load(&mut with(), &file).unwrap_err().to_string();
    assert!(error.contains("this shield has a success critic, and it has none"), "{error}");
    drop_in_files::save(&mut with(), &file).unwrap();
    let error = drop_in_files::load(&mut without(), &file).unwrap_err().to_string();
    assert!(error.contains("it has a success critic, and this shield has none"), "{error}");
    assert!(drop_in_files::load(&mut with(), &file).is_ok());
}
