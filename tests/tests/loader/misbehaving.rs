//! Plugins with right tables that do what no plugin should.

use shield_api::*;
use shield_runtime::plugin::{
    LoadedAbortRule, LoadedEnvironment, LoadedLearner, PluginError, Registry, Selection, host,
};

use crate::fixtures::fixture;

fn spaces() -> Setup {
    let spaces = Spaces { observation: Space::unbounded(1), action: Space::uniform(1, -1.0, 1.0) };
    Setup::with_spaces(0, 1, host(), spaces)
}

fn choice(id: &str) -> Selection {
    Selection::new(id).at(fixture("faulty"))
}

fn config(fault: &str) -> String {
    format!("(fault: {fault:?})")
}

fn world(fault: &str) -> Result<LoadedEnvironment, PluginError> {
    Registry::default().environment(&choice("faulty/world"), &config(fault), &Setup::new(0, 1, host()))
}

fn agent(fault: &str) -> Result<LoadedLearner, PluginError> {
    Registry::default().learner(&choice("faulty/agent"), &config(fault), &spaces())
}

fn rule(fault: &str) -> LoadedAbortRule {
    Registry::default().abort_rule(&choice("faulty/rule"), &config(fault), &spaces()).unwrap()
}

const CONTEXT: RuleContext<'static> = RuleContext {
    step: 0,
    observation: &[0.0],
    proposed: &[0.0],
    previous: None,
    values: &[],
    greedy_values: &[],
    forward_values: &[],
    discount: 0.9,
    phase: Phase::Forward,
    probabilities: &[],
    greedy_probabilities: &[],
    start_probabilities: &[],
};

fn check_failed<T: std::fmt::Debug>(outcome: Result<T>, expected: &str) {
    assert_eq!(outcome.unwrap_err(), Error::failed(expected));
}

#[test]
fn a_panic_in_create_is_an_error() {
    let error = world("panic in create").unwrap_err();
    let PluginError::Create { kind, message, .. } = &error else { panic!("{error:?}") };
    assert_eq!(*kind, ErrorKind::Panicked);
    assert!(message.contains("cannot be made") && message.contains("lib.rs:"), "{message}");
}

#[test]
fn a_panic_takes_the_instance_and_no_other_out_of_service() {
    let (mut broken, mut whole) = (world("panic in step").unwrap(), world("").unwrap());
    let mut observation = [0.0];
    broken.reset(0, &mut observation).unwrap();
    let error = broken.step(&[0.0], &mut observation).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Panicked);
    assert!(error.message().starts_with("faulty/world: panicked: "), "{error}");
    assert!(error.message().contains("the floor is gone"), "{error}");

    for later in [broken.reset(0, &mut observation), broken.save(&mut Vec::new()), broken.load(&[])] {
        let error = later.unwrap_err();
        assert_eq!(error.kind(), ErrorKind::Panicked);
        assert!(error.message().contains("out of service") && error.message().contains("the floor is gone"));
    }
    whole.reset(0, &mut observation).unwrap();
    whole.step(&[0.0], &mut observation).unwrap();
}

/// Calls everything that an environment can do, in the order in which a host would.
fn use_world(fault: &str) -> Result<(), String> {
    let mut world = world(fault).map_err(|error| error.to_string())?;
    let mut observation = [0.0];
    let mut used = || {
        world.reset(0, &mut observation)?;
        world.reset_to("there", 0, &mut observation)?;
        world.step(&[0.0], &mut observation)?;
        world.reset_kind()?;
        let [width, height] = world.frame_size();
        world.render(&mut Frame::new(width, height, &mut vec![0; 3 * width * height])?)?;
        world.save(&mut Vec::new())?;
        refused_only(world.load(&[]))
    };
    used().map_err(|error| error.message().to_string())
}

/// Nothing of the faulty loads a state.
fn refused_only(loaded: Result<()>) -> Result<()> {
    loaded.or_else(|error| if error.kind() == ErrorKind::Unsupported { Ok(()) } else { Err(error) })
}

fn use_agent(fault: &str) -> Result<(), String> {
    let mut agent = agent(fault).map_err(|error| error.to_string())?;
    let (mut action, mut values, mut gradients) = ([0.0], [0.0], [0.0]);
    let one = [0.0];
    let batch = Batch {
        size: 1,
        observations: &one,
        actions: &one,
        rewards: &one,
        next_observations: &one,
        continuations: &one,
        masks: &one,
    };
    let mut used = || {
        agent.act(&one, ActMode::Greedy, &mut action)?;
        agent.q_values(&one, &one, &mut values)?;
        agent.q_gradients(&one, &one, &mut values, &mut gradients)?;
        agent.update(&batch)?;
        refused_only(agent.load(&[]))
    };
    used().map_err(|error| error.message().to_string())
}

