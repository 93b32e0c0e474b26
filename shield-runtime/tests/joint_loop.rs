//! The joint loop, field by field: each setting changes what a scripted run does.

#![allow(clippy::unwrap_used, reason = "tests")]

mod common;

use std::sync::Mutex;

use common::{EPISODE, Line, PIT, Rule, Scene, Scripted, forward_learner, spaces};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use shield_api::{
    AbortRule, ActMode, Checkpoint, Error, ErrorKind, Needs, ObservedDecision, Phase, Reason, Result,
    RuleContext, RuleVerdict, Verdict,
};
use shield_runtime::{
    agent::ForwardAgent,
    cycle::Evaluated,
    evaluation::Evaluator,
    events::{AttemptOutcome, Counters, EpisodeEnd, EvaluationEvent, EvaluationFigures},
    experience::AgentRole,
    experiment::{
        BetweenAttempts, Endings, EvaluatedAgent, Mode, OnAbort, OnResetFailure, OnResetSuccess,
        ProjectionConfig, QpConfig, ResetTest, Updates,
    },
    lanes::Lanes,
    world::World,
};

/// Rejects actions that lead into the pit.
fn no_pit() -> Vec<Box<dyn shield_api::AbortRule>> {
    vec![Rule::judging(|context| {
        let falls = context.observation[0] >= (PIT - 1) as f32 && context.proposed[0] > 0.0;
        Ok(RuleVerdict::from_safe(!falls, context.observation[0]))
    })]
}

#[test]
fn an_abort_hands_over_to_the_reset_agent_and_the_rejected_action_is_never_executed() {
    let mut scene = Scene::new(12);
    scene.rules = no_pit();
    let log = scene.line.log.clone();
    let (counters, notebook) = scene.run();
    let cells: Vec<i32> = log.lock().unwrap().iter().map(|(cell, _)| *cell).collect();
    assert_eq!(cells, [0, 1, 2, 3, 2, 1, 0, 1, 2, 3, 2, 1]);
    assert_eq!((counters.early_aborts, counters.hard_resets, counters.irreversible_entries), (2, 0, 0));
    assert_eq!((counters.forward_steps, counters.forward_episodes, counters.reset_episodes), (6, 2, 2));
    let ends: Vec<_> = notebook.episodes.iter().map(|episode| (episode.role, episode.end)).collect();
    let turn = [(AgentRole::Forward, EpisodeEnd::Abort), (AgentRole::Reset, EpisodeEnd::ResetSet)];
    assert_eq!(ends, [turn, turn].concat());
    let (step, proposed, executed, cause, reason) = &notebook.interventions[0];
    assert_eq!((*step, *proposed, *executed, cause.as_str()), (3, 1.0, None, "rejected"));
    assert_eq!(reason, "the rule compared 3");
}

#[test]
fn the_pit_costs_one_hard_reset_after_n_failed_attempts() {
    // A cycle: 6 forward steps into the pit, then attempts of 6 steps each with forward episodes between them.
    for (attempts, expected) in [(Some(1), 10), (Some(2), 5), (Some(5), 2), (None, 0)] {
        let mut scene = Scene::new(120);
        scene.settings.cycle.reset_attempts = attempts;
        let (counters, _) = scene.run();
        assert_eq!(counters.hard_resets, expected, "{attempts:?} attempts");
        assert_eq!(counters.irreversible_entries, expected.max(1));
    }
}

#[test]
fn a_forward_episode_lies_between_attempts_if_configured() {
    for (between, forward_episodes) in [(BetweenAttempts::Forward, 3), (BetweenAttempts::Reset, 1)] {
        let mut scene = Scene::new(if between == BetweenAttempts::Forward { 36 } else { 24 });
        scene.settings.cycle.reset_attempts = Some(3);
        scene.settings.cycle.between_attempts = between;
        let (counters, notebook) = scene.run();
        assert_eq!((counters.hard_resets, counters.reset_episodes), (1, 3), "{between:?}");
        assert_eq!(counters.forward_episodes, forward_episodes);
        assert!(notebook.episodes.last().unwrap().hard_reset.is_some());
    }
}

