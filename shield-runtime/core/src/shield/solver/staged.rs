//! The standard solver: exactly where few rows decide, else by another one.

use super::{OneRow, Outcome, Program, Solver, active_set::ActiveSet, dot};

/// Tries the farthest row alone before it asks the general solver.
///
/// Dropping rows can only bring the solution nearer. So the row whose own solution lies farthest is the only one that can decide alone; where
/// its solution keeps all other rows, it is the solution. And where one row has no solution, the program has none. Where several decide, an active-set
/// method finds the solution, and shows that it is one, in microseconds; what is infeasible or nearly degenerate is left to the general solver.
#[derive(Debug)]
pub struct Staged<S> {
    one_row: OneRow,
    active_set: ActiveSet,
    general: S,
    bounds: Vec<f64>,
    lower: Vec<f64>,
    upper: Vec<f64>,
}

impl<S: Solver> Staged<S> {
    /// Closed form first, then `general`.
    pub fn new(general: S) -> Self {
        let (bounds, lower, upper) = Default::default();
        Self { one_row: OneRow::default(), active_set: ActiveSet::default(), general, bounds, lower, upper }
    }

    /// The program in units of `distance`, below which no solution lies: its tolerances are then relative to the
    /// solution. Bounds that the box keeps anyway are drawn near, so that no figure is huge.
    fn solve_scaled(&mut self, program: &Program<'_>, distance: f64, y: &mut [f64]) -> Outcome {
        let scale = |target: &mut Vec<f64>, values: &[f64]| {
            target.clear();
            target.extend(values.iter().map(|value| value / distance));
        };
        scale(&mut self.bounds, program.bounds);
        scale(&mut self.lower, program.lower);
        scale(&mut self.upper, program.upper);
        for (index, bound) in self.bounds.iter_mut().enumerate() {
            let sides = program.row(index).iter().zip(self.lower.iter().zip(&self.upper));
            let farthest = |(slope, (lower, upper)): (&f64, (&f64, &f64))| {
                if *slope == 0.0 { 0.0 } else { (slope * lower).max(slope * upper) }
            };
            *bound = bound.min(sides.map(farthest).sum::<f64>());
        }
        let scaled =
            Program { rows: program.rows, bounds: &self.bounds, lower: &self.lower, upper: &self.upper };
        let is_solved = self.active_set.solve(&scaled, y);
        let outcome = if is_solved { Outcome::Solved } else { self.general.solve(&scaled, y) };
        y.iter_mut().for_each(|value| *value *= distance);
        outcome
    }
}

impl<S: Solver> Solver for Staged<S> {
    fn solve(&mut self, program: &Program<'_>, y: &mut [f64]) -> Outcome {
        let Program { bounds, lower, upper, .. } = *program;
        let mut farthest = (0.0, None);
        for (index, bound) in bounds.iter().enumerate() {
            let row = program.row(index);
            let Some(multiplier) = self.one_row.multiplier(row, *bound, lower, upper) else {
                return Outcome::Infeasible;
            };
            OneRow::place(row, multiplier, lower, upper, y);
            let squared = dot(y, y);
            if squared > farthest.0 {
                farthest = (squared, Some((index, multiplier)));
            }
        }
        let (squared, Some((index, multiplier))) = farthest else {
            y.fill(0.0);
            return Outcome::Solved;
        };
        OneRow::place(program.row(index), multiplier, lower, upper, y);
        let keeps = |(row, bound): (usize, &f64)| row == index || dot(program.row(row), y) <= *bound;
        if bounds.iter().enumerate().all(keeps) {
            return Outcome::Solved;
        }
        self.solve_scaled(program, squared.sqrt(), y)
    }
}
