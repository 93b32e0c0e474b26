//! Which outcomes attempts have, and which steps they label.

use super::*;

#[test]
fn an_attempt_that_succeeds_labels_its_steps_and_the_one_before() {
    let mut walk = walk(short());
    assert!(walk.step(1.0).is_none() && walk.step(0.25).is_none());
    let abort = walk.step(2.0).unwrap();
    assert_eq!((abort.end, abort.length, abort.hard_reset), (EpisodeEnd::Abort, 2, None));
    let attempt = walk.finish();
    assert_eq!((attempt.end, attempt.length, attempt.has_reset), (EpisodeEnd::ResetSet, 3, true));
    assert_eq!(told(&walk.testimony), [(5, true)]);
    let undone = |cell: f32| (cell, [0.0, 1.0, 1.0, 1.0]);
    assert_eq!(
        walk.labels(),
        [
            // Of the forward steps, only the last one's attempt was seen.
            (0.0, [0.0, 1.0, 0.0, 0.0]),
            undone(1.0),
            undone(1.25),
            undone(0.75),
            (0.25, [1.0, 0.0, 1.0, 1.0]),
        ]
    );
    // The reset agent's greedy action, where the next state counts.
    let next_actions: Vec<f32> = walk.lessons().iter().map(|lesson| lesson.next_action).collect();
    assert_eq!(next_actions, [-1.0, -1.0, -1.0, -1.0, 0.0]);
}

#[test]
fn an_attempt_that_fails_for_lack_of_time_counts_less_and_less() {
    let mut walk = walk(short());
    walk.steps(3, 1.0);
    assert_eq!(walk.step(1.0).unwrap().end, EpisodeEnd::Abort);
    let attempt = walk.finish();
    assert_eq!((attempt.end, attempt.length, attempt.has_reset), (EpisodeEnd::TimeLimit, 4, false));
    assert_eq!(walk.cycle.hard_reset_due(), Some(HardResetDue::CycleOver));
    assert_eq!(told(&walk.testimony), [(7, false)]);
    let lost = |cell: f32, weight: f32| (cell, [0.0, 1.0, 0.0, weight]);
    let forward = [lost(0.0, 0.0), lost(1.0, 0.0), lost(2.0, 1.0)];
    let own = [lost(3.0, 1.0), lost(2.5, 0.75), lost(2.0, 0.5), lost(1.5, 0.25)];
    assert_eq!(walk.labels(), [&forward[..], &own].concat());
}

#[test]
fn what_follows_the_first_entry_into_the_reset_set_is_taught_no_outcome() {
    let goes_on = CycleSettings { stop_on_reset: false, ..short() };
    let mut walk = walk(goes_on);
    assert!(walk.step(1.0).is_none());
    assert!(walk.cycle.begin_reset().is_some());
    let attempt = walk.finish();
    assert_eq!((attempt.end, attempt.length, attempt.has_reset), (EpisodeEnd::TimeLimit, 4, true));
    let labels = walk.labels();
    // 0 → 1 forward, 1 → 0.5 → 0, and 0 → 0 twice.
    assert_eq!(labels.iter().filter(|(cell, _)| *cell == 0.0).count(), 2, "{labels:?}");
    for (label, is_known) in [
        ((0.0, [0.0, 1.0, 1.0, 1.0]), true),
        ((1.0, [0.0, 1.0, 1.0, 1.0]), true),
        ((0.5, [1.0, 0.0, 1.0, 1.0]), true),
        ((0.0, [1.0, 0.0, 0.0, 0.0]), true),
        ((0.0, [1.0, 0.0, 1.0, 1.0]), false),
    ] {
        assert_eq!(labels.contains(&label), is_known, "{label:?} in {labels:?}");
    }
}

#[test]
fn a_second_attempt_has_an_outcome_of_its_own_and_no_step_before_it() {
    let patient =
        CycleSettings { reset_attempts: Some(2), between_attempts: BetweenAttempts::Reset, ..short() };
    let mut walk = walk(patient);
    walk.steps(3, 1.0);
    walk.step(1.0);
    assert!(!walk.finish().has_reset && walk.cycle.hard_reset_due().is_none());
    let second = walk.finish();
    assert_eq!((second.end, second.length), (EpisodeEnd::ResetSet, 2));
    assert_eq!(told(&walk.testimony), [(7, false), (9, true)]);
    let labels = walk.labels();
    for label in [
        (2.0, [0.0, 1.0, 0.0, 1.0]),
        (1.5, [0.0, 1.0, 0.0, 0.25]),
        (1.0, [0.0, 1.0, 1.0, 1.0]),
        (0.5, [1.0, 0.0, 1.0, 1.0]),
    ] {
        assert!(labels.contains(&label), "{label:?} is not in {labels:?}");
    }
}

#[test]
fn a_terminated_step_is_no_success_even_at_the_start() {
    for reset_test in [ResetTest::AnyVisited, ResetTest::FinalState] {
        let mut walk = walk(CycleSettings { reset_test, ..short() });
        assert!(walk.step(0.5).is_none());
        assert!(walk.cycle.begin_reset().is_some());
        // The environment has ended, and shows its start.
        let attempt = walk.step_into(0.0, true).unwrap();
        assert_eq!(walk.cell, 0.0);
        assert_eq!((attempt.end, attempt.has_reset), (EpisodeEnd::Terminated, false));
        assert_eq!(walk.cycle.hard_reset_due(), Some(HardResetDue::Terminated));
        assert_eq!(told(&walk.testimony), [(2, false)]);
        assert_eq!(walk.labels(), [(0.0, [0.0, 1.0, 0.0, 1.0]), (0.5, [0.0, 0.0, 0.0, 1.0])]);
        assert_eq!(walk.cycle.reset_successes(), 0);
    }
}

