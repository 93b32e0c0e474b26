//! The general case, by clarabel's interior-point method.

use clarabel::{
    algebra::CscMatrix,
    solver::{
        DefaultSettings, DefaultSolver, IPSolver, NonnegativeConeT, SolverError, SolverStatus, SupportedConeT,
    },
};

use super::{Outcome, Program, Solver};

/// Clarabel, with its workspace kept for programs of the same shape.
///
/// All constraints form one matrix A y ≤ b: the rows, then y ≤ upper and −y ≤ −lower where these are finite.
#[derive(Default)]
pub struct InteriorPoint {
    workspace: Option<Workspace>,
    coefficients: Vec<f64>,
    right_side: Vec<f64>,
}

struct Workspace {
    shape: Shape,
    solver: DefaultSolver<f64>,
}

/// What decides where A has entries.
#[derive(Debug, PartialEq, Eq)]
struct Shape {
    rows: usize,
    /// For each dimension, whether it has an upper and a lower bound.
    bounded: Vec<[bool; 2]>,
}

impl Shape {
    fn of(program: &Program<'_>) -> Self {
        let sides = program.upper.iter().zip(program.lower);
        Self {
            rows: program.bounds.len(),
            bounded: sides.map(|(upper, lower)| [upper.is_finite(), lower.is_finite()]).collect(),
        }
    }

    fn matches(&self, program: &Program<'_>) -> bool {
        let sides = program.upper.iter().zip(program.lower);
        self.rows == program.bounds.len()
            && self.bounded.len() == program.dimensions()
            && sides.zip(&self.bounded).all(|((u, l), known)| [u.is_finite(), l.is_finite()] == *known)
    }
}

impl InteriorPoint {
    /// Writes the entries of A by columns, and b.
    fn fill(&mut self, program: &Program<'_>) {
        let width = program.dimensions();
        self.coefficients.clear();
        self.right_side.clear();
        self.right_side.extend_from_slice(program.bounds);
        for dimension in 0..width {
            self.coefficients.extend(program.rows.iter().skip(dimension).step_by(width));
            for (sign, bound) in [(1.0, program.upper[dimension]), (-1.0, program.lower[dimension])] {
                if bound.is_finite() {
                    self.coefficients.push(sign);
                    self.right_side.push(sign * bound);
                }
            }
        }
    }

    fn build(&self, shape: Shape) -> Result<Workspace, SolverError> {
        let (width, height) = (shape.bounded.len(), self.right_side.len());
        let mut starts = vec![0];
        let mut positions = Vec::with_capacity(self.coefficients.len());
        let mut next_bound = shape.rows;
        for sides in &shape.bounded {
            let bounds = sides.iter().filter(|is_bounded| **is_bounded).count();
            positions.extend((0..shape.rows).chain(next_bound..next_bound + bounds));
            next_bound += bounds;
            starts.push(positions.len());
        }
        let matrix = CscMatrix::new(height, width, starts, positions, self.coefficients.clone());
        let cones: [SupportedConeT<f64>; 1] = [NonnegativeConeT(height)];
        // Presolving or dropping zeros would change the shape, after which the data cannot be updated.
        let settings = DefaultSettings {
            verbose: false,
            max_iter: 100,
            max_threads: 1,
            direct_solve_method: "qdldl".into(),
            presolve_enable: false,
            input_sparse_dropzeros: false,
            // Its scaling would be that of the first program: a continued run could not repeat it. The rows have norm 1 already.
            equilibrate_enable: false,
            ..DefaultSettings::default()
        };
        let identity = CscMatrix::identity(width);
        let solver =
            DefaultSolver::new(&identity, &vec![0.0; width], &matrix, &self.right_side, &cones, settings)?;
        Ok(Workspace { shape, solver })
    }
}

impl Solver for InteriorPoint {
    fn solve(&mut self, program: &Program<'_>, y: &mut [f64]) -> Outcome {
        self.fill(program);
        // Taken out, so that a panic leaves no workspace behind.
        let kept = self.workspace.take().filter(|workspace| workspace.shape.matches(program));
        let updated = kept.and_then(|mut workspace| {
            let solver = &mut workspace.solver;
            let updated =
                solver.update_A(&self.coefficients).and_then(|()| solver.update_b(&self.right_side));
            updated.is_ok().then_some(workspace)
        });
        let workspace = updated.map_or_else(|| self.build(Shape::of(program)), Ok);
        let Ok(mut workspace) = workspace else { return Outcome::NotConverged };
        workspace.solver.solve();
        let solution = &workspace.solver.solution;
        let outcome = match solution.status {
            SolverStatus::Solved => {
                y.copy_from_slice(&solution.x);
                Outcome::Solved
            }
            SolverStatus::PrimalInfeasible | SolverStatus::AlmostPrimalInfeasible => Outcome::Infeasible,
            _ => Outcome::NotConverged,
        };
        self.workspace = Some(workspace);
        outcome
    }
}
