//! Loaded instances behave as the Rust types that they are.

use std::{path::Path, sync::Mutex};

use log::{Log, Metadata, Record};
use shield_api::{metrics::Metrics, *};
use shield_runtime::plugin::{Kind, LoadedEnvironment, PluginError, Registry, Selection, host};

use crate::fixtures::{fixture, optimised_fixture, setup};

fn choice(id: &str) -> Selection {
    Selection::new(id).at(fixture("every-kind"))
}

fn line(config: &str) -> Result<LoadedEnvironment, PluginError> {
    Registry::default().environment(&choice("fixture/line"), config, &Setup::new(0, 1, host()))
}

#[test]
fn an_environment_steps_restores_its_state_and_has_named_starts() {
    // The loop of the runtime knows only the trait.
    let mut line: Box<dyn Environment> = Box::new(line("(scale: 0.5)").unwrap());
    let spec = line.spec();
    assert_eq!((spec.spaces.observation_len(), spec.episode_length, spec.brings_reset_reward), (2, 50, true));
    let mut observation = [f32::NAN; 2];
    line.reset(2, &mut observation).unwrap();
    assert_eq!(observation, [2.0, 0.5]);
    let outcome = line.step(&[1.0], &mut observation).unwrap();
    assert_eq!((observation[0], outcome.forward_reward, outcome.reset_reward), (2.5, 2.5, -2.5));
    assert!(outcome.success && !outcome.in_reset_set && !outcome.terminated && !outcome.irreversible);

    let mut bytes = Vec::new();
    line.save(&mut bytes).unwrap();
    line.step(&[1.0], &mut observation).unwrap();
    line.load(&bytes).unwrap();
    line.step(&[1.0], &mut observation).unwrap();
    assert_eq!(observation[0], 3.0);

    assert_eq!(line.starts(), ["left", "right"]);
    line.reset_to("left", 0, &mut observation).unwrap();
    assert_eq!(observation[0], -1.0);
    let error = line.reset_to("middle", 0, &mut observation).unwrap_err();
    assert_eq!(error.message(), "fixture/line: has no start named \"middle\"; its starts: left, right");
}

#[test]
fn the_kind_of_a_hard_reset_is_reported_and_an_unknown_one_is_an_error() {
    let mut line = line("").unwrap();
    let kinds: Vec<_> = line.reset_kinds().into_iter().map(|kind| (kind.name, kind.cost)).collect();
    assert_eq!(kinds, [("near".to_owned(), 0.5), ("far".to_owned(), 8.0)]);
    let mut observation = [0.0; 2];
    line.reset(1, &mut observation).unwrap();
    assert_eq!(line.reset_kind(), Ok(1));
    line.reset(2, &mut observation).unwrap();
    let error = line.reset_kind().unwrap_err();
    assert_eq!(error.message(), "fixture/line: `present` gave the kind 2 of a hard reset; there are 2");
    line.reset_to("left", 0, &mut observation).unwrap();
    assert_eq!(line.reset_kind().unwrap_err().message(), "fixture/line: lost");
}

#[test]
fn a_discrete_observation_is_one_hot_or_an_error() {
    let setup = Setup::new(0, 1, host());
    let mut cells = Registry::default().environment(&choice("fixture/cells"), "", &setup).unwrap();
    let mut observation = [0.0; 3];
    cells.reset(0, &mut observation).unwrap();
    assert!(cells.starts().is_empty());
    let outcome = cells.step(&[0.0], &mut observation).unwrap();
    assert!(outcome.terminated && outcome.irreversible);
    let error = cells.step(&[1.0], &mut observation).unwrap_err();
    assert_eq!(error.message(), "fixture/cells: `step` gave a discrete observation that is not one-hot");
}

#[test]
fn a_learner_acts_values_and_learns() {
    let mut agent: Box<dyn Learner> =
        Box::new(Registry::default().learner(&choice("fixture/agent"), "(scale: 2.0)", &setup()).unwrap());
    assert_eq!(agent.info(), LearnerInfo { members: 2, discount: 0.9 });
    let (mut action, mut values, mut gradients) = ([0.0], [0.0; 2], [0.0; 2]);
    agent.act(&[0.5, 0.0], ActMode::Greedy, &mut action).unwrap();
    assert_eq!(action, [0.5]);
    agent.act(&[0.5, 0.0], ActMode::Explore, &mut action).unwrap();
    assert_eq!(action, [0.25]);
    let batch = Batch {
        size: 2,
        observations: &[0.0; 4],
        actions: &[0.0; 2],
        rewards: &[1.0, 2.0],
        next_observations: &[0.0; 4],
        continuations: &[1.0; 2],
        masks: &[1.0; 4],
    };
    agent.update(&batch).unwrap();
    agent.q_gradients(&[0.5, 0.0], &[0.25], &mut values, &mut gradients).unwrap();
    // The seed 3 and the rewards 1 + 2 are its state.
    assert_eq!((values, gradients), ([6.5, 0.5], [0.0, 2.0]));
    let error = agent.update(&Batch { masks: &[1.0; 2], ..batch }).unwrap_err();
    assert_eq!(error.message(), "fixture/agent: masks has 2 values, expected 4");
}