#[test]
fn an_attempt_succeeds_by_any_visited_state_or_by_its_final_one() {
    // The reset agent passes cell 0 and walks away again.
    for (test, hard_resets) in [(ResetTest::AnyVisited, 0), (ResetTest::FinalState, 1)] {
        let mut scene = Scene::new(2 * EPISODE as u64);
        scene.forward = forward_learner(Scripted::acting(|cell, _| if cell < 2.0 { 1.0 } else { -1.0 }));
        let mut steps = 0;
        scene.reset = Some(Scripted::acting(move |_, _| {
            steps += 1;
            if steps <= 3 { -1.0 } else { 1.0 }
        }));
        scene.settings.cycle.stop_on_reset = false;
        scene.settings.cycle.reset_test = test;
        let (counters, notebook) = scene.run();
        assert_eq!(counters.hard_resets, hard_resets, "{test:?}");
        let [forward, attempt] = &notebook.episodes[..] else { panic!("{:?}", notebook.episodes) };
        assert_eq!(attempt.length, EPISODE as u64);
        let outcome = if hard_resets == 0 { AttemptOutcome::Succeeded } else { AttemptOutcome::Failed };
        assert_eq!((forward.attempt, attempt.attempt), (None, Some(outcome)), "{test:?}");
    }
}

#[test]
fn stop_on_reset_ends_the_attempt_at_the_reset_set() {
    for (stop, length) in [(true, 2), (false, EPISODE as u64)] {
        let mut scene = Scene::new(2 * EPISODE as u64);
        scene.forward = forward_learner(Scripted::acting(|cell, _| if cell < 2.0 { 1.0 } else { -1.0 }));
        scene.settings.cycle.stop_on_reset = stop;
        let (_, notebook) = scene.run();
        assert_eq!((notebook.episodes[0].length, notebook.episodes[1].length), (6, length));
    }
}

#[test]
fn each_mode_makes_its_own_resets() {
    let run = |mode: Mode| {
        let mut scene = Scene::new(60);
        scene.settings.cycle.mode = mode;
        let resets = scene.line.resets.clone();
        let (counters, notebook) = scene.run();
        (counters, notebook, resets.lock().unwrap().clone())
    };
    let (counters, _, resets) = run(Mode::StatusQuo);
    assert_eq!((counters.hard_resets, counters.forward_episodes, counters.reset_episodes), (10, 10, 0));
    assert_eq!((resets.len(), counters.forward_steps), (11, 60));

    let (counters, _, resets) = run(Mode::ForwardOnly);
    assert_eq!((counters.hard_resets, counters.forward_episodes, resets.len()), (0, 10, 1));
    assert_eq!(counters.irreversible_entries, 1);

    let (counters, notebook, resets) = run(Mode::ResetOnly { start: Some("far".into()) });
    assert_eq!((counters.forward_steps, counters.hard_resets, counters.reset_episodes), (0, 20, 20));
    assert!(resets.iter().all(|start| start.as_deref() == Some("far")));
    assert!(notebook.episodes.iter().all(|episode| episode.has_reset && episode.length == 3));
}

#[test]
fn a_terminated_environment_is_reset_at_once_and_the_end_is_terminal_for_both() {
    let mut scene = Scene::new(20);
    scene.line.terminates_at = Some(2);
    scene.settings.cycle.updates = Updates::Both;
    let forward = Scripted::acting(|_, _| 1.0);
    let (seen, seen_by_reset) = (forward.seen.clone(), scene.reset.as_ref().unwrap().seen.clone());
    scene.forward = forward_learner(forward);
    let (counters, notebook) = scene.run();
    assert_eq!((counters.hard_resets, counters.reset_episodes), (10, 0));
    assert!(
        notebook
            .episodes
            .iter()
            .all(|episode| episode.end == EpisodeEnd::Terminated && episode.hard_reset.is_some())
    );
    assert!(notebook.episodes.iter().all(|episode| episode.attempt == Some(AttemptOutcome::Failed)));
    for seen in [seen, seen_by_reset] {
        let continuations: Vec<f32> = seen.lock().unwrap().iter().map(|row| row.1).collect();
        assert_eq!(continuations, [1.0, 0.0].repeat(10));
    }
}

