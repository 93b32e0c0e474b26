//! On success the wrappers allocate nothing. Only the host's side is counted: a library has its own allocator.

use allocation_counter::measure;
use shield_api::{metrics::Metrics, *};
use shield_runtime::plugin::{Registry, Selection, host};

use crate::fixtures::{fixture, setup};

fn check_none(what: &str, mut call: impl FnMut()) {
    call();
    let count = measure(call).count_total;
    assert_eq!(count, 0, "{what} allocates");
}

#[test]
fn calls_allocate_nothing_after_the_first() {
    let registry = Registry::default();
    let choice = |id: &str| Selection::new(id).at(fixture("every-kind"));
    let (mut observation, mut action, mut values, mut gradients) = ([0.0; 2], [0.5], [0.0; 2], [0.0; 2]);

    let world = Setup::new(0, 1, host());
    let mut line = registry.environment(&choice("fixture/line"), "", &world).unwrap();
    check_none("reset", || line.reset(0, &mut observation).unwrap());
    check_none("reset_to", || line.reset_to("left", 0, &mut observation).unwrap());
    let metrics = Metrics::default();
    check_none("a step whose figures are collected", || {
        assert!(metrics.collect(|| line.step(&action, &mut observation)).is_ok());
    });
    check_none("drain", || metrics.drain(&mut |_, _| {}));

    let mut agent = registry.learner(&choice("fixture/agent"), "", &setup()).unwrap();
    check_none("act", || agent.act(&observation, ActMode::Explore, &mut action).unwrap());
    check_none("q_values", || agent.q_values(&observation, &action, &mut values).unwrap());
    check_none("q_gradients", || {
        agent.q_gradients(&observation, &action, &mut values, &mut gradients).unwrap();
    });
    let batch = Batch {
        size: 1,
        observations: &[0.0; 2],
        actions: &[0.0],
        rewards: &[1.0],
        next_observations: &[0.0; 2],
        continuations: &[1.0],
        masks: &[1.0; 2],
    };
    check_none("update", || agent.update(&batch).unwrap());

    let mut odds = registry.success_critic(&choice("fixture/odds"), "", &setup()).unwrap();
    check_none("probabilities", || odds.probabilities(&observation, &action, &mut values).unwrap());
    check_none("gradients", || {
        odds.gradients(&observation, &action, &mut values, &mut gradients).unwrap();
    });
    let attempts = AttemptBatch {
        size: 1,
        observations: &[0.0; 2],
        actions: &[0.0],
        next_observations: &[0.0; 2],
        next_actions: &[0.0],
        successes: &[1.0],
        continuations: &[0.0],
        outcomes: &[1.0],
        outcome_weights: &[1.0],
        masks: &[1.0; 2],
    };
    check_none("an update with attempts", || odds.update(&attempts).unwrap());

    let rule = registry.abort_rule(&choice("fixture/gentle"), "(scale: 0.1)", &setup()).unwrap();
    let context = RuleContext {
        step: 0,
        observation: &[0.0, 0.0],
        proposed: &[0.5],
        previous: None,
        values: &[],
        greedy_values: &[],
        forward_values: &[],
        discount: 0.9,
        phase: Phase::Forward,
        ..RuleContext::default()
    };
    let mut room = [0; 64];
    check_none("evaluate", || assert!(rule.evaluate(&context, &mut Reason::new(&mut room)).is_ok()));

    let spaces = Spaces { observation: Space::unbounded(1), action: Space::uniform(1, -1.0, 1.0) };
    let (choice, setup) =
        (Selection::new("fixture/undo-rule").at(fixture("undo")), Setup::with_spaces(0, 1, host(), spaces));
    let mut rule = registry.abort_rule(&choice, "", &setup).unwrap();
    let context = RuleContext {
        observation: &[0.0],
        proposed: &[0.5],
        probabilities: &[0.5],
        greedy_probabilities: &[0.5],
        start_probabilities: &[0.5],
        ..RuleContext::default()
    };
    check_none("evaluate with probabilities", || {
        assert!(rule.evaluate(&context, &mut Reason::new(&mut room)).is_ok());
    });
    let attempt = ObservedAttempt { step: 1, succeeded: true };
    check_none("observe_attempt", || rule.observe_attempt(&attempt).unwrap());
}
