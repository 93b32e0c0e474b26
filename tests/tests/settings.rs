//! What our plugins refuse of their configurations is said with the place of the value.
#![allow(clippy::unwrap_used, reason = "tests")]

use shield_api::{Setup, Space, Spaces, notation::position_at};
use shield_runtime::plugin::{PluginError, Registry, SearchPath, Selection, host};
use shield_tests::plugins_folder;

enum Kind {
    Environment,
    Learner,
    SuccessCritic,
    Policy,
    Rule,
    Task,
}

fn make(kind: &Kind, id: &str, config: &str, spaces: Spaces) -> Result<(), PluginError> {
    let registry = Registry::scan(&SearchPath::new([plugins_folder()]));
    let (choice, setup) = (Selection::new(id), Setup::with_spaces(0, 1, host(), spaces));
    match kind {
        Kind::Environment => registry.environment(&choice, config, &Setup::new(0, 1, host())).map(drop),
        Kind::Learner => registry.learner(&choice, config, &setup).map(drop),
        Kind::SuccessCritic => registry.success_critic(&choice, config, &setup).map(drop),
        Kind::Policy => registry.policy(&choice, config, &setup).map(drop),
        Kind::Rule => registry.abort_rule(&choice, config, &setup).map(drop),
        Kind::Task => registry.reset_task(&choice, config, &setup).map(drop),
    }
}

/// `config` holds a `@` where the value is that is refused.
fn check(kind: &Kind, id: &str, config: &str, action: Space) {
    check_in(kind, id, config, Spaces { observation: Space::unbounded(2), action });
}

fn check_in(kind: &Kind, id: &str, config: &str, spaces: Spaces) {
    let place = config.find('@').expect("a mark");
    let text = config.replacen('@', "", 1);
    let error = make(kind, id, &text, spaces).expect_err(config);
    let (message, position) = error.config_fault().unwrap_or_else(|| panic!("{id} {config}: {error}"));
    assert_eq!(position, Some(position_at(&text, place)), "{id} {config}: {message}");
}

fn boxed() -> Space {
    Space::uniform(1, -1.0, 1.0)
}

#[test]
fn a_rule_or_task_points_at_the_value_that_it_refuses() {
    for (id, configs) in [
        (
            "ensemble-threshold",
            &[
                "(combine: Realist,\n q_min: @inf)",
                "(combine: @Quantile(2.0))",
                "(final_q_min: @5.0)",
                "(schedule_steps: @5)",
                "(schedule: @Cosine)",
                "(schedule: Cosine, schedule_steps: 1, final_q_min: @Some(NaN))",
                "(q_min: 1, @q_max: 2)",
                "(combine: @Median)",
            ][..],
        ),
        ("advantage", &["(min_advantage: @NaN)", "(\n\n combine: @KOfN(0))"]),
        ("uncertainty", &["(limit: @-1.0)", "(limit: @inf)"]),
        ("deadline-latch", &["( /* none */ steps: @0)"]),
        (
            "undo-probability",
            &[
                "(accepted_risk: @1.0)",
                "(hard_resets_per_1000: @0.0)",
                "(accepted_risk: 0.1,\n hard_resets_per_1000: @2.0)",
                "(adapt: false, accepted_risk: @0.1)",
                "(combine: @KOfN(0))",
                "(adaptation_rate: @0.0)",
                "(initial_threshold: @NaN)",
                "(@risk: 0.1)",
            ],
        ),
        (
            "linear-constraints",
            &[
                "(constraints: [(a: [1.0], b: 1.0), @(a: [], b: 1.0)])",
                "(max_change: @[-1.0])",
                "(constraints: [(a: [1.0], @c: 1.0)])",
            ],
        ),
    ] {
        configs.iter().for_each(|config| check(&Kind::Rule, id, config, boxed()));
    }
    for config in [
        "(margin: @0.0)",
        "(radius: @NaN)",
        "(average_over: @0)",
        "(target: @Some([1.0]))",
        "(weights: @[1.0])",
        "(weights: [1.0, @-1.0])",
        "(weights: @Some([0.0, 0.0]))",
    ] {
        check(&Kind::Task, "near-start", config, boxed());
    }
    for config in
        ["(coverage: @1.0)", "(starts: @0)", "(starts: @257)", "(experience: @0)", "(least_radius: @-0.1)"]
    {
        check(&Kind::Task, "calibrated-start", config, boxed());
    }
}

