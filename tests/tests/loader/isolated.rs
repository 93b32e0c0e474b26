//! Plugins in a process of their own: what they do there must not reach this one.

use std::time::Duration;

use shield_api::{metrics::Metrics, *};
use shield_runtime::plugin::{
    PluginError, Registry, Selection, host,
    isolated::{IsolatedEnvironment, IsolatedPolicy, Isolation, OnFailure},
};

use crate::fixtures::{fixture, setup};

const ISOLATION: Isolation = Isolation {
    on_failure: OnFailure::Error,
    start_timeout: Duration::from_secs(60),
    step_timeout: Duration::from_secs(60),
};
const HASTY: Isolation = Isolation { step_timeout: Duration::from_millis(300), ..ISOLATION };
const RESTARTING: Isolation = Isolation { on_failure: OnFailure::Restart, ..ISOLATION };

/// The registry, with the program `shield` built in which plugins are isolated.
fn registry() -> Registry {
    shield_tests::shield();
    Registry::default()
}

fn world(config: &str, isolation: Isolation) -> Result<IsolatedEnvironment, PluginError> {
    let choice = Selection::new("deadly/world").at(fixture("deadly"));
    registry().isolated_environment(&choice, config, &Setup::new(0, 1, host()), isolation)
}

fn actor(config: &str, isolation: Isolation) -> IsolatedPolicy {
    let choice = Selection::new("deadly/actor").at(fixture("deadly"));
    registry().isolated_policy(&choice, config, &setup(), isolation).unwrap()
}

/// How each end is called in the error.
const ENDS: [(&str, &str); 4] = [
    ("exit", "exit code 3"),
    ("abort", "signal 6"),
    ("fault", "segmentation fault"),
    ("panic", "the floor is gone"),
];

#[test]
fn a_process_that_ends_in_a_step_is_an_error_with_the_reason() {
    for (end, expected) in ENDS {
        let mut world = world(&format!("(end: {end:?}, after: 2)"), ISOLATION).unwrap();
        let mut observation = [0.0];
        world.reset(0, &mut observation).unwrap();
        for step in 1..=2 {
            world.step(&[0.0], &mut observation).unwrap();
            assert_eq!(observation, [step as f32]);
        }
        let message = world.step(&[0.0], &mut observation).unwrap_err().to_string();
        assert!(message.contains("deadly/world") && message.contains(expected), "{message}");
        world.reset(0, &mut observation).unwrap_err();
    }
}

#[test]
fn what_a_plugin_printed_before_its_end_is_reported() {
    let error = world("(end: \"exit\")", ISOLATION).unwrap().step(&[0.0], &mut [0.0]).unwrap_err();
    assert!(error.message().ends_with("the licence has run out"), "{error}");
}

#[test]
fn a_hang_ends_at_its_time_limit() {
    let error = world("(end: \"hang\")", HASTY).unwrap().step(&[0.0], &mut [0.0]).unwrap_err();
    assert!(error.message().contains("no answer within 0.3 s"), "{error}");
    assert!(error.message().contains("worker.step_timeout_s"), "{error}");
}

#[test]
fn a_process_that_ends_in_create_is_an_error_with_the_reason() {
    for (end, expected) in ENDS {
        let error = world(&format!("(end: {end:?}, within: \"create\")"), RESTARTING).unwrap_err();
        assert!(matches!(error, PluginError::Create { .. }), "{error:?}");
        assert!(error.to_string().contains(expected), "{error}");
    }
    let hasty = Isolation { start_timeout: Duration::from_millis(300), ..ISOLATION };
    let error = world("(end: \"hang\", within: \"create\")", hasty).unwrap_err();
    assert!(error.to_string().contains("worker.start_timeout_s"), "{error}");
}

#[test]
fn a_fault_in_the_configuration_has_its_place() {
    let error = world("(end: \"exit\",\n after: true)", ISOLATION).unwrap_err();
    let (message, position) = error.config_fault().unwrap();
    assert_eq!(position.unwrap().line, 2, "{message}");
}

