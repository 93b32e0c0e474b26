//! The projection's solvers against independent ones, on many random programs: ill-conditioned, degenerate and infeasible ones too.
//!
//! `cargo xtask test --long` tries a million of them.
#![allow(clippy::unwrap_used, reason = "a test")]

mod decisions;
mod independent;
mod random_program;

use independent::{Tally, brute_force, compare, least_distance};
use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use random_program::{Owned, norm, solve};
use shield_runtime::shield::solver::{InteriorPoint, OneRow, Outcome, Solver, Staged};

/// Programs per property test.
const PROGRAMS: u64 = 20_000;

/// So many programs, or as many as `cargo xtask test --long` asks for.
fn programs(usual: u64) -> u64 {
    std::env::var("SHIELD_TEST_PROGRAMS").map_or(usual, |number| number.parse().unwrap())
}

#[test]
fn solutions_keep_every_row_and_are_the_nearest() {
    let programs = programs(PROGRAMS);
    let mut random = Pcg64::seed_from_u64(1);
    let mut solver = Staged::new(InteriorPoint::default());
    let mut tally = Tally::default();
    for case in 0..programs {
        let program = Owned::random(&mut random, 1..=12, 40);
        compare(&mut tally, case, &program, &solve(&mut solver, &program), least_distance(&program));
    }
    // Enough of each kind that the test says something; and hardly a solution is missed.
    let Tally { solved, infeasible, not_converged, compared, missed, nearer } = tally;
    assert!(nearer * 100_000 <= compared, "{tally:?}");
    assert!(compared > programs / 10 && infeasible > programs / 10, "{tally:?}");
    assert!(missed * 100_000 <= solved && not_converged * 40 <= solved + infeasible, "{tally:?}");
}

#[test]
fn solutions_in_the_plane_match_brute_force() {
    let mut random = Pcg64::seed_from_u64(2);
    let mut solver = Staged::new(InteriorPoint::default());
    let mut tally = Tally::default();
    for case in 0..PROGRAMS {
        let program = Owned::random(&mut random, 2..=2, 8);
        compare(&mut tally, case, &program, &solve(&mut solver, &program), brute_force(&program));
    }
    assert!(tally.compared > PROGRAMS / 4 && tally.infeasible > PROGRAMS / 20, "{tally:?}");
    assert!(tally.missed * 500 <= tally.solved && tally.nearer * 5_000 <= tally.compared, "{tally:?}");
}

#[test]
fn the_closed_form_of_one_row_matches_the_interior_point() {
    let mut random = Pcg64::seed_from_u64(3);
    let (mut closed, mut interior) = (OneRow::default(), InteriorPoint::default());
    let (mut solved, mut infeasible) = (0, 0);
    for case in 0..PROGRAMS / 4 {
        let mut program = Owned::random(&mut random, 1..=12, 1);
        while program.bounds.is_empty() {
            program = Owned::random(&mut random, 1..=12, 1);
        }
        let (exact, iterated) = (solve(&mut closed, &program), solve(&mut interior, &program));
        match (exact.0, iterated.0) {
            (Outcome::Solved, Outcome::Solved) => {
                solved += 1;
                let (distance, expected) = (norm(&exact.1), norm(&iterated.1));
                // The iterated one may be a little nearer, by the tolerance of the row.
                let error = (distance - expected) / expected.max(1.0);
                assert!((-1e-4..1e-5).contains(&error), "program {case}: {program:?} {exact:?} {iterated:?}");
            }
            (one, other) => {
                infeasible += u64::from(one == Outcome::Infeasible);
                // Beside the boundary of what is feasible the iterated solution may say something else.
                assert!(
                    one == other || other == Outcome::NotConverged,
                    "program {case}: {program:?} {exact:?} {iterated:?}"
                );
            }
        }
    }
    assert!(
        solved > PROGRAMS / 8 && infeasible > PROGRAMS / 1000,
        "{solved} solved, {infeasible} infeasible"
    );
}

#[test]
fn a_kept_workspace_gives_the_solutions_of_a_fresh_one() {
    let mut random = Pcg64::seed_from_u64(4);
    let mut kept = InteriorPoint::default();
    for case in 0..500 {
        // Three programs of one shape in a row, then another shape.
        let rows = 2 + case / 3 % 5;
        let mut program = Owned { lower: vec![-1.0; 3], upper: vec![1.0; 3], ..Owned::default() };
        if case / 15 % 2 == 1 {
            program.upper[1] = f64::INFINITY;
        }
        for _ in 0..rows {
            let row: Vec<f64> = (0..3).map(|_| random.random_range(-1.0..1.0)).collect();
            program.push(&row, random.random_range(-0.4..0.2));
        }
        let (again, fresh) = (solve(&mut kept, &program), solve(&mut InteriorPoint::default(), &program));
        assert_eq!(again.0, fresh.0, "program {case}: {program:?}");
        if fresh.0 == Outcome::Solved {
            let apart: f64 = again.1.iter().zip(&fresh.1).map(|(one, other)| (one - other).abs()).sum();
            assert!(apart < 1e-5, "program {case}: {again:?}, {fresh:?}");
        }
    }
}

#[test]
fn earlier_programs_change_no_bit_of_a_solution() {
    let mut random = Pcg64::seed_from_u64(11);
    let mut kept = InteriorPoint::default();
    for index in 0..PROGRAMS / 20 {
        // Mostly of one shape, so that the workspace is used again.
        let mut program = Owned { lower: vec![-1.0; 3], upper: vec![1.0; 3], ..Owned::default() };
        for _ in 0..if index % 50 == 0 { 3 } else { 2 } {
            let row: Vec<f64> = (0..3).map(|_| StandardNormal.sample(&mut random)).collect();
            program.push(&row, -10f64.powf(random.random_range(-3.0..0.0)));
        }
        let (mut after_others, mut alone) = ([0.0; 3], [0.0; 3]);
        let outcomes = [
            kept.solve(&program.program(), &mut after_others),
            InteriorPoint::default().solve(&program.program(), &mut alone),
        ];
        assert_eq!(outcomes[0], outcomes[1], "{program:?}");
        assert_eq!(after_others.map(f64::to_bits), alone.map(f64::to_bits), "{program:?}");
    }
}
