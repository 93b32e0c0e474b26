//! What the rules are told, and that nothing is executed which they did not allow.

use std::{
    collections::HashSet,
    sync::{Arc, Mutex},
    thread,
    time::Duration,
};

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use shield_api::{ActMode, Error, ErrorKind, Needs, Phase, RuleVerdict, Verdict};
use shield_runtime::{
    agent::ForwardAgent,
    experience::AgentRole,
    experiment::{Mode, ProjectionConfig, QpConfig},
};

use crate::{
    common::{Notebook, Rule, Scene, Scripted, forward_learner, spaces},
    no_pit,
};

#[test]
fn rules_see_the_phase_and_the_forward_values_of_exploration() {
    type Seen = (Phase, f32, Vec<f32>);
    let told: Arc<Mutex<Vec<Seen>>> = Arc::default();
    let book = told.clone();
    let mut rule = Rule {
        needs: Needs { forward_values: true, ..Needs::default() },
        judge: Box::new(move |context| {
            book.lock().unwrap().push((context.phase, context.proposed[0], context.forward_values.to_vec()));
            Ok(RuleVerdict::from_safe(true, 1.0))
        }),
    };
    rule.needs.values = true;
    let mut scene = Scene::new(24);
    scene.rules = vec![Box::new(rule)];
    scene.settings.cycle.shield_exploration = true;
    scene.forward = forward_learner(Scripted::acting(|_, _| 1.0).valuing(1, |_, action| vec![10.0 * action]));
    scene.run();
    let told = told.lock().unwrap();
    for (phase, action) in [(Phase::Forward, 1.0), (Phase::Reset, -1.0)] {
        let rows: Vec<_> = told.iter().filter(|row| row.0 == phase).collect();
        assert!(!rows.is_empty() && rows.iter().all(|row| (row.1, row.2[0]) == (action, 10.0 * action)));
    }
}

#[test]
fn the_warm_up_aborts_nothing() {
    let mut scene = Scene::new(24);
    scene.rules = vec![Rule::below(5.0)];
    scene.warm_up_steps = 12;
    scene.settings.cycle.reset_attempts = Some(1);
    let (counters, notebook) = scene.run();
    assert_eq!(counters.warm_up_decisions, 6);
    assert!(notebook.interventions.iter().all(|intervention| intervention.0 >= 12));
    assert_eq!(counters.early_aborts, 12, "afterwards every step is aborted and undone by one reset step");
}

#[test]
fn shielded_exploration_falls_back_to_the_greedy_action() {
    let run = |is_shielded| {
        let mut scene = Scene::new(12);
        scene.rules = no_pit();
        scene.settings.cycle.shield_exploration = is_shielded;
        scene.forward = forward_learner(Scripted::acting(|_, _| 1.0));
        // Explores towards the pit; would greedily go back.
        scene.reset = Some(Scripted::acting(|_, mode| if mode == ActMode::Explore { 1.0 } else { -1.0 }));
        scene.run()
    };
    let (counters, _) = run(false);
    assert_eq!((counters.irreversible_entries, counters.exploration_replaced), (1, 0));
    let (counters, notebook) = run(true);
    assert_eq!(counters.irreversible_entries, 0);
    assert!(counters.exploration_replaced > 0);
    let replaced = notebook.interventions.iter().find(|intervention| intervention.2.is_some()).unwrap();
    assert_eq!((replaced.1, replaced.2), (1.0, Some(-1.0)));
}

#[test]
fn a_failing_forward_agent_causes_aborts_that_are_counted() {
    let mut scene = Scene::new(30);
    let policy = Scripted::acting(|cell, _| if cell < 2.0 { 1.0 } else { f32::NEG_INFINITY });
    scene.forward = Some(ForwardAgent::Policy(Box::new(policy)));
    let log = scene.line.log.clone();
    let (counters, notebook) = scene.run();
    assert!(log.lock().unwrap().iter().all(|(_, action)| action.is_finite()));
    assert_eq!(counters.failed_closed, counters.early_aborts);
    let (_, _, _, cause, reason) = &notebook.interventions[0];
    assert_eq!((cause.as_str(), reason.as_str()), ("forward_failed", "no action today"));
}

