//! One row and a box, in closed form.

use super::{Outcome, Program, Solver, dot};

/// Solves programs of at most one row, exactly. Of several rows it says that it did not converge.
///
/// With the multiplier λ ≥ 0 of the row g·y ≤ r, the solution is yᵢ(λ) = clamp(−λ gᵢ, lowerᵢ, upperᵢ), and g·y(λ) falls piecewise linearly
/// in λ. A dimension reaches its bound at the breakpoint λᵢ = −boundᵢ / gᵢ; walking through the breakpoints in order finds the piece on
/// which g·y(λ) = r.
#[derive(Debug, Default)]
pub struct OneRow {
    /// Dimensions that the row moves, as (breakpoint, dimension).
    breakpoints: Vec<(f64, usize)>,
}

impl OneRow {
    /// The multiplier λ at which the row holds: 0 where it holds already, `None` where it holds nowhere in the box.
    pub(super) fn multiplier(
        &mut self,
        row: &[f64],
        bound: f64,
        lower: &[f64],
        upper: &[f64],
    ) -> Option<f64> {
        if bound >= 0.0 {
            return Some(0.0);
        }
        self.breakpoints.clear();
        let mut free_slope = 0.0;
        for (dimension, slope) in row.iter().enumerate().filter(|(_, slope)| **slope != 0.0) {
            let reached = if *slope > 0.0 { lower[dimension] } else { upper[dimension] };
            self.breakpoints.push((-reached / slope, dimension));
            free_slope += slope * slope;
        }
        self.breakpoints.sort_unstable_by(|left, right| left.0.total_cmp(&right.0));
        // g·y(λ) = saturated − λ · free_slope on the present piece.
        let mut saturated = 0.0;
        for (position, (breakpoint, dimension)) in self.breakpoints.iter().enumerate() {
            let multiplier = (saturated - bound) / free_slope;
            if multiplier <= *breakpoint {
                return Some(multiplier);
            }
            let slope = row[*dimension];
            saturated += slope * if slope > 0.0 { lower[*dimension] } else { upper[*dimension] };
            // Summed anew instead of subtracted: a small remainder would otherwise drown in rounding.
            let rest = &self.breakpoints[position + 1..];
            free_slope = rest.iter().map(|(_, dimension)| row[*dimension] * row[*dimension]).sum();
        }
        // Everything is at its bound: only rounding may be left.
        let is_met = saturated <= bound + f64::EPSILON * bound.abs();
        is_met.then_some(f64::MAX)
    }

    /// y(λ).
    pub(super) fn place(row: &[f64], multiplier: f64, lower: &[f64], upper: &[f64], y: &mut [f64]) {
        for (dimension, value) in y.iter_mut().enumerate() {
            let step = if row[dimension] == 0.0 { 0.0 } else { -multiplier * row[dimension] };
            *value = step.max(lower[dimension]).min(upper[dimension]);
        }
    }
}

impl Solver for OneRow {
    fn solve(&mut self, program: &Program<'_>, y: &mut [f64]) -> Outcome {
        let Program { bounds, lower, upper, .. } = *program;
        match bounds {
            [] => {
                y.fill(0.0);
                Outcome::Solved
            }
            [bound] => {
                let row = program.row(0);
                let Some(multiplier) = self.multiplier(row, *bound, lower, upper) else {
                    return Outcome::Infeasible;
                };
                Self::place(row, multiplier, lower, upper, y);
                debug_assert!(dot(row, y) <= bound + super::ROW_TOLERANCE * bound.abs().max(1.0));
                Outcome::Solved
            }
            _ => Outcome::NotConverged,
        }
    }
}
