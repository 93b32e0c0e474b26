//! Who is in charge when, and which resets a run costs.

use shield_runtime::{
    events::{AttemptOutcome, EpisodeEnd},
    experience::AgentRole,
    experiment::{BetweenAttempts, Mode, ResetTest, Updates},
    world::World,
};

use crate::{
    common::{EPISODE, Line, Notebook, Scene, Scripted, forward_learner},
    no_pit,
};

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
    let error = scene.run_with(&mut Notebook::default()).unwrap_err();
    assert!(error.to_string().contains("names the hard reset 1, but has 1 kinds"), "{error}");
}