/// Continuation flags that the reset agent saw in one forward and one reset episode, with `Updates::Both`.
fn reset_continuations(endings: Endings, falls: bool) -> Vec<f32> {
    let mut scene = Scene::new(if falls { 12 } else { 8 });
    scene.settings.cycle.updates = Updates::Both;
    scene.settings.cycle.endings = endings;
    let target = if falls { 9.0 } else { 2.0 };
    scene.forward = forward_learner(Scripted::acting(move |cell, _| if cell < target { 1.0 } else { -1.0 }));
    let seen = scene.reset.as_ref().unwrap().seen.clone();
    let (counters, _) = scene.run();
    assert_eq!(counters.reset_episodes, 1);
    let seen = seen.lock().unwrap();
    seen.iter().map(|row| row.1).collect()
}

#[test]
fn reaching_the_reset_set_is_terminal_or_bootstraps_as_configured() {
    let endings = |on_success| Endings { on_success, ..Endings::default() };
    // Forward: 1 2 1 2 1 2; reset: 1 0.
    assert_eq!(reset_continuations(endings(OnResetSuccess::Bootstrap), false), [1.0; 8]);
    let mut expected = [1.0; 8];
    expected[7] = 0.0;
    assert_eq!(reset_continuations(endings(OnResetSuccess::Terminal), false), expected);
}

#[test]
fn the_last_step_of_a_failed_attempt_is_terminal_or_bootstraps_as_configured() {
    let endings = |on_failure| Endings { on_failure, ..Endings::default() };
    assert_eq!(reset_continuations(endings(OnResetFailure::Bootstrap), true), [1.0; 12]);
    let mut expected = [1.0; 12];
    expected[11] = 0.0;
    assert_eq!(reset_continuations(endings(OnResetFailure::Zero), true), expected);
    // A reset episode that succeeds is not a failed one.
    assert_eq!(reset_continuations(endings(OnResetFailure::Zero), false), [1.0; 8]);
}

#[test]
fn forward_time_outs_and_aborts_bootstrap() {
    let mut scene = Scene::new(60);
    scene.rules = no_pit();
    let forward = Scripted::acting(|_, _| 1.0);
    let seen = forward.seen.clone();
    scene.forward = forward_learner(forward);
    scene.run();
    assert!(seen.lock().unwrap().iter().all(|row| row.1 == 1.0));
}

/// Rewards and continuations that the forward agent saw, one row per update.
fn told_of_aborts(on_abort: OnAbort, rules: Vec<Box<dyn AbortRule>>) -> (Vec<(f32, f32)>, usize) {
    let mut scene = Scene::new(60);
    scene.rules = rules;
    scene.settings.cycle.on_abort = on_abort;
    scene.settings.cycle.updates = Updates::Both;
    scene.capacity = 100;
    let forward = Scripted::acting(|_, _| 1.0);
    let (seen, by_reset) = (forward.seen.clone(), scene.reset.as_ref().unwrap().seen.clone());
    scene.forward = forward_learner(forward);
    let (counters, _) = scene.run();
    assert!(counters.early_aborts > 5);
    assert!(by_reset.lock().unwrap().iter().all(|row| row.0 >= 0.0), "the reset agent learns from it");
    let seen = seen.lock().unwrap();
    (seen.iter().map(|row| (row.0, row.1)).collect(), seen.len())
}

#[test]
fn the_forward_agent_learns_of_an_abort_as_configured() {
    let told = |on_abort| told_of_aborts(on_abort, no_pit()).0;
    assert!(told(OnAbort::Nothing).iter().all(|row| row.0 >= 0.0 && row.1 == 1.0));
    assert!(told(OnAbort::Truncate).contains(&(0.0, 0.0)));
    let told = told(OnAbort::Penalise(2.5));
    assert!(told.contains(&(-2.5, 0.0)) && told.contains(&(1.0, 1.0)), "{told:?}");
}

#[test]
fn a_failing_rule_does_not_penalise_the_forward_agent() {
    let failing = || {
        vec![Rule::judging(|context| {
            let is_near = context.observation[0] >= 3.0;
            if is_near { Err(Error::failed("not here")) } else { Ok(RuleVerdict::from_safe(true, 1.0)) }
        })]
    };
    let (rows, _) = told_of_aborts(OnAbort::Penalise(2.5), failing());
    assert!(rows.iter().all(|row| row.0 >= 0.0));
}

