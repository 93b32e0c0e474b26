//! Evaluations during a run.

use shield_runtime::{
    agent::ForwardAgent, cycle::Evaluated, evaluation::Evaluator, experiment::EvaluatedAgent, lanes::Lanes,
    world::World,
};

use crate::{
    common::{self, EPISODE, Line, Scene, Scripted},
    no_pit,
};

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
    let first = notebook.evaluations[0];
    assert_eq!((first.mean_return, first.success_rate, first.irreversible_entries), (18.0, 1.0, 2));
    assert_eq!(log.lock().unwrap().len() as u64, 3 * first.steps);

    let mut scene = Scene::new(10);
    scene.settings.evaluate_every = Some(10);
    scene.evaluator = Some(evaluator(Line::new(), None, EvaluatedAgent::Reset, Some("far")));
    let (_, notebook) = scene.run();
    assert_eq!(notebook.evaluations[0].success_rate, 1.0);

    let mut scene = Scene::new(10);
    scene.settings.evaluate_every = Some(10);
    let shield = common::shield(no_pit(), scene.reset.as_ref().unwrap(), 0);
    scene.evaluator = Some(evaluator(Line::new(), Some(shield), EvaluatedAgent::Forward, None));
    let (_, notebook) = scene.run();
    assert_eq!(notebook.evaluations[0].irreversible_entries, 0, "a shielded evaluation does not fall");
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
    assert!(alone[0].steps == 7 * EPISODE as u64 && alone[0].irreversible_entries == 7, "{alone:?}");
    for (worlds, threads) in [(7, 1), (3, 2), (4, 3), (8, 8)] {
        assert_eq!(evaluate(worlds, threads), alone, "{worlds} worlds, {threads} threads");
    }
    assert!(Evaluator::new(Lanes::new(vec![], 1).unwrap(), None, EvaluatedAgent::Reset, None, 1, 0).is_err());
}
