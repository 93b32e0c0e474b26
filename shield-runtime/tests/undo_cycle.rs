//! The reset cycle with a success critic: what an abort with nothing to undo costs, which outcomes attempts have, and what is taught of them.
#![allow(clippy::unwrap_used, reason = "a test")]

mod common;

use std::sync::{Arc, Mutex};

use common::{
    Line, Notebook, Scene, Scripted, agent,
    critic::{ALIKE, Lesson, Lessons, Odds, Testimony, Witness, memory, told},
    forward_learner, spaces,
};
use rand::SeedableRng;
use rand_pcg::Pcg64;
use shield_api::{ActMode, RuleContext, StepOutcome};
use shield_runtime::{
    cycle::{CycleParts, CycleSettings, HardResetDue, Memory, ResetCycle},
    events::{EpisodeEnd, EpisodeEvent},
    experience::{AgentRole, AttemptBuffers},
    settings::{AttemptLength, BetweenAttempts, OnAbort, ResetTest},
    shield::{Ladder, LadderSettings},
};

/// A cycle around a line of cells on which an action leads by as much; 0 is the reset set.
struct Walk {
    cycle: ResetCycle,
    cell: f32,
    testimony: Arc<Mutex<Testimony>>,
    lessons: Lessons,
}

/// The reset agent goes left by 0.5, and by 1 greedily. Nothing beyond 3 is allowed.
fn walk(settings: CycleSettings) -> Walk {
    Walk::with(settings, |context| context.observation[0] + context.proposed[0] <= 3.0, Odds::of(|_, _| 0.75))
}

fn short() -> CycleSettings {
    CycleSettings { attempt_length: AttemptLength::Steps(4), ..CycleSettings::default() }
}

