//! Between allow and abort: what is executed instead of a rejected action, and that everything that goes wrong aborts.
#![allow(clippy::unwrap_used, reason = "a test")]

#[path = "../common/mod.rs"]
mod common;
mod failures;
mod plane;
mod runs;

use plane::{
    BAD, PROPOSED, Plane, Reach, SAFE, Value, assert_aborts, decide, filter, moment, only, qp, settings,
    shield,
};
use shield_api::Space;
use shield_runtime::{
    decision::{Cause, ProjectionKind},
    experiment::{ProjectionConfig, QpConfig},
    shield::{Ladder, RuleTree},
};

/// The projected action under a configuration of the program.
fn projected(config: QpConfig) -> [f32; 2] {
    let (decision, action) = decide(Reach::new(0.0), Plane::linear(), qp(config));
    assert!(decision.projection().is_some(), "{decision:?}");
    action
}

fn assert_near(found: [f32; 2], expected: [f32; 2]) {
    let is_near = found.iter().zip(&expected).all(|(one, other)| (one - other).abs() < 1e-4);
    assert!(is_near, "{found:?} is not {expected:?}");
}

#[test]
fn a_rule_of_a_third_party_is_projected_to_the_nearest_action() {
    let rule = Reach::new(0.0);
    let told = rule.told.clone();
    let mut agent = Plane::linear();
    let mut shield = shield(rule, &agent, qp(QpConfig::default()));
    let (decision, action) = filter(&mut shield, &mut agent);
    let projection = decision.projection().unwrap();
    assert_near(action, [0.0, 0.0]);
    assert_eq!((projection.kind, projection.iterations), (ProjectionKind::Qp, 1));
    assert!((projection.distance - 0.5f32.sqrt()).abs() < 1e-4);
    assert_eq!((projection.rejection.cause, projection.rejection.rule), (Cause::Rejected, Some(0)));
    assert_eq!(projection.rejection.score, -1.0);
    assert_eq!(shield.reason(), "-1 does not reach 0", "the reason is that of the proposed action");
    assert_eq!(*told.lock().unwrap(), [(false, action.to_vec())], "rules hear of what is executed");

    let mut exploration = PROPOSED;
    let decision = shield.guard(only(&mut agent), &moment(), &mut exploration);
    assert_aborts((decision, exploration), Cause::Rejected);
}

#[test]
fn every_field_of_the_program_changes_the_projection() {
    assert_near(projected(QpConfig::default()), [0.0, 0.0]);
    assert_near(projected(QpConfig { margin: 0.4, ..QpConfig::default() }), [-0.2, -0.2]);
    let weights = Some(vec![1.0, 3.0]);
    assert_near(projected(QpConfig { weights, ..QpConfig::default() }), [-0.25, 0.25]);
    // Half the range is 1: each dimension may move by 0.6, and 0.4 is not enough.
    let trust =
        |share| QpConfig { trust_region: Some(share), weights: Some(vec![1.0, 3.0]), ..QpConfig::default() };
    assert_near(projected(trust(0.6)), [-0.1, 0.1]);
    assert_aborts(decide(Reach::new(0.0), Plane::linear(), qp(trust(0.4))), Cause::Infeasible);
}

#[test]
fn a_curved_value_is_linearised_again() {
    // Q = −Σ (a³ + 0.2 a): from (0.5, 0.5), each linearisation ends outside, a little nearer.
    let curved = || Plane {
        value: |action| -action.iter().map(|value| value.powi(3) + 0.2 * value).sum::<f32>(),
        gradient: Some(|action| [0, 1].map(|index| -3.0 * action[index] * action[index] - 0.2)),
    };
    let with = |max_iterations, threshold| {
        decide(Reach::new(threshold), curved(), qp(QpConfig { max_iterations, ..QpConfig::default() }))
    };
    assert_aborts(with(1, -0.05), Cause::StillRejected);
    let (decision, action) = with(10, -0.05);
    let iterations = decision.projection().unwrap().iterations;
    assert!((2..=10).contains(&iterations), "{iterations}");
    assert!((curved().value)(&action) >= -0.05, "the true value decides: {action:?}");
}

#[test]
fn the_reset_agents_action_replaces_a_rejected_one_if_the_rules_allow_it() {
    let (decision, action) = decide(Reach::new(0.0), Plane::linear(), ProjectionConfig::Replace);
    let projection = decision.projection().unwrap();
    assert_eq!((projection.kind, projection.iterations, action), (ProjectionKind::Replace, 0, SAFE));
    assert!((projection.distance - (2.0 * 1.25f32 * 1.25).sqrt()).abs() < 1e-5);
    // Its own value is 1.5.
    assert_aborts(decide(Reach::new(1.6), Plane::linear(), ProjectionConfig::Replace), Cause::StillRejected);
    let value: Value = |action| if action == SAFE { BAD[0] } else { -1.0 };
    let failing = Plane { value, ..Plane::linear() };
    assert_aborts(decide(Reach::new(0.0), failing, ProjectionConfig::Replace), Cause::ValuesFailed);
}

#[test]
fn a_projection_that_does_not_fit_the_action_space_is_refused() {
    let agent = Plane::linear();
    let build = |space: Space, config| {
        let shield = Ladder::new(RuleTree::Rule(Box::new(Reach::new(0.0))), &agent, settings(space)).unwrap();
        shield.with_projection(config).err().map(|error| error.message().to_owned())
    };
    let discrete = || Space::Discrete { n: 3 };
    assert!(build(discrete(), qp(QpConfig::default())).unwrap().contains("discrete"));
    assert_eq!(build(discrete(), ProjectionConfig::Replace), None);
    let weights = QpConfig { weights: Some(vec![1.0; 3]), ..QpConfig::default() };
    assert!(build(Space::uniform(2, -1.0, 1.0), qp(weights)).unwrap().contains("3 weights"));
    let endless = Space::uniform(2, f32::NEG_INFINITY, f32::INFINITY);
    let trust = QpConfig { trust_region: Some(0.5), ..QpConfig::default() };
    assert!(build(endless.clone(), qp(trust)).unwrap().contains("no bounds"));
    assert_eq!(build(endless, qp(QpConfig::default())), None);
}
