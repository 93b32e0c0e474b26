//! Whatever goes wrong on the way to a projection aborts, and leaves a safe action.

use std::{sync::Arc, thread, time::Duration};

use shield_api::Error;
use shield_runtime::{
    decision::{Cause, Decision},
    experiment::QpConfig,
    shield::solver::{Outcome, Program, Solver},
};

use crate::plane::{
    Gradient, PROPOSED, Plane, Pushes, Reach, Value, assert_aborts, decide, filter, qp, shield,
};

#[test]
fn an_action_that_only_the_rows_allow_is_aborted() {
    // The gradient points the wrong way, so that rows and values contradict each other.
    let agent = Plane { gradient: Some(|_| [1.0, 1.0]), ..Plane::linear() };
    let once = QpConfig { max_iterations: 1, ..QpConfig::default() };
    assert_aborts(decide(Reach::new(-0.5), agent, qp(once)), Cause::StillRejected);
}

#[test]
fn non_finite_numbers_and_failing_agents_abort() {
    let mut gradients: Vec<(Option<Gradient>, Cause)> = vec![(None, Cause::GradientsFailed)];
    gradients.push((Some(|_| [f32::NAN, 1.0]), Cause::GradientsFailed));
    gradients.push((Some(|_| [1.0, f32::INFINITY]), Cause::GradientsFailed));
    gradients.push((Some(|_| [f32::NEG_INFINITY, 1.0]), Cause::GradientsFailed));
    gradients.push((Some(|_| [0.0, 0.0]), Cause::Infeasible));
    for (gradient, cause) in gradients {
        assert_aborts(
            decide(Reach::new(0.0), Plane { gradient, ..Plane::linear() }, qp(QpConfig::default())),
            cause,
        );
    }
    // The values of what was found fail, although those of the proposed action did not.
    let value: Value = |action| if action == PROPOSED { -1.0 } else { f32::NAN };
    assert_aborts(
        decide(Reach::new(0.0), Plane { value, ..Plane::linear() }, qp(QpConfig::default())),
        Cause::ValuesFailed,
    );
}

#[test]
fn unusable_rows_abort() {
    let mut table: Vec<(Pushes, Cause)> = vec![
        (|_, _, _, _| Err(Error::unsupported("linearising")), Cause::NotLinearisable),
        (|_, _, _, _| Err(Error::failed("no rows today")), Cause::RowsFailed),
        (|_, _, _, rows| rows.push(&[1.0], 0.0), Cause::RowsFailed),
        (|_, _, _, rows| rows.push(&[1.0, 0.0, 0.0], 0.0), Cause::RowsFailed),
        // A rule that overlooks the error.
        (|_, _, _, rows| rows.push(&[f32::NAN, 0.0], 0.0).or(Ok(())), Cause::RowsFailed),
        (|_, _, _, rows| rows.push(&[1.0, 0.0], -2.0), Cause::Infeasible),
        (
            |_, _, _, rows| rows.push(&[1.0, 0.0], -0.5).and_then(|()| rows.push(&[-1.0, 0.0], -0.5)),
            Cause::Infeasible,
        ),
        (
            |_, _, _, rows| {
                rows.push(&[1.0, 1.0], 0.0)?;
                rows.push(&[-1.0, 1.0], -0.1)?;
                rows.push(&[0.0, -1.0], -0.1)
            },
            Cause::Infeasible,
        ),
        (|_, _, _, rows| rows.push(&[0.0, 0.0], -0.1), Cause::Infeasible),
        (|_, _, _, rows| rows.push(&[1e-45, 0.0], -3e38), Cause::Infeasible),
        // Nothing is asked for, so that the rejected action itself is the nearest.
        (|_, _, _, _| Ok(()), Cause::StillRejected),
        (|_, _, _, rows| rows.push(&[0.0, 0.0], 0.1), Cause::StillRejected),
    ];
    table.push((|_, _, _, rows| rows.push(&[1.0, 0.0], f32::NAN), Cause::RowsFailed));
    table.push((|_, _, _, rows| rows.push(&[1.0, 0.0], f32::INFINITY), Cause::RowsFailed));
    table.push((|_, _, _, rows| rows.push(&[f32::INFINITY, 0.0], 0.0), Cause::RowsFailed));
    for (pushes, cause) in table {
        let rule = Reach { pushes, ..Reach::new(0.0) };
        assert_aborts(decide(rule, Plane::linear(), qp(QpConfig::default())), cause);
    }
}

