//! A whole cycle with a success critic: its decisions, attempts, aborts, hard resets and everything that learns.

use std::{
    cell::Cell,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
};

use rand_pcg::Pcg64;
use shield_api::{AbortRule, Environment, Setup, Spaces};
use shield_runtime::{
    agent::{Agent, ForwardAgent},
    critic::Critic,
    cycle::{CycleParts, CycleSettings, HardResetDue, Memory, ResetCycle},
    decision::Decision,
    drop_in::DropInObserver,
    events::{Counters, DecisionEvent, EpisodeEnd, EpisodeEvent},
    experience::{AgentRole, Experience, UndoSettings},
    experiment::{AttemptLength, DropInFile, OnAbort, ProjectionConfig, QpConfig},
    plugin::{Registry, SearchPath, Selection, host},
    plugin_state::PluginState,
    shield::{Ladder, LadderSettings},
    world::{Stepped, World},
};
use shield_tests::plugins_folder;

use super::malloc_ffi::allocations;

const CAPACITY: usize = 500;

/// What happened while it was counted.
#[derive(Debug, Default, PartialEq)]
struct Happened {
    successes: usize,
    failures: usize,
    aborts: usize,
    idle_aborts: usize,
    projections: usize,
}

struct Course {
    cycle: ResetCycle,
    world: World,
    seed: u64,
    projects: bool,
    /// Allocations of the environment's own resets and of projections that found nothing: both may.
    granted: u64,
}

impl Course {
    fn new(environment: &str, [reset, critic, rule]: [(&str, &str); 3], projects: bool) -> Self {
        let registry = Registry::scan(&SearchPath::new([plugins_folder()]));
        let environment =
            registry.environment(&Selection::new(environment), "", &Setup::new(0, 1, host())).unwrap();
        let spaces = environment.spec().spaces;
        let setup = Setup::with_spaces(0, 1, host(), spaces.clone());
        let learner = |seed| {
            let setup = Setup::with_spaces(seed, 1, host(), spaces.clone());
            registry.learner(&Selection::new(reset.0), reset.1, &setup).unwrap()
        };
        let agent = |role, seed| {
            let sampler = Pcg64::new(5, u128::from(seed));
            Agent::new(role, Box::new(learner(seed)), 16, &spaces, sampler)
        };
        let (forward, reset) = (agent(AgentRole::Forward, 1), agent(AgentRole::Reset, 2));
        let members = [forward.info().members, reset.info().members];
        let critic = registry.success_critic(&Selection::new(critic.0), critic.1, &setup).unwrap();
        let critic = Critic::new(Box::new(critic), 16, &spaces, Pcg64::new(5, 3));
        let rule = registry.abort_rule(&Selection::new(rule.0), rule.1, &setup).unwrap();
        let ladder = ladder(Box::new(rule), &learner(2), &critic, spaces.clone(), projects);
        let undo = UndoSettings {
            bootstrap_probability: 0.5,
            failure_share: 0.25,
            success_share: 0.25,
            outcome_half_life: 5.0,
        };
        let experience = Experience::new(CAPACITY, &spaces, members, 0.5).unwrap().with_undo(undo).unwrap();
        let parts = CycleParts {
            forward: Some(ForwardAgent::Learner(Box::new(forward))),
            reset: Some(reset),
            success: Some(critic),
            ladder: Some(ladder),
            memory: Some(Memory { experience, masks: Pcg64::new(5, 4) }),
        };
        let settings = CycleSettings {
            forward_length: Some(25),
            attempt_length: AttemptLength::Steps(15),
            on_abort: OnAbort::Penalise(1.0),
            shield_exploration: true,
            ..CycleSettings::default()
        };
        let lengths = [spaces.observation_len(), spaces.action_len()];
        let cycle = ResetCycle::new(settings, parts, lengths);
        let world = World::new(Box::new(environment), None).unwrap();
        let mut course = Self { cycle, world, seed: 0, projects, granted: 0 };
        course.place();
        course
    }

