//! The reset cycle with a success critic: what an abort with nothing to undo costs, which outcomes attempts have, and what is taught of them.
#![allow(clippy::unwrap_used, reason = "a test")]

#[path = "../common/mod.rs"]
mod common;
mod nothing_to_undo;
mod outcomes;

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
