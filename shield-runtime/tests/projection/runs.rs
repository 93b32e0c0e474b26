//! Projections in a run and in its results.

use shield_api::RuleVerdict;
use shield_runtime::{
    decision::{Abort, Cause, Projection, ProjectionKind},
    events::{Counters, Intervention},
    experience::AgentRole,
    experiment::ProjectionConfig,
    observer::{Observer, Scene as Stage},
    run::{Identity, Recorder, RunFolder},
    world::World,
};

use crate::{
    common::{Line, Rule, Scene, Scripted},
    plane::{PROPOSED, SAFE},
};

#[test]
fn the_loop_executes_and_counts_the_projected_action() {
    // Rejects what leads right; the reset agent's own action, left, is allowed.
    let mut scene = Scene::new(6);
    scene.rules = vec![Rule::judging(|context| {
        Ok(RuleVerdict::from_safe(context.proposed[0] <= 0.0, context.proposed[0]))
    })];
    scene.reset = Some(Scripted::acting(|_, _| -0.5));
    scene.projection = Some(ProjectionConfig::Replace);
    let log = scene.line.log.clone();
    let (counters, notebook) = scene.run();
    assert_eq!((counters.projections, counters.early_aborts, counters.forward_steps), (6, 0, 6));
    assert!(log.lock().unwrap().iter().all(|(_, action)| *action == -0.5));
    let (_, proposed, executed, cause, _) = &notebook.interventions[0];
    assert_eq!((*proposed, *executed, cause.as_str()), (1.0, Some(-0.5), "rejected"));
}

#[test]
fn projections_are_in_the_results_of_a_run() {
    let folder = tempfile::tempdir().unwrap();
    let identity = Identity { experiment: "e".into(), variant: "v".into(), seed: 0 };
    let run = RunFolder::new(folder.path(), &identity);
    run.create("()", "{}", false).unwrap();
    let mut recorder =
        Recorder::new(run.clone(), identity, vec!["r".into()], 1.0).unwrap().deterministic(false);
    let rejection = Abort { cause: Cause::Rejected, rule: Some(0), score: -1.0 };
    let projection = Projection { kind: ProjectionKind::Qp, iterations: 2, distance: 0.5, rejection };
    let row = Intervention {
        step: 7,
        role: AgentRole::Forward,
        proposed: &PROPOSED,
        executed: Some(&SAFE),
        abort: rejection,
        projection: Some(projection),
        reason: "too low",
    };
    let mut world = World::new(Box::new(Line::new()), None).unwrap();
    let mut stage = Stage { world: &mut world, reset: None };
    recorder.on_intervention(&row, &mut stage).unwrap();
    let infeasible = Abort { cause: Cause::Infeasible, ..rejection };
    recorder
        .on_intervention(
            &Intervention { abort: infeasible, projection: None, executed: None, ..row },
            &mut stage,
        )
        .unwrap();
    let counters = Counters { projections: 3, ..Counters::default() };
    let summary = recorder.finish(&counters, 10, None).unwrap();
    assert_eq!((summary.projections, summary.deterministic), (3, false));
    let table = std::fs::read_to_string(run.path().join("interventions.csv")).unwrap();
    let expected = "\
step,phase,verdict,cause,rule,score,reason,proposed,executed,solver_status,iterations,distance
7,forward,project,rejected,r,-1,too low,0.5 0.5,-0.75 -0.75,solved,2,0.5
7,forward,abort,infeasible,r,-1,too low,0.5 0.5,,infeasible,,
";
    assert_eq!(table, expected);
}