#[test]
fn each_kind_of_hard_reset_has_its_cost_and_is_learned_from() {
    let mut scene = Scene::new(60);
    scene.line.kinds = vec![("line", 2.0), ("pit", 10.0)];
    scene.settings.cycle.hard_reset_cost = 3.0;
    scene.settings.cycle.cost_weight = 0.5;
    scene.capacity = 100;
    let seen = scene.reset.as_ref().unwrap().seen.clone();
    let (counters, notebook) = scene.run();
    let resets: Vec<_> = notebook.episodes.iter().filter_map(|episode| episode.hard_reset).collect();
    assert!(!resets.is_empty() && resets.len() as u64 == counters.hard_resets);
    assert!(resets.iter().all(|reset| (reset.kind, reset.cost) == (Some(1), 30.0)), "{resets:?}");
    assert_eq!(counters.hard_reset_cost, 30.0 * resets.len() as f64);
    assert!(seen.lock().unwrap().iter().any(|row| row.0 == -15.0), "the cost is not learned from");

    let mut alike = Scene::new(60);
    alike.settings.cycle.hard_reset_cost = 3.0;
    let (counters, notebook) = alike.run();
    assert_eq!(counters.hard_reset_cost, 3.0 * counters.hard_resets as f64);
    assert!(
        notebook.episodes.iter().filter_map(|episode| episode.hard_reset).all(|reset| reset.kind.is_none())
    );
}

#[test]
fn invalid_kinds_of_hard_resets_are_refused() {
    for kinds in [vec![("a", f64::NAN)], vec![("a", -1.0)], vec![("a", 1.0), ("a", 2.0)]] {
        let mut line = Line::new();
        line.kinds = kinds;
        assert!(World::new(Box::new(line), None).is_err());
    }
    let mut scene = Scene::new(60);
    scene.line.kinds = vec![("only", 1.0)];
    let error = scene.run_with(&mut common::Notebook::default()).unwrap_err();
    assert!(error.to_string().contains("names the hard reset 1, but has 1 kinds"), "{error}");
}

#[test]
fn rules_see_the_phase_and_the_forward_values_of_exploration() {
    use std::sync::{Arc, Mutex};
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
fn the_agent_in_charge_or_both_learn_each_from_its_own_reward() {
    for (updates, forward_updates, reset_updates) in [(Updates::Active, 6, 6), (Updates::Both, 12, 12)] {
        let mut scene = Scene::new(12);
        scene.settings.cycle.updates = updates;
        let forward = Scripted::acting(|_, _| 1.0);
        let (by_forward, by_reset) = (forward.seen.clone(), scene.reset.as_ref().unwrap().seen.clone());
        scene.forward = forward_learner(forward);
        scene.run();
        assert_eq!(by_forward.lock().unwrap().len(), forward_updates, "{updates:?}");
        assert_eq!(by_reset.lock().unwrap().len(), reset_updates, "{updates:?}");
        let rewards: Vec<f32> = by_forward.lock().unwrap()[..6].iter().map(|row| row.0).collect();
        assert_eq!(rewards, [1.0, 2.0, 3.0, 4.0, 4.0, 4.0]);
        assert!(by_reset.lock().unwrap().iter().all(|row| row.0 == 0.0), "no step reached cell 0");
    }
}

#[test]
fn each_step_makes_the_configured_number_of_updates() {
    let mut scene = Scene::new(12);
    scene.settings.cycle.updates_per_step = 3;
    let seen = scene.reset.as_ref().unwrap().seen.clone();
    scene.run();
    assert_eq!(seen.lock().unwrap().len(), 18);
}

#[test]
fn bootstrap_masks_reach_the_learner() {
    let masks = |probability| {
        let mut scene = Scene::new(400);
        scene.bootstrap_probability = probability;
        let reset = Scripted::acting(|_, _| -1.0).valuing(4, |_, _| vec![1.0; 4]);
        let seen = reset.seen.clone();
        scene.reset = Some(reset);
        scene.run();
        let seen = seen.lock().unwrap();
        seen.iter().map(|row| row.2).sum::<f32>() / seen.len() as f32
    };
    assert_eq!(masks(1.0), 4.0);
    let half = masks(0.5);
    assert!((1.5..2.5).contains(&half), "{half} of 4 members learn at probability 0.5");
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
        std::thread::sleep(std::time::Duration::from_millis(2));
        Ok(RuleVerdict::from_safe(true, 1.0))
    });
    let deadline = Some(std::time::Duration::from_micros(100));
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
fn an_evaluation_uses_its_own_instance_and_counts_separately() {
    let evaluated = Line::new();
    let log = evaluated.log.clone();
    let evaluator = |line, shield, agent, start: Option<&str>| {
        let world = World::new(Box::new(line), None).unwrap();
        Evaluator::new(Lanes::new(vec![world], 1).unwrap(), shield, agent, start.map(str::to_string), 2, 7)
            .unwrap()
    };
    let mut scene = Scene::new(25);
    scene.settings.evaluate_every = Some(10);
    scene.evaluator = Some(evaluator(evaluated, None, EvaluatedAgent::Forward, None));
    let (counters, notebook) = scene.run();
    assert_eq!(counters.steps, 25);
    let steps: Vec<u64> = notebook.evaluations.iter().map(|evaluation| evaluation.step).collect();
    assert_eq!(steps, [10, 20, 25], "at each interval and at the end");
    assert_eq!(notebook.evaluations[0].figures, RIGHT);
    assert_eq!(notebook.evaluations[0].without_shield, None);
    assert_eq!(log.lock().unwrap().len() as u64, 3 * RIGHT.steps);

    let mut scene = Scene::new(10);
    scene.settings.evaluate_every = Some(10);
    scene.evaluator = Some(evaluator(Line::new(), None, EvaluatedAgent::Reset, Some("far")));
    let (_, notebook) = scene.run();
    assert_eq!(notebook.evaluations[0].figures.success_rate, 1.0);
}