/// A solver that does what it is told to.
struct Fake(fn(&Program<'_>, &mut [f64]) -> Outcome);

impl Solver for Fake {
    fn solve(&mut self, program: &Program<'_>, y: &mut [f64]) -> Outcome {
        (self.0)(program, y)
    }
}

#[test]
fn a_solver_that_fails_or_lies_leads_to_an_abort() {
    type Solve = fn(&Program<'_>, &mut [f64]) -> Outcome;
    let table: [(Solve, Cause); 7] = [
        (|_, _| panic!("the fake solver panics on purpose"), Cause::SolverPanicked),
        (|_, _| Outcome::NotConverged, Cause::NotConverged),
        (|_, _| Outcome::Infeasible, Cause::Infeasible),
        // It says that it solved, and wrote nothing, no number, nothing finite, or what breaks the row.
        (|_, _| Outcome::Solved, Cause::NotConverged),
        (
            |_, y| {
                y.fill(f64::NAN);
                Outcome::Solved
            },
            Cause::NotConverged,
        ),
        (
            |_, y| {
                y.fill(f64::INFINITY);
                Outcome::Solved
            },
            Cause::NotConverged,
        ),
        (
            |_, y| {
                y.fill(0.0);
                Outcome::Solved
            },
            Cause::NotConverged,
        ),
    ];
    for (solve, cause) in table {
        let mut agent = Plane::linear();
        let mut shield = shield(Reach::new(0.0), &agent, qp(QpConfig::default()))
            .with_solver(Box::new(Fake(solve)))
            .unwrap();
        assert_aborts(filter(&mut shield, &mut agent), cause);
        assert!(shield.reason().starts_with("-1 does not reach 0; not projected: "), "{}", shield.reason());
        // And once more: nothing is left behind that would let it pass.
        assert_aborts(filter(&mut shield, &mut agent), cause);
    }
    // Far outside the box, but in the right direction: it is brought back.
    let mut agent = Plane::linear();
    let far = Fake(|_, y| {
        y.fill(-1e9);
        Outcome::Solved
    });
    let mut shield =
        shield(Reach::new(0.0), &agent, qp(QpConfig::default())).with_solver(Box::new(far)).unwrap();
    assert_eq!(filter(&mut shield, &mut agent).1, [-1.0, -1.0]);
}

#[test]
fn a_late_decision_aborts() {
    let slow: Value = |_| {
        thread::sleep(Duration::from_millis(5));
        1.0
    };
    let decide = |value, deadline| {
        let mut agent = Plane { value, ..Plane::linear() };
        let mut shield = shield(Reach::new(0.0), &agent, qp(QpConfig::default())).with_deadline(deadline);
        filter(&mut shield, &mut agent)
    };
    assert_aborts(decide(slow, Duration::from_millis(1)), Cause::Deadline);
    assert_eq!(decide(slow, Duration::from_secs(60)), (Decision::Allow, PROPOSED));
    // A rejection in time would be projected; late, it is not even tried.
    let slow_and_low: Value = |action| {
        thread::sleep(Duration::from_millis(5));
        -action[0] - action[1]
    };
    assert_aborts(decide(slow_and_low, Duration::from_millis(1)), Cause::Deadline);
    assert!(decide(slow_and_low, Duration::from_secs(60)).0.projection().is_some());
    // In time, but only until the rules have taken note of it.
    let dawdling = || Reach { told: Arc::default(), is_slow_to_note: true, ..Reach::new(-2.0) };
    let decide = |deadline| {
        let mut agent = Plane::linear();
        let mut shield = shield(dawdling(), &agent, qp(QpConfig::default())).with_deadline(deadline);
        filter(&mut shield, &mut agent)
    };
    assert_aborts(decide(Duration::from_millis(2)), Cause::Deadline);
    assert_eq!(decide(Duration::from_secs(60)).0, Decision::Allow);
}