#[test]
fn a_policy_a_rule_and_a_reset_task_answer() {
    let registry = Registry::default();
    let mut policy = registry.policy(&choice("fixture/follower"), "(scale: 2.0)", &setup()).unwrap();
    let mut action = [0.0];
    policy.act(&[0.25, 0.0], &mut action).unwrap();
    assert_eq!(action, [0.5]);

    let mut rule = registry.abort_rule(&choice("fixture/gentle"), "(scale: 0.5)", &setup()).unwrap();
    assert_eq!(rule.needs(), Needs { greedy_values: true, ..Needs::default() });
    let context = RuleContext {
        step: 0,
        observation: &[0.0, 0.0],
        proposed: &[0.5],
        previous: None,
        values: &[],
        greedy_values: &[1.0],
        forward_values: &[],
        discount: 0.9,
        phase: Phase::Forward,
        ..RuleContext::default()
    };
    let mut room = [0; 64];
    let judged = rule.evaluate(&context, &mut Reason::new(&mut room)).unwrap();
    assert_eq!(judged, RuleVerdict { verdict: Verdict::Allow, score: 0.5 });
    let moving = RuleContext { previous: Some(&[0.0]), ..context };
    let mut reason = Reason::new(&mut room);
    assert_eq!(rule.evaluate(&moving, &mut reason).unwrap().verdict, Verdict::Reject);
    let length = reason.len();
    assert_eq!(&room[..length], b"the action reaches 0.75");
    rule.observe(&ObservedDecision { step: 0, aborted: false, action: &[0.5] }).unwrap();
    let mut bytes = Vec::new();
    rule.save(&mut bytes).unwrap();
    assert_eq!(bytes, 3.5f32.to_le_bytes());

    let mut task = registry.reset_task(&choice("fixture/small"), "", &setup()).unwrap();
    task.observe_start(&[2.0, 0.0]).unwrap();
    let signal = task.evaluate(&[0.0, 0.0], &[0.0], &[2.5, 0.0]).unwrap();
    assert_eq!(signal, ResetSignal { reward: -0.5, in_reset_set: true });
}

#[test]
fn a_success_critic_estimates_and_learns_beside_the_other_kinds() {
    let mut odds =
        Registry::default().success_critic(&choice("fixture/odds"), "(scale: 0.5)", &setup()).unwrap();
    let (mut probabilities, mut gradients) = ([0.0; 2], [0.0; 2]);
    let batch = AttemptBatch {
        size: 2,
        observations: &[0.0; 4],
        actions: &[0.0; 2],
        next_observations: &[0.0; 4],
        next_actions: &[0.0; 2],
        successes: &[1.0, 0.0],
        continuations: &[0.0; 2],
        outcomes: &[1.0, 0.0],
        outcome_weights: &[1.0; 2],
        masks: &[1.0; 4],
    };
    odds.update(&batch).unwrap();
    odds.gradients(&[0.25, 0.0], &[0.5], &mut probabilities, &mut gradients).unwrap();
    assert_eq!((probabilities, gradients), ([0.75, 0.75], [0.5, 0.0]));
    let error = odds.update(&AttemptBatch { masks: &[1.0; 2], ..batch }).unwrap_err();
    assert_eq!(error.message(), "fixture/odds: masks has 2 values, expected 4");
}

/// What an environment, a learner and a policy of the library answer, and their states.
fn session(library: &Path) -> (Vec<f32>, Vec<u8>) {
    let choice = |id: &str| Selection::new(id).at(library);
    let registry = Registry::default();
    let mut line = registry.environment(&choice("fixture/line"), "(scale: 0.1)", &setup()).unwrap();
    let mut agent = registry.learner(&choice("fixture/agent"), "(scale: 0.3)", &setup()).unwrap();
    let mut policy = registry.policy(&choice("fixture/follower"), "(scale: 0.2)", &setup()).unwrap();
    let (mut observation, mut action, mut values, mut state) = ([0.0; 2], [0.0], [0.0; 2], Vec::new());
    line.reset(1, &mut observation).unwrap();
    let mut answers = Vec::new();
    for _ in 0..20 {
        policy.act(&observation, &mut action).unwrap();
        agent.q_values(&observation, &action, &mut values).unwrap();
        let before = observation;
        let outcome = line.step(&action, &mut observation).unwrap();
        let batch = Batch {
            size: 1,
            observations: &before,
            actions: &action,
            rewards: &[outcome.reset_reward],
            next_observations: &observation,
            continuations: &[1.0],
            masks: &[1.0; 2],
        };
        agent.update(&batch).unwrap();
        answers.extend([action[0], values[0], values[1], outcome.forward_reward]);
    }
    line.save(&mut state).unwrap();
    agent.save(&mut state).unwrap();
    (answers, state)
}