/// Two episodes of going right all the time: into the pit.
const RIGHT: EvaluationFigures = EvaluationFigures {
    mean_return: 18.0,
    success_rate: 1.0,
    irreversible_entries: 2,
    steps: 2 * EPISODE as u64,
};

/// A run of 25 steps with evaluations after 10 and 20 and at the end, behind a shield with these rules, in some worlds.
fn evaluated_behind(
    rules: fn() -> Vec<Box<dyn AbortRule>>,
    worlds: usize,
) -> (Counters, Vec<EvaluationEvent>) {
    let mut scene = Scene::new(25);
    scene.rules = rules();
    scene.settings.evaluate_every = Some(10);
    let shield = common::shield(rules(), scene.reset.as_ref().unwrap(), 0);
    let world = || World::new(Box::new(Line::new()), None).unwrap();
    let batch = Lanes::new((0..worlds).map(|_| world()).collect(), 1).unwrap();
    let evaluator = Evaluator::new(batch, Some(shield), EvaluatedAgent::Forward, None, 2, 7);
    scene.evaluator = Some(evaluator.unwrap());
    let (counters, notebook) = scene.run();
    (counters, notebook.evaluations)
}

#[test]
fn a_shielded_agent_is_evaluated_with_its_shield_and_without() {
    for worlds in [1, 2, 4] {
        let (_, evaluations) = evaluated_behind(no_pit, worlds);
        for EvaluationEvent { figures, without_shield, .. } in evaluations {
            // At the edge the rejected action gives way to the reset agent's: one back, one forth.
            let deployed = EvaluationFigures { mean_return: 13.0, irreversible_entries: 0, ..RIGHT };
            assert_eq!((figures, without_shield), (deployed, Some(RIGHT)), "{worlds} worlds");
        }
    }
}

#[test]
fn a_shield_that_rejects_nothing_changes_no_evaluation() {
    let (_, evaluations) = evaluated_behind(|| vec![Rule::below(0.5)], 1);
    assert_eq!(evaluations.len(), 3);
    for EvaluationEvent { figures, without_shield, .. } in evaluations {
        assert_eq!((figures, without_shield), (RIGHT, Some(RIGHT)));
    }
}

/// Rejects everything from its fourth decision on.
#[derive(Default)]
struct Tiring(u8);

