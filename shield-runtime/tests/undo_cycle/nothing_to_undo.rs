//! What an abort with nothing to undo costs.

use super::*;

/// Rejects the first so many proposals.
fn stubborn(rejections: u32) -> Witness {
    let left = Mutex::new(rejections);
    Witness::allowing(move |_| {
        let mut left = left.lock().unwrap();
        let is_over = *left == 0;
        *left = left.saturating_sub(1);
        is_over
    })
}

fn scene(steps: u64, rule: Witness) -> Scene {
    let success = Some(Odds::of(|_, _| 0.75).taught());
    Scene { rules: vec![Box::new(rule)], success, capacity: 1_000, ..Scene::new(steps) }
}

#[test]
fn an_abort_with_nothing_to_undo_costs_neither_an_attempt_nor_a_hard_reset() {
    let rule = stubborn(3);
    let testimony = rule.testimony.clone();
    let line = Line::new();
    let (log, resets) = (line.log.clone(), line.resets.clone());
    let (counters, Notebook { episodes, interventions, .. }) = Scene { line, ..scene(2, rule) }.run();
    // Three times the forward agent proposes again, the fourth proposal is executed.
    let ends: Vec<_> = episodes.iter().map(|episode| (episode.role, episode.end, episode.length)).collect();
    let abort = (AgentRole::Forward, EpisodeEnd::Abort, 0);
    assert_eq!(ends, [abort, abort, abort, (AgentRole::Forward, EpisodeEnd::Budget, 2)]);
    assert!(episodes.iter().all(|episode| episode.hard_reset.is_none()));
    assert_eq!((counters.early_aborts, counters.reset_episodes, counters.hard_resets), (3, 0, 0));
    assert_eq!((counters.steps, counters.forward_steps), (2, 2));
    assert_eq!(*log.lock().unwrap(), [(0, 1.0), (1, 1.0)]);
    assert_eq!((resets.lock().unwrap().len(), interventions.len()), (1, 3));
    assert_eq!(told(&testimony), [(0, true); 3]);
}

#[test]
fn after_ten_such_aborts_in_a_row_the_reset_agent_takes_over() {
    let rule = Witness::allowing(|_| false);
    let testimony = rule.testimony.clone();
    let (counters, Notebook { episodes, .. }) = scene(3, rule).run();
    // Each time ten aborts, one more, and an attempt of one step, which stays in the reset set.
    let attempts: Vec<usize> =
        (0..episodes.len()).filter(|index| episodes[*index].role == AgentRole::Reset).collect();
    assert_eq!(attempts, [11, 23, 35]);
    assert!(attempts.iter().all(|index| episodes[*index].end == EpisodeEnd::ResetSet));
    assert_eq!((counters.steps, counters.forward_steps, counters.hard_resets), (3, 0, 0));
    let expected =
        [[(0, true); 10].to_vec(), [(1, true); 11].to_vec(), [(2, true); 11].to_vec(), vec![(3, true)]];
    assert_eq!(told(&testimony), expected.concat());
}

#[test]
fn after_something_was_executed_an_abort_is_undone() {
    // One step is allowed, the next is not.
    let rule = Witness::allowing(|context| context.observation[0] == 0.0);
    let testimony = rule.testimony.clone();
    let (counters, Notebook { episodes, .. }) = scene(4, rule).run();
    assert_eq!((counters.early_aborts, counters.reset_episodes, counters.forward_steps), (2, 2, 2));
    assert!(episodes.iter().all(|episode| episode.length == 1));
    assert_eq!(told(&testimony), [(2, true), (4, true)]);
}

#[test]
fn a_rule_that_measures_no_undo_probability_hands_over_at_once() {
    let never = common::Rule::below(2.0);
    let (counters, _) = Scene { rules: vec![never], ..Scene::new(3) }.run();
    assert_eq!((counters.early_aborts, counters.reset_episodes), (3, 3));
}

#[test]
fn a_shield_that_fails_is_not_told_of_as_a_success() {
    let rule = Witness::allowing(|_| true);
    let testimony = rule.testimony.clone();
    let forward = forward_learner(Scripted::acting(|_, _| f32::NEG_INFINITY));
    let (counters, Notebook { episodes, .. }) = Scene { forward, ..scene(2, rule) }.run();
    assert_eq!((counters.failed_closed, counters.reset_episodes, counters.hard_resets), (22, 2, 0));
    assert!(episodes[..10].iter().all(|episode| episode.role == AgentRole::Forward));
    assert_eq!(told(&testimony), [(1, true), (2, true)], "only the attempts");
}

#[test]
fn a_run_that_ends_within_an_attempt_tells_no_outcome_of_it() {
    let rule = Witness::allowing(|context| context.observation[0] < 3.0);
    let testimony = rule.testimony.clone();
    let (_, Notebook { episodes, .. }) = scene(5, rule).run();
    assert_eq!(episodes.last().unwrap().end, EpisodeEnd::Budget);
    assert_eq!(told(&testimony), []);
}
