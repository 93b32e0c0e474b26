//! Programs that are drawn at random, and their solutions as the host takes them.

use std::ops::RangeInclusive;

use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use shield_runtime::shield::solver::{Outcome, Program, Solver};

/// A program that owns its figures.
#[derive(Debug, Clone, Default)]
pub struct Owned {
    pub rows: Vec<f64>,
    pub bounds: Vec<f64>,
    pub lower: Vec<f64>,
    pub upper: Vec<f64>,
}

impl Owned {
    pub fn program(&self) -> Program<'_> {
        Program { rows: &self.rows, bounds: &self.bounds, lower: &self.lower, upper: &self.upper }
    }

    pub fn push(&mut self, row: &[f64], bound: f64) {
        let norm = row.iter().map(|slope| slope * slope).sum::<f64>().sqrt();
        if norm > 0.0 {
            self.rows.extend(row.iter().map(|slope| slope / norm));
            self.bounds.push(bound);
        }
    }

    /// Every constraint, the box's too, as (coefficients, bound).
    pub fn constraints(&self) -> Vec<(Vec<f64>, f64)> {
        let (program, width) = (self.program(), self.lower.len());
        let rows = (0..self.bounds.len()).map(|index| (program.row(index).to_vec(), self.bounds[index]));
        let sides = (0..width).flat_map(|dimension| {
            [(1.0, self.upper[dimension]), (-1.0, -self.lower[dimension])].map(|(sign, bound)| {
                let mut row = vec![0.0; width];
                row[dimension] = sign;
                (row, bound)
            })
        });
        rows.chain(sides.filter(|(_, bound)| bound.is_finite())).collect()
    }

    pub fn random(random: &mut Pcg64, widths: RangeInclusive<usize>, most_rows: usize) -> Self {
        let width = random.random_range(widths);
        let mut program = Self::default();
        for _ in 0..width {
            let half = match random.random_range(0..8) {
                0 => 0.0,
                1 => f64::INFINITY,
                _ => 2.0,
            };
            program.lower.push(-half * random.random::<f64>());
            program.upper.push(half * random.random::<f64>());
        }
        // ∞ · 0 is no bound.
        program.lower.iter_mut().chain(&mut program.upper).for_each(|bound| {
            if bound.is_nan() {
                *bound = 0.0;
            }
        });
        let is_ill = random.random_bool(0.2);
        let stretch: Vec<f64> = (0..width)
            .map(|_| if is_ill { 10f64.powf(random.random_range(-4.0..4.0)) } else { 1.0 })
            .collect();
        let mut row = vec![0.0; width];
        for _ in 0..random.random_range(0..=most_rows) {
            match random.random_range(0..10) {
                // The same again, its opposite, or a neighbour, from the row before.
                0 => {}
                1 => row.iter_mut().for_each(|slope| *slope = -*slope),
                2 => row[0] += 1e-6,
                3 => {
                    row.fill(0.0);
                    row[random.random_range(0..width)] = 1.0;
                }
                _ => {
                    for (slope, stretch) in row.iter_mut().zip(&stretch) {
                        let normal: f64 = StandardNormal.sample(random);
                        *slope = normal * stretch;
                    }
                }
            }
            let normal: f64 = StandardNormal.sample(random);
            let bound = match random.random_range(0..6) {
                0 => 0.0,
                1 => normal.abs() * 0.1,
                _ => normal * 0.4 + 0.4,
            };
            program.push(&row, bound);
        }
        program
    }
}

/// As the host does it: clamped, and a solution outside the rows is none.
pub fn solve(solver: &mut dyn Solver, program: &Owned) -> (Outcome, Vec<f64>) {
    let mut y = vec![f64::NAN; program.lower.len()];
    let outcome = solver.solve(&program.program(), &mut y);
    for (value, (lower, upper)) in y.iter_mut().zip(program.lower.iter().zip(&program.upper)) {
        *value = value.clamp(*lower, *upper);
    }
    let is_kept = outcome != Outcome::Solved || program.program().keeps_rows(&y);
    (if is_kept { outcome } else { Outcome::NotConverged }, y)
}

pub fn norm(y: &[f64]) -> f64 {
    y.iter().map(|value| value * value).sum::<f64>().sqrt()
}

/// By how much the worst constraint fails; negative inside.
pub fn violation(constraints: &[(Vec<f64>, f64)], y: &[f64]) -> f64 {
    let excess = |(row, bound): &(Vec<f64>, f64)| {
        row.iter().zip(y).map(|(slope, value)| slope * value).sum::<f64>() - bound
    };
    constraints.iter().map(excess).fold(f64::NEG_INFINITY, f64::max)
}