impl Checkpoint for Tiring {
    fn save(&self, bytes: &mut Vec<u8>) -> Result<()> {
        bytes.push(self.0);
        Ok(())
    }

    fn load(&mut self, bytes: &[u8]) -> Result<()> {
        self.0 = bytes[0];
        Ok(())
    }
}

impl AbortRule for Tiring {
    fn needs(&self) -> Needs {
        Needs::default()
    }

    fn evaluate(&self, _: &RuleContext<'_>, _: &mut Reason<'_>) -> Result<RuleVerdict> {
        Ok(RuleVerdict::from_safe(self.0 < 3, f32::from(self.0)))
    }

    fn observe(&mut self, _: &ObservedDecision<'_>) -> Result<()> {
        self.0 = self.0.saturating_add(1);
        Ok(())
    }
}

#[test]
fn an_evaluation_begins_with_what_the_rules_have_come_to_in_training_and_leaves_that_alone() {
    let (counters, evaluations) = evaluated_behind(|| vec![Box::<Tiring>::default()], 1);
    assert_eq!(counters.forward_steps, 3);
    for EvaluationEvent { figures, without_shield, .. } in evaluations {
        assert_eq!((figures.mean_return, without_shield), (0.0, Some(RIGHT)), "the reset agent stays at 0");
    }
}

#[test]
fn the_clock_of_the_shield_goes_on_within_an_evaluation() {
    static STEPS: Mutex<Vec<u64>> = Mutex::new(Vec::new());
    let watching = || -> Vec<Box<dyn AbortRule>> {
        vec![Rule::judging(|context| {
            STEPS.lock().unwrap().push(context.step);
            Ok(RuleVerdict::from_safe(true, 1.0))
        })]
    };
    evaluated_behind(watching, 1);
    let steps = STEPS.lock().unwrap();
    let first = steps.windows(2).position(|pair| pair == [10, 11]).unwrap();
    let evaluated: Vec<u64> = (10..10 + RIGHT.steps).collect();
    assert_eq!(steps[first..first + evaluated.len()], evaluated);
}

#[test]
fn an_evaluation_does_not_depend_on_how_many_episodes_run_at_once() {
    let evaluate = |worlds: usize, threads: usize| {
        let world = || World::new(Box::new(Line::new()), None).unwrap();
        let batch = Lanes::new((0..worlds).map(|_| world()).collect(), threads).unwrap();
        let mut evaluator = Evaluator::new(batch, None, EvaluatedAgent::Forward, None, 7, 3).unwrap();
        let mut policy = ForwardAgent::Policy(Box::new(Scripted::acting(|_, _| 1.0)));
        [10, 20].map(|step| {
            let agents = Evaluated { forward: Some(&mut policy), ..Evaluated::default() };
            evaluator.run(step, agents).unwrap()
        })
    };
    let alone = evaluate(1, 1);
    let figures = alone[0].figures;
    assert!(figures.steps == 7 * EPISODE as u64 && figures.irreversible_entries == 7, "{alone:?}");
    for (worlds, threads) in [(7, 1), (3, 2), (4, 3), (8, 8)] {
        assert_eq!(evaluate(worlds, threads), alone, "{worlds} worlds, {threads} threads");
    }
    assert!(Evaluator::new(Lanes::new(vec![], 1).unwrap(), None, EvaluatedAgent::Reset, None, 1, 0).is_err());
}

#[test]
fn a_panicked_rule_ends_the_run_and_its_action_is_not_executed() {
    let mut scene = Scene::new(100);
    scene.rules = vec![Rule::judging(|context| match context.step {
        0..4 => Ok(RuleVerdict::from_safe(true, 1.0)),
        _ => Err(Error::new(ErrorKind::Panicked, "index out of bounds")),
    })];
    let log = scene.line.log.clone();
    let mut notebook = common::Notebook::default();
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
        assert!(scene.run_with(&mut common::Notebook::default()).is_err());
        assert!(log.lock().unwrap().is_empty());
    }
}

/// A million steps with a policy that proposes anything, NaN included, and rules that reject at random: in forward
/// phases the world receives only what the rules allowed at that very state.
#[test]
fn no_unapproved_action_reaches_the_environment() {
    use std::{
        collections::HashSet,
        sync::{Arc, Mutex},
    };

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