fn use_actor(fault: &str) -> Result<(), String> {
    let actor = Registry::default().policy(&choice("faulty/actor"), &config(fault), &spaces());
    let acted = actor.map_err(|error| error.to_string())?.act(&[0.0], &mut [0.0]);
    acted.map_err(|error| error.message().to_string())
}

fn use_rule(fault: &str) -> Result<(), String> {
    struct Nothing;
    impl Rows for Nothing {
        fn push(&mut self, _: &[f32], _: f32) -> Result<()> {
            Ok(())
        }
    }
    let rule = Registry::default().abort_rule(&choice("faulty/rule"), &config(fault), &spaces());
    let mut rule = rule.map_err(|error| error.to_string())?;
    let mut used = || {
        rule.evaluate(&CONTEXT, &mut Reason::new(&mut []))?;
        rule.linearise(&CONTEXT, &[], &mut Nothing)?;
        rule.observe(&ObservedDecision { step: 0, aborted: false, action: &[0.0] })
    };
    used().map_err(|error| error.message().to_string())
}

fn use_task(fault: &str) -> Result<(), String> {
    let task = Registry::default().reset_task(&choice("faulty/task"), &config(fault), &spaces());
    let mut task = task.map_err(|error| error.to_string())?;
    let used = task.observe_start(&[0.0]).and_then(|()| task.evaluate(&[0.0], &[0.0], &[0.0]));
    used.map(|_| ()).map_err(|error| error.message().to_string())
}

#[test]
fn a_panic_in_any_function_of_any_kind_is_an_error_that_names_it() {
    type Use = fn(&str) -> Result<(), String>;
    let kinds: [(Use, &[&str]); 5] = [
        (
            use_world,
            &[
                "spec",
                "starts",
                "reset_kinds",
                "reset",
                "reset_to",
                "step",
                "reset_kind",
                "frame_size",
                "render",
                "load",
            ],
        ),
        (use_agent, &["info", "act", "q_values", "q_gradients", "update", "load"]),
        (use_actor, &["act"]),
        (use_rule, &["needs", "evaluate", "linearise", "observe"]),
        (use_task, &["evaluate", "observe_start"]),
    ];
    for (use_all, functions) in kinds {
        assert_eq!(use_all(""), Ok(()));
        for function in functions {
            let error = use_all(&format!("panic in {function}")).expect_err(function);
            let message = format!("the floor is gone in {function} (");
            assert!(error.contains(&message) && error.contains("lib.rs:"), "{function}: {error}");
        }
    }
}

#[test]
fn a_panic_under_a_shared_reference_takes_the_rule_out_of_service() {
    let rule = rule("panic in evaluate");
    for expected in ["panicked: ", "out of service"] {
        let error = rule.evaluate(&CONTEXT, &mut Reason::new(&mut [])).unwrap_err();
        assert!(error.message().contains(expected), "{error}");
    }
}

#[test]
fn a_panic_in_save_takes_the_instance_out_of_service() {
    let mut broken = world("panic in save").unwrap();
    assert_eq!(broken.save(&mut Vec::new()).unwrap_err().kind(), ErrorKind::Panicked);
    assert!(broken.reset(0, &mut [0.0]).unwrap_err().message().contains("cannot be saved"));
}

#[test]
fn a_panic_in_drop_stays_in_the_plugin() {
    drop(world("panic in drop").unwrap());
    world("").unwrap().reset(0, &mut [0.0]).unwrap();
}

#[test]
fn a_missing_ability_is_reported_as_unsupported() {
    let error = world("").unwrap().load(&[]).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::Unsupported);
    assert_eq!(error.message(), "faulty/world: loading a state is not supported by this plugin");
}

#[test]
fn non_finite_numbers_of_an_environment_are_errors() {
    let mut observation = [0.5];
    for fault in ["NaN in reset", "forgotten observation"] {
        check_failed(
            world(fault).unwrap().reset(0, &mut [0.5]),
            "faulty/world: `reset` gave NaN for observation[0]",
        );
    }
    for (fault, expected) in [
        ("infinite observation", "faulty/world: `step` gave inf for observation[0]"),
        ("NaN forward reward", "faulty/world: `step` gave NaN for [forward, reset] reward[0]"),
        ("NaN reset reward", "faulty/world: `step` gave NaN for [forward, reset] reward[1]"),
    ] {
        check_failed(world(fault).unwrap().step(&[0.0], &mut observation), expected);
    }
}