/// Each way in which a decision can fail, in a loop: counted by its cause, reported, and nothing of it executed.
#[test]
fn every_failure_aborts_and_is_counted_by_its_cause() {
    let says = |value: f32| {
        Some(Scripted::acting(|_, _| -1.0).valuing(2, move |_, action| match action {
            1.0 => vec![1.0, value],
            _ => vec![1.0, 1.0],
        }))
    };
    let proposes = |action: f32| forward_learner(Scripted::acting(move |_, _| action));
    let qp = || Some(ProjectionConfig::Qp(QpConfig::default()));
    let mut table: Vec<(&str, Scene)> = Vec::new();
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        table.push(("values_failed", Scene { reset: says(bad), ..Scene::new(40) }));
        let scored = Rule::judging(move |_| Ok(RuleVerdict { verdict: Verdict::Reject, score: bad }));
        let expected = if bad.is_nan() { "rule_failed" } else { "rejected" };
        table.push((expected, Scene { rules: vec![scored], ..Scene::new(40) }));
    }
    for action in [f32::NAN, f32::INFINITY, 1.5, -1.5] {
        table.push(("invalid_action", Scene { forward: proposes(action), ..Scene::new(40) }));
    }
    table.push(("forward_failed", Scene { forward: proposes(f32::NEG_INFINITY), ..Scene::new(40) }));
    let failing = Rule::judging(|_| Err(Error::failed("not today")));
    table.push(("rule_failed", Scene { rules: vec![failing], ..Scene::new(40) }));
    let strict = || vec![Rule::below(2.0)];
    table.push(("gradients_failed", Scene { rules: strict(), projection: qp(), ..Scene::new(40) }));
    let replace = Some(ProjectionConfig::Replace);
    table.push(("still_rejected", Scene { rules: strict(), projection: replace, ..Scene::new(40) }));
    let slow = Rule::judging(|_| {
        thread::sleep(Duration::from_millis(2));
        Ok(RuleVerdict::from_safe(true, 1.0))
    });
    let deadline = Some(Duration::from_micros(100));
    table.push(("deadline", Scene { rules: vec![slow], deadline, ..Scene::new(40) }));
    for (cause, scene) in table {
        let log = scene.line.log.clone();
        let (counters, notebook) = scene.run();
        assert!(counters.early_aborts > 0 && counters.forward_steps == 0, "{cause}");
        let is_failure = !["rejected", "still_rejected"].contains(&cause);
        assert_eq!(counters.failed_closed, if is_failure { counters.early_aborts } else { 0 }, "{cause}");
        assert_eq!(notebook.interventions.len() as u64, counters.early_aborts, "{cause}");
        for (_, _, executed, found, reason) in &notebook.interventions {
            assert_eq!((found.as_str(), *executed), (cause, None));
            assert!(!reason.is_empty(), "{cause} is not explained");
        }
        assert!(log.lock().unwrap().iter().all(|(_, action)| *action == -1.0), "{cause}");
    }
}

#[test]
fn a_panicked_rule_ends_the_run_and_its_action_is_not_executed() {
    let mut scene = Scene::new(100);
    scene.rules = vec![Rule::judging(|context| match context.step {
        0..4 => Ok(RuleVerdict::from_safe(true, 1.0)),
        _ => Err(Error::new(ErrorKind::Panicked, "index out of bounds")),
    })];
    let log = scene.line.log.clone();
    let mut notebook = Notebook::default();
    let error = scene.run_with(&mut notebook).unwrap_err();
    assert!(error.to_string().contains("index out of bounds"), "{error}");
    assert_eq!((log.lock().unwrap().len(), notebook.interventions.len()), (4, 1));
}

#[test]
fn an_action_outside_the_space_is_not_executed_in_any_mode() {
    for mode in [Mode::StatusQuo, Mode::ForwardOnly, Mode::ResetOnly { start: None }] {
        let mut scene = Scene::new(100);
        scene.settings.cycle.mode = mode;
        scene.forward = forward_learner(Scripted::acting(|_, _| 1.5));
        scene.reset = Some(Scripted::acting(|_, _| 1.5));
        let log = scene.line.log.clone();
        assert!(scene.run_with(&mut Notebook::default()).is_err());
        assert!(log.lock().unwrap().is_empty());
    }
}

/// A million steps with a policy that proposes anything, NaN included, and rules that reject at random: in forward
/// phases the world receives only what the rules allowed at that very state.
#[test]
fn no_unapproved_action_reaches_the_environment() {
    let approved: Arc<Mutex<HashSet<(u64, u32, u32)>>> = Arc::default();
    let mut scene = Scene::new(1_000_000);
    let mut rng = Pcg64::seed_from_u64(11);
    scene.forward =
        Some(ForwardAgent::Policy(Box::new(Scripted::acting(move |_, _| match rng.random_range(0..20) {
            0 => f32::NAN,
            1 => f32::INFINITY,
            2 => 1.0 + f32::EPSILON,
            3 => f32::NEG_INFINITY,
            _ => rng.random_range(-1.0..=1.0),
        }))));
    let (book, coin) = (approved.clone(), Mutex::new(Pcg64::seed_from_u64(12)));
    scene.rules = vec![
        Rule::judging(move |context| {
            let draw = coin.lock().unwrap().random_range(0..10);
            match draw {
                0 => return Err(Error::failed("broken")),
                1 => return Ok(RuleVerdict::from_safe(true, f32::NAN)),
                2 | 3 => return Ok(RuleVerdict::from_safe(false, 0.0)),
                _ => {}
            }
            let key = (context.step, context.observation[0].to_bits(), context.proposed[0].to_bits());
            book.lock().unwrap().insert(key);
            Ok(RuleVerdict::from_safe(true, 1.0))
        }),
        Rule::judging(|context| Ok(RuleVerdict::from_safe(context.proposed[0] < 0.9, 0.0))),
    ];
    let log = scene.line.log.clone();
    scene.settings.cycle.updates_per_step = 0;
    let (counters, notebook) = scene.run();
    assert_eq!(counters.steps, 1_000_000);

    let approved = approved.lock().unwrap();
    let log = log.lock().unwrap();
    let mut step = 0_usize;
    let mut checked = 0_u64;
    for episode in &notebook.episodes {
        for index in step..step + episode.length as usize {
            let (cell, action) = log[index];
            if episode.role == AgentRole::Forward {
                let key = (index as u64, (cell as f32).to_bits(), action.to_bits());
                assert!(
                    approved.contains(&key) && action < 0.9,
                    "step {index}: {action} at {cell} was not allowed"
                );
                checked += 1;
            }
        }
        step += episode.length as usize;
    }
    assert_eq!((step, checked), (1_000_000, counters.forward_steps));
    assert!(checked > 100_000, "only {checked} forward steps were checked");
    assert!(counters.failed_closed > 10_000 && spaces().action.check_action(&[0.5]).is_ok());
}
