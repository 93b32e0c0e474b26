//! Evaluations during a run.

use std::sync::Mutex;

use shield_api::{AbortRule, Checkpoint, Needs, ObservedDecision, Reason, Result, RuleContext, RuleVerdict};
use shield_runtime::{
    agent::ForwardAgent,
    cycle::Evaluated,
    evaluation::Evaluator,
    events::{Counters, EvaluationEvent, EvaluationFigures},
    experiment::EvaluatedAgent,
    lanes::Lanes,
    world::World,
};

use crate::{
    common::{self, EPISODE, Line, Rule, Scene, Scripted},
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