#[test]
fn a_learner_or_policy_points_at_the_value_that_it_refuses() {
    for id in ["ddpg", "td3", "sac", "crossq"] {
        for config in [
            "(critics: @0)",
            "(critics: 2,\n actor_hidden: @[])",
            "(critic_hidden: @[4, 0])",
            "(actor_rate: @-1.0)",
            "(discount: @2.0)",
            "(gradient_clip: @0.0)",
            "(dropout: @1.0)",
            "(valuation: @Double)",
        ] {
            check(&Kind::Learner, id, config, boxed());
        }
    }
    for id in ["ddpg", "td3"] {
        check(&Kind::Learner, id, "(noise: OrnsteinUhlenbeck(theta: @2.0))", boxed());
        check(&Kind::Learner, id, "(final_sigma: @Some(-1.0))", boxed());
    }
    check(&Kind::Learner, "sac", "(initial_temperature: @0.0)", boxed());
    check(&Kind::Learner, "td3", "(policy_delay: @0)", boxed());
    for config in ["(members: @0)", "(hidden: @[])", "(rate: @0.0)", "(epsilon: @2.0)"] {
        check(&Kind::Learner, "ddqn", config, Space::Discrete { n: 2 });
    }
    for config in ["(members: @0)", "(learning_rate: @2.0)", "(initial_low: 0.0, initial_high: @-1.0)"] {
        check(&Kind::Learner, "tabular-q", config, Space::Discrete { n: 2 });
    }
    check(&Kind::Policy, "onnx", "( path: @\"nowhere.onnx\")", boxed());
}

#[test]
fn a_success_critic_points_at_the_value_that_it_refuses() {
    for config in [
        "(members: @0)",
        "(members: 2,\n hidden: @[])",
        "(hidden: @[4, 0])",
        "(learning_rate: @-1.0)",
        "(discount: @2.0)",
        "(outcome_weight: @NaN)",
        "(tau: @0.0)",
        "(initial_probability: @1.0)",
    ] {
        check(&Kind::SuccessCritic, "success-critic", config, boxed());
    }
    let spaces = || Spaces { observation: Space::Discrete { n: 4 }, action: Space::Discrete { n: 2 } };
    for config in [
        "(members: @0)",
        "(discount: @2.0)",
        "(outcome_weight: @-0.1)",
        "(initial_probability: @NaN)",
        "(least_step: @1.5)",
    ] {
        check_in(&Kind::SuccessCritic, "tabular-success", config, spaces());
    }
}

#[test]
fn an_environment_points_at_the_value_that_it_refuses() {
    for (id, config) in [
        ("gridworld", "(horizon: @0)"),
        ("gridworld", "(map: @\"nowhere\")"),
        ("gridworld", "(map: @[\"S.\", \".\"])"),
        ("mujoco/cliff-cart", "(fall_cost: @-1.0)"),
        ("mujoco/cliff-cart", "(horizon: @0)"),
        ("mujoco/cliff-cheetah", "(control_step: @0)"),
        ("mujoco/cliff-cheetah", "(start_noise: @NaN)"),
        ("mujoco/cliff-walker", "(cliff_length: @0.0)"),
        ("mujoco/pusher", "(reset_distance: @0.0)"),
        ("gymnasium", "(id: @\"\")"),
        ("gymnasium", "(id: \"x\", step_timeout_s: @0.0)"),
        ("gymnasium", "(id: \"x\", python: @\"/nowhere/python\")"),
    ] {
        check(&Kind::Environment, id, config, boxed());
    }
}