    fn place(&mut self) {
        self.seed += 1;
        self.granted += allocations(|| self.world.hard_reset(None, self.seed).unwrap());
        self.cycle.placed();
    }

    /// One step of the agent whose turn it is, or an abort.
    fn step(&mut self, happened: &mut Happened) {
        let Self { cycle, world, .. } = self;
        let role = cycle.turn();
        cycle.begin_episode();
        if role == AgentRole::Reset {
            cycle.act_to_reset(world.observation()).unwrap();
        } else {
            cycle.propose(world.observation()).unwrap();
            let mut decision = Decision::Resetting;
            let count = allocations(|| decision = cycle.decide(world.observation()));
            happened.projections += usize::from(decision.projection().is_some());
            if let Some(abort) = decision.abort() {
                self.granted += if self.projects { count } else { 0 };
                let is_idle = cycle.has_nothing_to_undo();
                assert_eq!(cycle.finish_aborted(abort.cause).end, EpisodeEnd::Abort);
                happened.aborts += usize::from(!is_idle);
                happened.idle_aborts += usize::from(is_idle);
                return;
            }
        }
        let Stepped::Made(outcome) = world.step(cycle.action()).unwrap() else {
            panic!("nothing is isolated")
        };
        let end = cycle.observe(world.next_observation(), &outcome).unwrap();
        world.advance();
        let Some(end) = end else { return };
        let episode = cycle.finish(end);
        if role == AgentRole::Reset {
            happened.successes += usize::from(episode.has_reset);
            happened.failures += usize::from(!episode.has_reset);
        }
        if cycle.hard_reset_due() == Some(HardResetDue::CycleOver) {
            cycle.count_hard_reset(1.0, true);
        }
        if cycle.hard_reset_due().is_some() {
            self.place();
        }
    }

    fn steps(&mut self, count: usize) -> Happened {
        let metrics = self.cycle.metrics().clone();
        let mut happened = Happened::default();
        metrics.collect(|| (0..count).for_each(|_| self.step(&mut happened)));
        happened
    }
}

fn ladder(
    rule: Box<dyn AbortRule>,
    reset: &dyn shield_api::Learner,
    critic: &Critic,
    spaces: Spaces,
    projects: bool,
) -> Ladder {
    let fallback_action = vec![0.0; spaces.action_len()];
    let settings = LadderSettings { spaces, warm_up_steps: 0, fallback_action };
    let ladder = Ladder::new(vec![rule], reset, settings).unwrap().with_success_critic(critic.info());
    if !projects {
        return ladder;
    }
    ladder.with_projection(ProjectionConfig::Qp(QpConfig::default())).unwrap()
}

#[test]
fn a_cycle_with_a_success_critic_allocates_nothing_learning_included() {
    let networks = ("ddpg", "(critics: 3, actor_hidden: [16, 16], critic_hidden: [16, 16], random_steps: 0)");
    let critic = ("success-critic", "(hidden: [16, 16], learning_rate: 0.01)");
    // One that follows what happens, and one that rejects everything at the start.
    let usual = ("undo-probability", "(initial_threshold: 0.9)");
    let strict = ("undo-probability", "(relative: false, initial_threshold: 1.0, adapt: false)");
    // The mean of the members is one row, which is solved in closed form.
    let one_row = ("undo-probability", "(initial_threshold: 0.9, combine: Realist)");
    let tables = [("tabular-q", "()"), ("tabular-success", "()")];
    for (environment, plugins, projects) in [
        ("mujoco/cliff-cart", [networks, critic, one_row], true),
        ("mujoco/cliff-cart", [networks, critic, strict], false),
        ("gridworld", [tables[0], tables[1], usual], false),
    ] {
        let mut course = Course::new(environment, plugins, projects);
        // Until the memory has begun anew, and everyone has learned of successes and of failures.
        course.steps(3 * CAPACITY);
        course.granted = 0;
        let mut happened = Happened::default();
        let count = allocations(|| happened = course.steps(4 * CAPACITY)) - course.granted;
        let Happened { successes, failures, aborts, idle_aborts, projections } = happened;
        assert!(successes > 0 && failures > 0 && aborts > 0 && idle_aborts + projections > 0, "{happened:?}");
        assert_eq!(count, 0, "{environment}, {:?}: {happened:?}", plugins[2]);
    }
}