#[test]
fn non_finite_numbers_of_an_agent_are_errors() {
    let (observation, mut action, mut values, mut gradients) = ([0.0], [0.0], [0.0], [0.0]);
    check_failed(
        agent("NaN action").unwrap().act(&observation, ActMode::Greedy, &mut action),
        "faulty/agent: `act` gave NaN for action[0]",
    );
    let mut broken = agent("NaN value").unwrap();
    check_failed(
        broken.q_values(&observation, &[0.0], &mut values),
        "faulty/agent: `q_values` gave NaN for values[0]",
    );
    check_failed(
        broken.q_gradients(&observation, &[0.0], &mut values, &mut gradients),
        "faulty/agent: `q_gradients` gave NaN for values[0]",
    );
    check_failed(
        agent("NaN gradient").unwrap().q_gradients(&observation, &[0.0], &mut values, &mut gradients),
        "faulty/agent: `q_gradients` gave NaN for gradients[0]",
    );
    let mut actor =
        Registry::default().policy(&choice("faulty/actor"), &config("NaN action"), &spaces()).unwrap();
    check_failed(actor.act(&observation, &mut action), "faulty/actor: `act` gave NaN for action[0]");
}

#[test]
fn an_output_that_the_plugin_leaves_unwritten_is_an_error() {
    let mut agent = agent("forgetful").unwrap();
    let observation = [0.0];
    check_failed(
        agent.act(&observation, ActMode::Greedy, &mut [0.5]),
        "faulty/agent: `act` gave NaN for action[0]",
    );
    check_failed(
        agent.q_values(&observation, &[0.0], &mut [0.5]),
        "faulty/agent: `q_values` gave NaN for values[0]",
    );
    check_failed(
        agent.q_gradients(&observation, &[0.0], &mut [0.5], &mut [0.5]),
        "faulty/agent: `q_gradients` gave NaN for gradients[0]",
    );
    let mut actor =
        Registry::default().policy(&choice("faulty/actor"), &config("forgetful"), &spaces()).unwrap();
    check_failed(actor.act(&observation, &mut [0.5]), "faulty/actor: `act` gave NaN for action[0]");
    check_failed(
        world("forgetful").unwrap().step(&[0.0], &mut [0.5]),
        "faulty/world: `step` gave NaN for observation[0]",
    );
}

#[test]
fn nan_from_a_rule_or_a_reset_task_is_an_error() {
    check_failed(
        rule("NaN score").evaluate(&CONTEXT, &mut Reason::new(&mut [])),
        "faulty/rule: `evaluate` gave NaN for the score",
    );
    let mut task =
        Registry::default().reset_task(&choice("faulty/task"), &config("NaN reward"), &spaces()).unwrap();
    check_failed(task.evaluate(&[0.0], &[0.0], &[0.0]), "faulty/task: `evaluate` gave NaN for reward[0]");
}

#[test]
fn a_refused_row_is_an_error_even_if_the_rule_ignores_it() {
    struct Nothing(usize);
    impl Rows for Nothing {
        fn push(&mut self, _: &[f32], _: f32) -> Result<()> {
            self.0 += 1;
            Ok(())
        }
    }
    let mut rows = Nothing(0);
    for (fault, expected) in [
        ("long row", "the row has 2 values, expected 1"),
        ("NaN row", "the row[0] is NaN"),
        ("infinite bound", "the bound[0] is inf"),
    ] {
        let error = rule(fault).linearise(&CONTEXT, &[], &mut rows).unwrap_err();
        assert!(error.message().contains(expected), "{error}");
    }
    assert_eq!(rows.0, 0);
    rule("").linearise(&CONTEXT, &[], &mut rows).unwrap();
    assert_eq!(rows.0, 1);
}

#[test]
fn an_instance_that_describes_itself_wrongly_is_refused() {
    for (error, expected) in [
        (world("no observation").map(|_| ()), "the observation space has 0 lower and 0 upper bounds"),
        (world("no steps").map(|_| ()), "an episode length of 0"),
        (agent("no members").map(|_| ()), "an ensemble of 0 members"),
        (agent("discount").map(|_| ()), "the discount 1.5, which is not in [0, 1]"),
        (agent("NaN discount").map(|_| ()), "the discount NaN, which is not in [0, 1]"),
    ] {
        let message = error.unwrap_err().to_string();
        assert!(message.contains(expected), "{message}");
    }
}