#[test]
fn a_forward_episode_that_terminates_is_an_attempt_that_failed() {
    let mut walk = walk(short());
    assert!(walk.step(1.0).is_none());
    let episode = walk.step_into(1.0, true).unwrap();
    assert_eq!(
        (episode.role, episode.end, episode.has_reset),
        (AgentRole::Forward, EpisodeEnd::Terminated, false)
    );
    assert_eq!(told(&walk.testimony), [(2, false)]);
    assert_eq!(walk.labels(), [(0.0, [0.0, 1.0, 0.0, 0.0]), (1.0, [0.0, 0.0, 0.0, 1.0])]);
    // The next cycle begins anew: its attempt is not mixed up with this one.
    walk.place();
    assert!(walk.step(0.75).is_none());
    walk.cycle.begin_reset();
    assert!(walk.finish().has_reset);
    assert_eq!(told(&walk.testimony), [(2, false), (5, true)]);
    assert!(walk.labels().contains(&(1.0, [0.0, 0.0, 0.0, 1.0])));
}

#[test]
fn an_attempt_that_is_cut_short_has_no_outcome() {
    for end in [EpisodeEnd::Budget, EpisodeEnd::Interrupted, EpisodeEnd::WorkerLost] {
        let mut walk = walk(short());
        walk.steps(2, 1.0);
        assert!(walk.cycle.begin_reset().is_some());
        assert!(walk.step(0.0).is_none());
        let attempt = walk.cycle.finish(end);
        assert!(!attempt.has_reset);
        assert_eq!(told(&walk.testimony), [], "{end:?}");
        assert!(walk.labels().iter().all(|(_, label)| label[3] == 0.0), "{end:?}: {:?}", walk.labels());
        // Nor has what comes after the hard reset anything to do with it.
        if end == EpisodeEnd::WorkerLost {
            assert_eq!(walk.cycle.hard_reset_due(), Some(HardResetDue::Lost));
            walk.place();
            assert!(walk.step(0.5).is_none());
            walk.cycle.begin_reset();
            assert!(walk.finish().has_reset);
            let known = walk.labels().iter().filter(|(_, label)| label[3] > 0.0).count();
            assert_eq!(known, 2, "{:?}", walk.labels());
        }
    }
}

#[test]
fn an_attempt_after_a_hard_reset_says_nothing_of_the_steps_before() {
    let mut walk = walk(short());
    walk.steps(2, 1.0);
    walk.cycle.require_hard_reset(HardResetDue::Lost);
    walk.place();
    // Nothing is executed until the reset agent takes over.
    walk.cell = 0.5;
    while walk.cycle.turn() == AgentRole::Forward {
        assert_eq!(walk.step(3.0).unwrap().end, EpisodeEnd::Abort);
    }
    assert!(walk.finish().has_reset);
    let nothing = [0.0, 1.0, 0.0, 0.0];
    assert_eq!(walk.labels(), [(0.0, nothing), (1.0, nothing), (0.5, [1.0, 0.0, 1.0, 1.0])]);
}

#[test]
fn an_attempt_that_goes_on_after_an_interruption_has_one_outcome_for_all_its_steps() {
    let mut before = walk(short());
    before.steps(2, 1.0);
    assert!(before.cycle.begin_reset().is_some());
    before.steps(2, 0.0);
    let (place, undo) = (before.cycle.save(), before.cycle.save_undo().unwrap());
    before.cycle.finish(EpisodeEnd::Interrupted);
    let mut after = walk(short());
    // The experience is kept apart.
    std::mem::swap(&mut after.cycle.parts_mut().memory, &mut before.cycle.parts_mut().memory);
    after.cycle.parts_mut().restore_undo(&undo).unwrap();
    after.cycle.restore_counts(*before.cycle.counters(), 0);
    after.cycle.go_on(&place);
    after.cycle.go_on_undoing(&undo);
    after.cell = before.cell;
    let attempt = after.finish();
    assert_eq!(
        (attempt.end, attempt.length, attempt.undo_probability),
        (EpisodeEnd::ResetSet, 4, Some(0.75))
    );
    assert_eq!(told(&after.testimony), [(6, true)]);
    let known: Vec<f32> =
        after.labels().iter().filter(|(_, label)| label[2] == 1.0).map(|(cell, _)| *cell).collect();
    // The forward step before it, and its own.
    assert_eq!(known, [1.0, 2.0, 1.5, 1.0, 0.5]);
}

#[test]
fn an_adaptive_attempt_gives_up_where_others_came_back_sooner() {
    let adaptive = CycleSettings {
        attempt_length: AttemptLength::Adaptive,
        episode_length: 90,
        ..CycleSettings::default()
    };
    let anywhere = || Walk::with(adaptive.clone(), |_| true, Odds::of(|_, _| 0.75));
    let mut walk = anywhere();
    assert_eq!(walk.cycle.attempt_length(), 90, "no more than an episode has");
    walk.steps(2, 1.0);
    walk.cycle.begin_reset();
    assert_eq!((walk.finish().length, walk.cycle.attempt_length()), (4, 50));
    // From here it would take 120 steps.
    walk.cell = 60.0;
    walk.steps(1, -0.5);
    walk.cycle.begin_reset();
    let failed = walk.finish();
    assert_eq!((failed.end, failed.length), (EpisodeEnd::TimeLimit, 50));
    assert_eq!(walk.cycle.attempt_length(), 75, "the next one has more");
    let undo = walk.cycle.save_undo().unwrap();
    let mut after = anywhere();
    after.cycle.go_on_undoing(&undo);
    assert_eq!(after.cycle.attempt_length(), 75);
}
