//! Independent ways to the nearest point, and the comparison with them.

use std::panic;

use ndarray::{Array1, Array2};
use shield_runtime::shield::solver::Outcome;

use crate::random_program::{Owned, norm, violation};

/// The least-distance problem by non-negative least squares (Lawson and Hanson 1974, chapter 23), with another author's solver. `None` where
/// it finds nothing that keeps the constraints.
pub fn least_distance(program: &Owned) -> Option<Vec<f64>> {
    let (constraints, width) = (program.constraints(), program.lower.len());
    if constraints.is_empty() {
        return Some(vec![0.0; width]);
    }
    // G y ≥ h with G = −rows and h = −bounds; E = [Gᵀ; hᵀ], f = (0, …, 0, 1).
    let matrix = Array2::from_shape_fn((width + 1, constraints.len()), |(line, constraint)| {
        let (row, bound) = &constraints[constraint];
        if line < width { -row[line] } else { -bound }
    });
    let mut target = Array1::zeros(width + 1);
    target[width] = 1.0;
    // On some degenerate programs that crate gives up with a panic.
    let solved = panic::catch_unwind(|| nnls::nnls(matrix.view(), target.view()));
    let (multipliers, _) = solved.ok()?;
    let residual = matrix.dot(&multipliers) - target;
    let y: Vec<f64> = (0..width).map(|index| -residual[index] / residual[width]).collect();
    let is_solution = y.iter().all(|value| value.is_finite()) && violation(&constraints, &y) < 1e-9;
    is_solution.then_some(y)
}

/// The best of everything that can be a solution in two dimensions: the origin, its foot on each line, every crossing of two lines.
pub fn brute_force(program: &Owned) -> Option<Vec<f64>> {
    let constraints = program.constraints();
    let mut candidates = vec![vec![0.0, 0.0]];
    for (index, (one, bound)) in constraints.iter().enumerate() {
        candidates.push(vec![one[0] * bound, one[1] * bound]);
        for (other, other_bound) in &constraints[..index] {
            let determinant = one[0] * other[1] - one[1] * other[0];
            if determinant.abs() > 1e-12 {
                candidates.push(vec![
                    (bound * other[1] - one[1] * other_bound) / determinant,
                    (one[0] * other_bound - bound * other[0]) / determinant,
                ]);
            }
        }
    }
    candidates.retain(|y| violation(&constraints, y) < 1e-9);
    candidates.into_iter().min_by(|left, right| norm(left).total_cmp(&norm(right)))
}

/// What many programs came to.
#[derive(Debug, Default)]
pub struct Tally {
    pub solved: u64,
    pub infeasible: u64,
    pub not_converged: u64,
    pub compared: u64,
    /// Nearer than the oracle's, which the tolerance of the rows allows.
    pub nearer: u64,
    /// Called infeasible or given up, although the oracle has a solution.
    pub missed: u64,
}

/// Counts one program; panics where a solution breaks a constraint, or is not the nearest.
pub fn compare(
    tally: &mut Tally,
    case: u64,
    program: &Owned,
    found: &(Outcome, Vec<f64>),
    oracle: Option<Vec<f64>>,
) {
    let (outcome, y) = found;
    if *outcome != Outcome::Solved {
        tally.missed += u64::from(oracle.is_some());
        match outcome {
            Outcome::Infeasible => tally.infeasible += 1,
            _ => tally.not_converged += 1,
        }
        return;
    }
    tally.solved += 1;
    let excess = violation(&program.constraints(), y);
    assert!(excess < 1e-6, "program {case} is violated by {excess}: {program:?}, {y:?}");
    if let Some(nearest) = oracle {
        tally.compared += 1;
        let (distance, expected) = (norm(y), norm(&nearest));
        let error = (distance - expected) / expected.max(1.0);
        assert!(error < 1e-5, "program {case}: distance {distance}, not {expected}: {program:?}");
        // Between rows that are almost parallel, what a row may be exceeded by is a long way.
        tally.nearer += u64::from(error < -1e-5);
    }
}
