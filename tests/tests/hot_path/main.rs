//! Filter, step and store allocate nothing once the run goes on: with the real plugins, through the binary interface.

#![cfg(all(target_os = "linux", target_env = "gnu"))]
#![allow(clippy::unwrap_used, reason = "tests")]

mod malloc_ffi;
mod undo;

use malloc_ffi::allocations;
use rand::RngExt;
use rand_pcg::Pcg64;
use shield_api::{AbortRule, ActMode, Environment, Learner, Setup};
use shield_runtime::{
    experience::{AgentShare, Experience, Fate, Transition},
    experiment::{ProjectionConfig, QpConfig},
    plugin::{Registry, SearchPath, Selection, host},
    shield::{Agents, Ladder, LadderSettings, Moment},
    world::{Stepped, World},
};
use shield_tests::plugins_folder;

const STEPS: usize = 2_000;

/// `q_min` far below every value allows everything, far above aborts everything; both ways are hot.
fn allocations_per_run(environment: &str, q_min: &str) -> (u64, usize) {
    let registry = Registry::scan(&SearchPath::new([plugins_folder()]));
    let environment =
        registry.environment(&Selection::new(environment), "", &Setup::new(0, 1, host())).unwrap();
    let spaces = environment.spec().spaces;
    let setup = Setup::with_spaces(0, 1, host(), spaces.clone());
    let networks = "(critics: 20, actor_hidden: [16, 16], critic_hidden: [16, 16], random_steps: 0)";
    let mut forward = registry.learner(&Selection::new("ddpg"), networks, &setup).unwrap();
    let mut reset = registry.learner(&Selection::new("ddpg"), networks, &setup).unwrap();
    let config = format!("(q_min: {q_min}, combine: Realist)");
    let rule = registry.abort_rule(&Selection::new("ensemble-threshold"), &config, &setup).unwrap();
    let rules: Vec<Box<dyn AbortRule>> = vec![Box::new(rule)];
    let fallback_action = vec![0.0; spaces.action_len()];
    let settings = LadderSettings { spaces: spaces.clone(), warm_up_steps: 10, fallback_action };
    let mut shield = Ladder::new(rules, &reset, settings).unwrap();
    let mut world = World::new(Box::new(environment), None).unwrap();
    world.hard_reset(None, 0).unwrap();
    let mut experience = Experience::new(STEPS / 2, &spaces, [20, 20], 0.5).unwrap();
    let mut masks = Pcg64::new(1, 2);
    let mut action = vec![0.0; spaces.action_len()];
    let mut aborts = 0;

    let mut steps = |from: usize, count: usize| {
        for step in from..from + count {
            forward.act(world.observation(), ActMode::Explore, &mut action).unwrap();
            let moment = Moment { step: step as u64, observation: world.observation(), previous: None };
            aborts += usize::from(
                shield
                    .filter(Agents { reset: &mut reset, forward: None, success: None }, &moment, &mut action)
                    .abort()
                    .is_some(),
            );
            let Stepped::Made(outcome) = world.step(&action).unwrap() else { panic!("nothing is isolated") };
            let transition = Transition {
                observation: world.observation(),
                action: &action,
                next_observation: world.next_observation(),
                forward: Some(AgentShare { reward: outcome.forward_reward, continues: true }),
                reset: Some(AgentShare { reward: outcome.reset_reward, continues: true }),
                fate: Some(Fate::of(&outcome)),
            };
            experience.push(&transition, &mut masks);
            world.advance();
        }
    };
    steps(0, 20);
    let count = allocations(|| steps(20, STEPS));
    (count, aborts)
}

#[test]
fn filter_step_and_store_allocate_nothing() {
    for environment in ["mujoco/cliff-cart", "mujoco/cliff-cheetah"] {
        for (q_min, expected_aborts) in [("-1e6", 0), ("1e6", STEPS + 10)] {
            let (count, aborts) = allocations_per_run(environment, q_min);
            assert_eq!(count, 0, "{environment}, q_min {q_min}: {count} allocations in {STEPS} steps");
            assert_eq!(aborts, expected_aborts);
        }
    }
}

/// Projections with the rows of 20 members and of linear constraints, several of which decide.
#[test]
fn a_projected_action_allocates_nothing() {
    let registry = Registry::scan(&SearchPath::new([plugins_folder()]));
    let id = Selection::new("mujoco/cliff-cheetah");
    let spaces = registry.environment(&id, "", &Setup::new(0, 1, host())).unwrap().spec().spaces;
    let setup = Setup::with_spaces(0, 1, host(), spaces.clone());
    let networks = "(critics: 20, actor_hidden: [16, 16], critic_hidden: [16, 16], random_steps: 0)";
    let mut reset = registry.learner(&Selection::new("ddpg"), networks, &setup).unwrap();
    let rule = |id: &str, config: &str| -> Box<dyn AbortRule> {
        Box::new(registry.abort_rule(&Selection::new(id), config, &setup).unwrap())
    };
    let linear = "(constraints: [(a: [1.0, 1.0, 0.0, 0.0, 0.0, 0.0], b: 0.1), (a: [0.0, 1.0, 1.0, 0.0, 0.0, 0.0], b: 0.1), \
                  (a: [0.0, 0.0, 1.0, 1.0, 1.0, 1.0], b: 0.1)], max_change: Some([0.5, 0.5, 0.5, 0.5, 0.5, 0.5]))";
    let rules = vec![rule("linear-constraints", linear), rule("ensemble-threshold", "(q_min: -1e6)")];
    let settings = LadderSettings { spaces, warm_up_steps: 0, fallback_action: vec![0.0; 6] };
    let mut ladder = Ladder::new(rules, &reset, settings)
        .and_then(|ladder| ladder.with_projection(ProjectionConfig::Qp(QpConfig::default())))
        .unwrap();
    let mut random = Pcg64::new(3, 4);
    let (mut projected, observation) = (0, [0.1; 18]);
    let mut decisions = |count: u64| {
        for step in 0..count {
            let mut action: [f32; 6] = std::array::from_fn(|_| random.random_range(-0.4..=0.4));
            let moment = Moment { step, observation: &observation, previous: Some(&[0.0; 6]) };
            let agents = Agents { reset: &mut reset, forward: None, success: None };
            projected += usize::from(ladder.filter(agents, &moment, &mut action).projection().is_some());
        }
    };
    decisions(20);
    let count = allocations(|| decisions(STEPS as u64));
    assert_eq!(count, 0, "{count} allocations in {STEPS} decisions");
    assert!(projected > STEPS / 2, "{projected} of {STEPS} were projected");
}

#[test]
fn the_count_sees_what_a_plugin_allocates() {
    let registry = Registry::scan(&SearchPath::new([plugins_folder()]));
    let count = allocations(|| {
        registry
            .environment(&Selection::new("gridworld"), "(map: [\"S.G\"])", &Setup::new(0, 1, host()))
            .unwrap();
    });
    let again = allocations(|| drop(Vec::<u8>::with_capacity(100)));
    assert!(count > 20 && again == 1, "{count} and {again} allocations were seen");
}
