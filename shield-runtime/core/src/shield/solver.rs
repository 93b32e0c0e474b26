//! Solvers of the projection: the shortest step that keeps linear rows inside a box.

mod active_set;
#[cfg(feature = "clarabel")]
mod interior_point;
mod one_row;
mod staged;

#[cfg(feature = "clarabel")]
pub use interior_point::InteriorPoint;
pub use one_row::OneRow;
pub use staged::Staged;

/// How far a solution may be outside a row, in units of the row, whose coefficients have norm 1.
pub const ROW_TOLERANCE: f64 = 1e-7;

/// minimise ½ ‖y‖² subject to `rows · y ≤ bounds` and `lower ≤ y ≤ upper`.
///
/// The host guarantees `lower ≤ 0 ≤ upper`, where single bounds may be infinite; rows and bounds are finite, and each row has norm 1.
#[derive(Debug, Clone, Copy)]
pub struct Program<'a> {
    /// Coefficients, `bounds.len() × lower.len()`, row-major.
    pub rows: &'a [f64],
    /// Right-hand sides of the rows.
    pub bounds: &'a [f64],
    /// Least values of y.
    pub lower: &'a [f64],
    /// Largest values of y.
    pub upper: &'a [f64],
}

impl Program<'_> {
    /// The number of dimensions.
    pub fn dimensions(&self) -> usize {
        self.lower.len()
    }

    /// The coefficients of one row.
    pub fn row(&self, index: usize) -> &[f64] {
        let width = self.dimensions();
        &self.rows[index * width..(index + 1) * width]
    }

    /// Whether `y` keeps every row up to [`ROW_TOLERANCE`]. NaN keeps none.
    pub fn keeps_rows(&self, y: &[f64]) -> bool {
        let tolerance = |bound: f64| ROW_TOLERANCE * bound.abs().max(1.0);
        let mut rows = self.bounds.iter().enumerate();
        y.iter().all(|value| value.is_finite())
            && rows.all(|(index, bound)| dot(self.row(index), y) <= bound + tolerance(*bound))
    }
}

/// What became of a program.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// The solution is written.
    Solved,
    /// Nothing inside the box keeps all rows.
    Infeasible,
    /// No solution was found in time, or only an inaccurate one.
    NotConverged,
}

/// Solves projections. Called by one thread at a time.
///
/// A solver is not trusted: its solution is clamped to the box, checked against the rows, and then judged by the rules. After a panic it
/// may be called again, and must not build on what it left behind.
pub trait Solver: Send {
    /// Writes the solution into `y`, which is as long as the program has dimensions; what it holds before is of no meaning.
    fn solve(&mut self, program: &Program<'_>, y: &mut [f64]) -> Outcome;
}

/// The solver of a projection that names no other.
pub(super) fn standard() -> Box<dyn Solver> {
    #[cfg(feature = "clarabel")]
    let general = InteriorPoint::default();
    #[cfg(not(feature = "clarabel"))]
    let general = GivesUp;
    Box::new(Staged::new(general))
}

/// Stands where no general solver was compiled in: what the active set gives up is not projected but aborted.
#[cfg(not(feature = "clarabel"))]
#[derive(Debug)]
struct GivesUp;

#[cfg(not(feature = "clarabel"))]
impl Solver for GivesUp {
    fn solve(&mut self, _: &Program<'_>, _: &mut [f64]) -> Outcome {
        Outcome::NotConverged
    }
}

pub(super) fn dot(left: &[f64], right: &[f64]) -> f64 {
    left.iter().zip(right).map(|(left, right)| left * right).sum()
}