#[test]
fn a_lost_environment_is_started_again() {
    for (end, _) in ENDS {
        let mut world = world(&format!("(end: {end:?}, after: 1)"), RESTARTING).unwrap();
        let was_restarted = world.was_restarted();
        let mut observation = [0.0];
        // More often than is allowed in a row: each success between two failures counts.
        for _ in 0..5 {
            world.reset(0, &mut observation).unwrap();
            world.step(&[0.0], &mut observation).unwrap();
            assert_eq!(observation, [1.0]);
            world.step(&[0.0], &mut observation).unwrap_err();
            assert!(was_restarted.swap(false, std::sync::atomic::Ordering::Relaxed), "{end}");
        }
    }
}

#[test]
fn an_environment_that_never_works_is_started_again_three_times_only() {
    let mut world = world("(end: \"exit\")", RESTARTING).unwrap();
    let restarts = (0..10).filter(|_| {
        let done = world.reset(0, &mut [0.0]).and_then(|()| world.step(&[0.0], &mut [0.0]).map(|_| ()));
        assert!(done.is_err());
        world.was_restarted().swap(false, std::sync::atomic::Ordering::Relaxed)
    });
    assert_eq!(restarts.count(), 3);

    let mut world = self::world("(end: \"exit\", within: \"reset\")", RESTARTING).unwrap();
    let message = world.reset(0, &mut [0.0]).unwrap_err().to_string();
    assert!(message.contains("exit code 3"), "{message}");
}

#[test]
fn a_lost_policy_is_started_and_asked_again() {
    let mut action = [1.0];
    let mut actor = actor("(end: \"exit\", after: 2)", RESTARTING);
    for _ in 0..7 {
        actor.act(&[0.0; 2], &mut action).unwrap();
        assert_eq!(action, [0.0]);
    }
    let mut hopeless = self::actor("(end: \"exit\")", RESTARTING);
    assert!(hopeless.act(&[0.0; 2], &mut action).unwrap_err().message().contains("exit code 3"));
}

#[test]
fn the_metrics_of_an_isolated_plugin_reach_the_host() {
    let mut actor = actor("", ISOLATION);
    let metrics = Metrics::default();
    for _ in 0..3 {
        metrics.collect(|| actor.act(&[0.0; 2], &mut [0.0])).unwrap();
    }
    let mut found = Vec::new();
    metrics.drain(&mut |name, mean| found.push((name.to_string(), mean)));
    assert_eq!(found, [("calls".to_string(), 2.0)]);
}

#[test]
fn a_plugin_that_aborts_on_panic_runs_when_isolated() {
    let choice = Selection::new("fixture/idle").at(fixture("aborting"));
    let mut idle = registry().isolated_policy(&choice, "", &setup(), ISOLATION).unwrap();
    let mut action = [1.0];
    idle.act(&[0.0; 2], &mut action).unwrap();
    assert_eq!(action, [0.0]);
}

#[test]
fn an_isolated_environment_behaves_as_the_loaded_one() {
    let choice = Selection::new("fixture/line").at(fixture("every-kind"));
    let (registry, setup) = (registry(), Setup::new(3, 1, host()));
    let loaded = registry.environment(&choice, "", &setup).unwrap();
    let isolated = registry.isolated_environment(&choice, "", &setup, ISOLATION).unwrap();
    assert_eq!(loaded.spec(), isolated.spec());
    assert_eq!(loaded.starts(), isolated.starts());
    let start = loaded.starts().pop();
    let run = |world: &mut dyn Environment| {
        let mut observation = vec![0.0; world.spec().spaces.observation_len()];
        let mut seen = Vec::new();
        world.reset(7, &mut observation).unwrap();
        let mut state = Vec::new();
        for step in 0..20 {
            let outcome = world.step(&[(step as f32).sin()], &mut observation).unwrap();
            seen.push((observation.clone(), format!("{outcome:?}")));
            if step == 10 {
                world.save(&mut state).unwrap();
            }
        }
        world.load(&state).unwrap();
        let outcome = world.step(&[0.5], &mut observation).unwrap();
        seen.push((observation.clone(), format!("{outcome:?}")));
        if let Some(start) = &start {
            world.reset_to(start, 1, &mut observation).unwrap();
            seen.push((observation.clone(), start.clone()));
        }
        let wrong = world.reset_to("nowhere", 1, &mut observation).unwrap_err();
        let refused = world.load(b"no state").unwrap_err();
        (seen, state, wrong, refused, world.step(&[0.0; 3], &mut observation).is_err())
    };
    let (mut loaded, mut isolated) = (loaded, isolated);
    assert_eq!(run(&mut loaded), run(&mut isolated));
}