/// Hears everything, and keeps two sums.
#[derive(Default)]
struct Listener {
    decisions: Arc<AtomicU64>,
    episodes: Arc<AtomicU64>,
}

impl DropInObserver for Listener {
    fn on_decision(&mut self, decision: &DecisionEvent<'_>, reason: &str) {
        assert_eq!(decision.rejection.is_some(), !reason.is_empty());
        self.decisions.fetch_add(1, Ordering::Relaxed);
    }

    fn on_metric(&mut self, _: &str, _: f64) {}

    fn on_episode(&mut self, _: &EpisodeEvent, _: &Counters) {
        self.episodes.fetch_add(1, Ordering::Relaxed);
    }

    fn on_hard_reset(&mut self, _: &Counters) {}

    fn on_restored(&mut self, _: &Counters, _: &[PluginState]) {}
}

#[test]
fn a_drop_in_that_is_observed_allocates_nothing() {
    let registry = Registry::scan(&SearchPath::new([plugins_folder()]));
    let setup = Setup::new(0, 1, host());
    let environment = registry.environment(&Selection::new("mujoco/cliff-cart"), "", &setup).unwrap();
    let text = r#"DropIn(
        reset: (plugin: "ddpg", config: (critics: 2, actor_hidden: [16], critic_hidden: [16], random_steps: 0)),
        shield: (rules: [(plugin: "undo-probability", config: (relative: false, initial_threshold: 0.9))], shield_exploration: true),
        experience: (batch: 16, updates: Both, capacity: 500), episode_length: 15,
    )"#;
    let file = DropInFile::from_text("x.ron", text, &[]).unwrap();
    let mut shield = file.open(&registry, Some(environment.spec().spaces)).unwrap();
    let listener = Listener::default();
    let heard = [Arc::clone(&listener.decisions), Arc::clone(&listener.episodes)];
    shield.report_to(Box::new(listener));
    let mut world = World::new(Box::new(environment), None).unwrap();
    world.hard_reset(None, 0).unwrap();
    shield.hard_reset_done(world.observation()).unwrap();
    // Allocations of the environment's own resets.
    let (granted, mut seed) = (Cell::new(0), 0);
    let mut steps = |count: u64| {
        for step in 0..count {
            let mut action = [if step % 3 == 0 { -0.5 } else { 0.7 }];
            shield.filter(world.observation(), &mut action).unwrap();
            let Stepped::Made(outcome) = world.step(&action).unwrap() else { panic!("nothing is isolated") };
            shield.observe_outcome(world.next_observation(), &outcome).unwrap();
            world.advance();
            if step % 40 == 39 {
                shield.begin_reset();
            }
            if shield.needs_hard_reset() {
                seed += 1;
                granted.set(granted.get() + allocations(|| world.hard_reset(None, seed).unwrap()));
                shield.hard_reset_done(world.observation()).unwrap();
            }
        }
    };
    steps(1_500);
    let before = heard.each_ref().map(|count| count.load(Ordering::Relaxed));
    granted.set(0);
    let count = allocations(|| steps(1_500)) - granted.get();
    let after = heard.each_ref().map(|count| count.load(Ordering::Relaxed));
    assert_eq!(count, 0, "{count} allocations in 1,500 steps");
    assert!(after[0] > before[0] + 500 && after[1] > before[1] + 20, "{before:?} {after:?}");
}