/// One of the two is built as this host is, the other one is not.
#[test]
fn an_optimised_library_and_an_unoptimised_one_answer_alike() {
    let answers = session(&fixture("every-kind"));
    assert!(
        answers.0.iter().all(|answer| answer.is_finite()) && answers.0[0] != answers.0[76],
        "{answers:?}"
    );
    assert_eq!(session(&optimised_fixture("every-kind")), answers);
}

#[test]
fn a_buffer_of_the_wrong_length_never_reaches_the_plugin() {
    let mut line = line("").unwrap();
    let error = line.reset(0, &mut [0.0; 1]).unwrap_err();
    assert_eq!(error, Error::invalid_argument("fixture/line: observation has 1 values, expected 2"));
    assert!(line.step(&[0.0, 0.0], &mut [0.0; 2]).unwrap_err().message().contains("action has 2 values"));
    let mut agent = Registry::default().learner(&choice("fixture/agent"), "", &setup()).unwrap();
    let (observation, action) = ([0.0; 2], [0.0]);
    assert!(
        agent.q_values(&observation, &action, &mut [0.0; 3]).unwrap_err().message().contains("values has 3")
    );
    let error = agent.q_gradients(&observation, &action, &mut [0.0; 2], &mut [0.0; 1]).unwrap_err();
    assert!(error.message().contains("gradients has 1 values, expected 2"), "{error}");
}

#[test]
fn a_fault_in_a_configuration_has_its_place_in_the_text() {
    let error = line("(\n  scale: 1.0,\n  scael: 2.0,\n)").unwrap_err();
    let (message, place) = error.config_fault().unwrap();
    assert!(message.contains("scael"), "{message}");
    assert_eq!(place.map(|place| place.line), Some(3));
    let error = line("(scale: 0.0)").unwrap_err();
    let place = Some(Position { line: 1, column: 9 });
    assert_eq!(error.config_fault(), Some(("scale is 0, but must be positive", place)));
}

#[test]
fn a_plugin_of_another_kind_or_file_is_refused_by_name() {
    let registry = Registry::default();
    let error = registry.learner(&choice("fixture/line"), "", &setup()).unwrap_err();
    assert!(matches!(error, PluginError::WrongKind { found: Kind::Environment, wanted: Kind::Learner, .. }));
    let error = registry.learner(&choice("fixture/elsewhere"), "", &setup()).unwrap_err();
    assert!(
        error.to_string().contains("holds no plugin \"fixture/elsewhere\"; it holds fixture/line"),
        "{error}"
    );
}

#[test]
fn a_policy_without_spaces_is_refused() {
    let setup = Setup::new(0, 1, host());
    let error = Registry::default().policy(&choice("fixture/follower"), "", &setup).unwrap_err();
    assert_eq!(error.to_string(), "fixture/follower: the host must give it the spaces of the environment");
}

struct Lines(Mutex<Vec<String>>);

impl Log for Lines {
    fn enabled(&self, _: &Metadata<'_>) -> bool {
        true
    }

    fn log(&self, record: &Record<'_>) {
        self.0.lock().unwrap().push(format!("{} {}: {}", record.level(), record.target(), record.args()));
    }

    fn flush(&self) {}
}

#[test]
fn log_lines_and_metrics_of_a_plugin_reach_the_host() {
    static LINES: Lines = Lines(Mutex::new(Vec::new()));
    log::set_logger(&LINES).unwrap();
    log::set_max_level(log::LevelFilter::Info);
    let mut line = line("").unwrap();
    line.reset(1, &mut [0.0; 2]).unwrap();
    assert!(LINES.0.lock().unwrap().contains(&"INFO plugin: the line begins anew".to_string()));
    let metrics = Metrics::default();
    for _ in 0..2 {
        metrics.collect(|| line.step(&[1.0], &mut [0.0; 2])).unwrap();
    }
    let mut figures = Vec::new();
    metrics.drain(&mut |name, mean| figures.push((name.to_string(), mean)));
    assert_eq!(figures, [("position".to_string(), 2.5)]);
}

#[test]
fn an_instance_may_move_to_another_thread() {
    let mut line = line("").unwrap();
    let moved = std::thread::spawn(move || line.reset(1, &mut [0.0; 2]));
    moved.join().unwrap().unwrap();
}
