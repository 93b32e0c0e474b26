//! Every cause of a rejection is written and counted by its name.
#![allow(clippy::unwrap_used, reason = "tests")]

mod common;

use common::Line;
use shield_runtime::{
    decision::{Abort, Cause},
    events::{Counters, Intervention},
    experience::AgentRole,
    observer::{Observer, Scene},
    run::{Identity, Recorder, RunFolder},
    world::World,
};

/// The cause after this one. A new variant does not compile here until it has its place.
fn next(cause: Cause) -> Option<Cause> {
    Some(match cause {
        Cause::Rejected => Cause::Infeasible,
        Cause::Infeasible => Cause::StillRejected,
        Cause::StillRejected => Cause::NotLinearisable,
        Cause::NotLinearisable => Cause::InvalidObservation,
        Cause::InvalidObservation => Cause::InvalidAction,
        Cause::InvalidAction => Cause::ForwardFailed,
        Cause::ForwardFailed => Cause::ValuesFailed,
        Cause::ValuesFailed => Cause::RuleFailed,
        Cause::RuleFailed => Cause::GradientsFailed,
        Cause::GradientsFailed => Cause::RowsFailed,
        Cause::RowsFailed => Cause::NotConverged,
        Cause::NotConverged => Cause::SolverPanicked,
        Cause::SolverPanicked => Cause::Deadline,
        Cause::Deadline => Cause::ResetFailed,
        Cause::ResetFailed => Cause::AwaitsHardReset,
        Cause::AwaitsHardReset => return None,
    })
}

#[test]
fn every_cause_is_in_the_table_and_the_summary() {
    let parent = tempfile::tempdir().unwrap();
    let folder = RunFolder::at(parent.path().join("seed-0"));
    folder.create("", "[]", false).unwrap();
    let identity = Identity { experiment: "x".into(), variant: "default".into(), seed: 0 };
    let mut recorder = Recorder::new(folder, identity, vec!["the-rule".into()], 1.0).unwrap();
    let causes: Vec<Cause> = std::iter::successors(Some(Cause::Rejected), |cause| next(*cause)).collect();
    let mut world = World::new(Box::new(Line::new()), None).unwrap();
    let mut stage = Scene { world: &mut world, reset: None };
    for (step, cause) in causes.iter().enumerate() {
        let intervention = Intervention {
            step: step as u64,
            role: AgentRole::Forward,
            proposed: &[f32::NAN, 1.0],
            executed: None,
            abort: Abort { cause: *cause, rule: Some(0), score: 0.5 },
            projection: None,
            reason: "since, \"so\"",
        };
        recorder.on_intervention(&intervention, &mut stage).unwrap();
    }
    let summary = recorder.finish(&Counters::default(), 1, None).unwrap();

    let mut table = csv::Reader::from_path(parent.path().join("seed-0/interventions.csv")).unwrap();
    let headers = table.headers().unwrap().clone();
    let column = |name: &str| headers.iter().position(|header| header == name).unwrap();
    let (cause, rule, verdict, reason) =
        (column("cause"), column("rule"), column("verdict"), column("reason"));
    let rows: Vec<csv::StringRecord> = table.records().map(Result::unwrap).collect();
    assert_eq!(rows.len(), causes.len());
    for (row, expected) in rows.iter().zip(&causes) {
        assert_eq!(row[cause], expected.to_string());
        assert_eq!((&row[rule], &row[verdict], &row[reason]), ("the-rule", "abort", "since, \"so\""));
        assert_eq!(summary.rejected_by_cause[&expected.to_string()], 1);
    }
    assert_eq!(summary.rejected_by_cause.len(), causes.len(), "two causes have one name");
}
