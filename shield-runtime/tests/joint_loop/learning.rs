//! What the agents learn from: rewards, ends that are terminal, aborts, masks, and how often.

use shield_api::{AbortRule, Error, RuleVerdict};
use shield_runtime::experiment::{Endings, OnAbort, OnResetFailure, OnResetSuccess, Updates};

use crate::{
    common::{Rule, Scene, Scripted, forward_learner},
    no_pit,
};

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

    // The reset agent may have a number of its own.
    let mut scene = Scene::new(12);
    (scene.settings.cycle.updates, scene.settings.cycle.reset_updates_per_step) = (Updates::Both, Some(2));
    let forward = Scripted::acting(|_, _| 1.0);
    let (by_forward, by_reset) = (forward.seen.clone(), scene.reset.as_ref().unwrap().seen.clone());
    scene.forward = forward_learner(forward);
    scene.run();
    assert_eq!([by_forward, by_reset].map(|seen| seen.lock().unwrap().len()), [12, 24]);
}

#[test]
fn learning_follows_every_nth_step_only() {
    for (update_every, updates_per_step, expected) in [(1, 1, 12), (2, 1, 6), (4, 1, 3), (3, 2, 8)] {
        let mut scene = Scene::new(12);
        scene.settings.cycle.update_every = update_every;
        scene.settings.cycle.updates_per_step = updates_per_step;
        let forward = Scripted::acting(|_, _| 1.0);
        let (by_forward, by_reset) = (forward.seen.clone(), scene.reset.as_ref().unwrap().seen.clone());
        scene.forward = forward_learner(forward);
        scene.run();
        let updates = by_forward.lock().unwrap().len() + by_reset.lock().unwrap().len();
        assert_eq!(updates, expected, "every {update_every}");
    }
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