impl Walk {
    fn with(
        settings: CycleSettings,
        allows: impl Fn(&RuleContext<'_>) -> bool + Send + 'static,
        odds: Odds,
    ) -> Self {
        let reset = Scripted::acting(|_, mode| if mode == ActMode::Greedy { -1.0 } else { -0.5 });
        let rule = Witness::allowing(allows);
        let (testimony, lessons, critic) = (rule.testimony.clone(), odds.lessons.clone(), odds.taught());
        let ladder_settings =
            LadderSettings { spaces: spaces(), warm_up_steps: 0, fallback_action: vec![-0.25] };
        let ladder = Ladder::new(vec![Box::new(rule) as _], &reset, ladder_settings)
            .unwrap()
            .with_success_critic(critic.info());
        let parts = CycleParts {
            forward: None,
            reset: Some(agent(AgentRole::Reset, reset)),
            success: Some(critic),
            ladder: Some(ladder),
            memory: Some(Memory { experience: memory(1_000, ALIKE), masks: Pcg64::seed_from_u64(1) }),
        };
        let mut cycle = ResetCycle::new(settings, parts, [1, 1]);
        cycle.placed();
        Self { cycle, cell: 0.0, testimony, lessons }
    }

    /// One step of the agent whose turn it is. Returns the episode that ends with it.
    fn step(&mut self, proposed: f32) -> Option<EpisodeEvent> {
        self.step_into(proposed, false)
    }

    fn step_into(&mut self, proposed: f32, terminated: bool) -> Option<EpisodeEvent> {
        self.cycle.begin_episode();
        match self.cycle.turn() {
            AgentRole::Forward => {
                self.cycle.take_proposal(&[proposed]);
                if let Some(abort) = self.cycle.decide(&[self.cell]).abort() {
                    return Some(self.cycle.finish_aborted(abort.cause));
                }
            }
            AgentRole::Reset => drop(self.cycle.act_to_reset(&[self.cell]).unwrap()),
        }
        self.cell = (self.cell + self.cycle.action()[0]).max(0.0);
        let in_reset_set = self.cell == 0.0;
        let outcome = StepOutcome { in_reset_set, terminated, ..StepOutcome::default() };
        let end = self.cycle.observe(&[self.cell], &outcome).unwrap();
        end.map(|end| self.cycle.finish(end))
    }

    /// Forward steps that are allowed.
    fn steps(&mut self, count: usize, proposed: f32) {
        for _ in 0..count {
            assert!(self.step(proposed).is_none());
        }
    }

    /// Steps until an episode ends.
    fn finish(&mut self) -> EpisodeEvent {
        (0..100).find_map(|_| self.step(0.5)).unwrap()
    }

    fn place(&mut self) {
        self.cycle.placed();
        self.cell = 0.0;
    }

    /// What a success critic would be taught of each step: first those that lead right, from left to right, then the others, from right to left.
    fn lessons(&mut self) -> Vec<Lesson> {
        let CycleParts { reset, memory, .. } = self.cycle.parts_mut();
        let (reset, experience) = (reset.as_mut().unwrap(), &memory.as_ref().unwrap().experience);
        let mut buffers = AttemptBuffers::new(2_000, &spaces(), 2);
        experience.sample_undo(&mut buffers, &mut Pcg64::seed_from_u64(2));
        let act = |observation: &[f32], action: &mut [f32]| {
            reset.learner().act(observation, ActMode::Greedy, action)
        };
        let mut lessons = Vec::new();
        for lesson in Lesson::all(&buffers.complete(act).unwrap()) {
            if !lessons.contains(&lesson) {
                lessons.push(lesson);
            }
        }
        let key = |lesson: &Lesson| (lesson.action < 0.0, lesson.observation * lesson.action.signum());
        lessons.sort_by(|one, other| key(one).partial_cmp(&key(other)).unwrap());
        lessons
    }

    /// Of each of them: the cell, and success, continuation, outcome and its weight.
    fn labels(&mut self) -> Vec<(f32, [f32; 4])> {
        let label = |lesson: &Lesson| {
            let Lesson { success, continuation, outcome, weight, .. } = *lesson;
            (lesson.observation, [success, continuation, outcome, weight])
        };
        self.lessons().iter().map(label).collect()
    }
}

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
    assert!(walk.cycle.begin_reset());
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
        assert!(walk.cycle.begin_reset());
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
        assert!(walk.cycle.begin_reset());
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
    assert!(before.cycle.begin_reset());
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

/// Rejects the first so many proposals.
fn stubborn(rejections: u32) -> Witness {
    let left = Mutex::new(rejections);
    Witness::allowing(move |_| {
        let mut left = left.lock().unwrap();
        let is_over = *left == 0;
        *left = left.saturating_sub(1);
        is_over
    })
}

fn scene(steps: u64, rule: Witness) -> Scene {
    let success = Some(Odds::of(|_, _| 0.75).taught());
    Scene { rules: vec![Box::new(rule)], success, capacity: 1_000, ..Scene::new(steps) }
}

#[test]
fn an_abort_with_nothing_to_undo_costs_neither_an_attempt_nor_a_hard_reset() {
    let rule = stubborn(3);
    let testimony = rule.testimony.clone();
    let line = Line::new();
    let (log, resets) = (line.log.clone(), line.resets.clone());
    let (counters, Notebook { episodes, interventions, .. }) = Scene { line, ..scene(2, rule) }.run();
    // Three times the forward agent proposes again, the fourth proposal is executed.
    let ends: Vec<_> = episodes.iter().map(|episode| (episode.role, episode.end, episode.length)).collect();
    let abort = (AgentRole::Forward, EpisodeEnd::Abort, 0);
    assert_eq!(ends, [abort, abort, abort, (AgentRole::Forward, EpisodeEnd::Budget, 2)]);
    assert!(episodes.iter().all(|episode| episode.hard_reset.is_none()));
    assert_eq!((counters.early_aborts, counters.reset_episodes, counters.hard_resets), (3, 0, 0));
    assert_eq!((counters.steps, counters.forward_steps), (2, 2));
    assert_eq!(*log.lock().unwrap(), [(0, 1.0), (1, 1.0)]);
    assert_eq!((resets.lock().unwrap().len(), interventions.len()), (1, 3));
    assert_eq!(told(&testimony), [(0, true); 3]);
}

#[test]
fn after_ten_such_aborts_in_a_row_the_reset_agent_takes_over() {
    let rule = Witness::allowing(|_| false);
    let testimony = rule.testimony.clone();
    let (counters, Notebook { episodes, .. }) = scene(3, rule).run();
    // Each time ten aborts, one more, and an attempt of one step, which stays in the reset set.
    let attempts: Vec<usize> =
        (0..episodes.len()).filter(|index| episodes[*index].role == AgentRole::Reset).collect();
    assert_eq!(attempts, [11, 23, 35]);
    assert!(attempts.iter().all(|index| episodes[*index].end == EpisodeEnd::ResetSet));
    assert_eq!((counters.steps, counters.forward_steps, counters.hard_resets), (3, 0, 0));
    let expected =
        [[(0, true); 10].to_vec(), [(1, true); 11].to_vec(), [(2, true); 11].to_vec(), vec![(3, true)]];
    assert_eq!(told(&testimony), expected.concat());
}

#[test]
fn after_something_was_executed_an_abort_is_undone() {
    // One step is allowed, the next is not.
    let rule = Witness::allowing(|context| context.observation[0] == 0.0);
    let testimony = rule.testimony.clone();
    let (counters, Notebook { episodes, .. }) = scene(4, rule).run();
    assert_eq!((counters.early_aborts, counters.reset_episodes, counters.forward_steps), (2, 2, 2));
    assert!(episodes.iter().all(|episode| episode.length == 1));
    assert_eq!(told(&testimony), [(2, true), (4, true)]);
}

#[test]
fn a_rule_that_measures_no_undo_probability_hands_over_at_once() {
    let never = common::Rule::below(2.0);
    let (counters, _) = Scene { rules: vec![never], ..Scene::new(3) }.run();
    assert_eq!((counters.early_aborts, counters.reset_episodes), (3, 3));
}

#[test]
fn a_shield_that_fails_is_not_told_of_as_a_success() {
    let rule = Witness::allowing(|_| true);
    let testimony = rule.testimony.clone();
    let forward = forward_learner(Scripted::acting(|_, _| f32::NEG_INFINITY));
    let (counters, Notebook { episodes, .. }) = Scene { forward, ..scene(2, rule) }.run();
    assert_eq!((counters.failed_closed, counters.reset_episodes, counters.hard_resets), (22, 2, 0));
    assert!(episodes[..10].iter().all(|episode| episode.role == AgentRole::Forward));
    assert_eq!(told(&testimony), [(1, true), (2, true)], "only the attempts");
}

#[test]
fn a_run_that_ends_within_an_attempt_tells_no_outcome_of_it() {
    let rule = Witness::allowing(|context| context.observation[0] < 3.0);
    let testimony = rule.testimony.clone();
    let (_, Notebook { episodes, .. }) = scene(5, rule).run();
    assert_eq!(episodes.last().unwrap().end, EpisodeEnd::Budget);
    assert_eq!(told(&testimony), []);
}

#[test]
fn aborts_that_the_forward_agent_learns_from_are_not_taught_to_the_critic() {
    let mut walk = walk(CycleSettings { on_abort: OnAbort::Penalise(1.0), ..short() });
    for _ in 0..20 {
        walk.steps(3, 1.0);
        assert_eq!(walk.step(0.75).unwrap().end, EpisodeEnd::Abort);
        walk.finish();
        walk.place();
    }
    let stored = walk.cycle.parts().memory.as_ref().unwrap().experience.len();
    let executed = walk.cycle.parts().memory.as_ref().unwrap().experience.len_for_undo();
    assert_eq!((stored, executed), (160, 140));
    assert!(walk.lessons().iter().all(|lesson| lesson.action != 0.75));
    assert!(walk.lessons.lock().unwrap().iter().all(|lesson| lesson.action != 0.75));
    // The step before the abort is the one before the attempt.
    assert!(walk.labels().contains(&(2.0, [0.0, 1.0, 0.0, 1.0])));
}

#[test]
fn the_critic_is_taught_after_each_step_what_was_drawn() {
    let mut walk = walk(CycleSettings { updates_per_step: 50, ..short() });
    walk.step(1.0);
    walk.cycle.begin_reset();
    walk.finish();
    walk.lessons.lock().unwrap().clear();
    walk.step(1.0);
    let taught = walk.lessons.lock().unwrap().clone();
    assert_eq!(taught.len(), 50);
    let drawn = walk.lessons();
    for lesson in taught {
        assert!(drawn.contains(&lesson) && lesson.masks == [1.0; 2], "{lesson:?} is not in {drawn:?}");
    }
}

#[test]
fn each_cycle_is_measured_against_its_own_first_decision() {
    let odds = Odds::of(|cell, _| 1.0 - cell / 10.0);
    let mut walk = Walk::with(short(), |context| context.observation[0] + context.proposed[0] <= 3.0, odds);
    let starts = |walk: &Walk| std::mem::take(&mut walk.testimony.lock().unwrap().starts);
    walk.steps(2, 0.5);
    assert_eq!(starts(&walk), [1.0, 1.0]);
    // An attempt that fails ends no cycle; a hard reset does.
    walk.cell = 3.0;
    walk.cycle.begin_reset();
    assert!(!walk.finish().has_reset);
    walk.place();
    walk.cell = 1.0;
    walk.steps(2, 0.25);
    assert_eq!(starts(&walk), [0.9, 0.9]);
    // One that succeeds does, too.
    walk.cycle.begin_reset();
    assert!(walk.finish().has_reset);
    walk.cell = 2.0;
    walk.steps(2, 0.25);
    assert_eq!(starts(&walk), [0.8, 0.8]);
}

#[test]
fn an_attempt_says_what_the_critic_expected_of_it() {
    for (estimate, expected) in [(0.75, Some(0.75)), (f32::NAN, None)] {
        let mut calls = 0;
        // The first two decisions are judged by it, then it is asked of the attempt.
        let odds = Odds::of(move |cell, action| {
            calls += 1;
            if calls > 4 && (cell, action) == (1.0, -1.0) { estimate } else { 0.5 }
        });
        let mut walk = Walk::with(short(), |_| true, odds);
        walk.steps(2, 0.5);
        walk.cycle.begin_reset();
        let attempt = walk.finish();
        assert_eq!((attempt.has_reset, attempt.undo_probability), (true, expected));
        assert_eq!(walk.step(0.5).map(|episode| episode.undo_probability), None);
    }
}
