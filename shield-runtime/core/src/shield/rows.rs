//! The rules' rows as constraints of the projection's program.

use shield_api::{Error, Result, Rows, check_finite};

/// Share of a row's own terms by which it is tightened, so that the rounding of an action to `f32` cannot break it.
const ROUNDING: f64 = 1e-6;

/// Rows A a ≤ b, taken as rows on y, where a = a₀ + y / √weight: tightened by the margin, and divided by their norm.
///
/// A soft rule may be exceeded by s ≥ 0 at the cost of priority · s² / 2. With z = √priority · s that is one more dimension of y, and its rows
/// read A a − z / √priority ≤ b.
#[derive(Debug)]
pub(super) struct RowBuffer {
    margin: f64,
    /// 1 / √weight of each dimension.
    scale: Vec<f64>,
    /// Dimensions of y after those of the action, one per soft rule.
    slacks: usize,
    proposed: Vec<f64>,
    /// Of the rule whose rows come next.
    slack: Option<(usize, f64)>,
    pub coefficients: Vec<f64>,
    pub bounds: Vec<f64>,
    /// A row without any slope does not hold, so that nothing can make it hold.
    pub is_impossible: bool,
    /// A row was refused. A rule may overlook the error, but its rows are incomplete.
    pub refused: Option<Error>,
}

impl RowBuffer {
    pub fn new(margin: f32, scale: Vec<f64>, slacks: usize) -> Self {
        let (proposed, coefficients, bounds) = Default::default();
        Self {
            margin: f64::from(margin),
            scale,
            slacks,
            proposed,
            slack: None,
            coefficients,
            bounds,
            is_impossible: false,
            refused: None,
        }
    }

    /// Forgets all rows; the next ones belong to the action `proposed`.
    pub fn start(&mut self, proposed: &[f32]) {
        self.coefficients.clear();
        self.bounds.clear();
        self.proposed.clear();
        self.proposed.extend(proposed.iter().copied().map(f64::from));
        self.is_impossible = false;
        self.refused = None;
    }

    /// The next rows belong to a rule with this column of slack and this priority, or to a hard one.
    pub fn soften(&mut self, slack: Option<(usize, f32)>) {
        self.slack = slack.map(|(column, priority)| (column, f64::from(priority).sqrt().recip()));
    }
}

impl Rows for RowBuffer {
    fn push(&mut self, coefficients: &[f32], bound: f32) -> Result<()> {
        let checked = check_finite("the row", coefficients, self.proposed.len())
            .and_then(|()| check_finite("the bound", &[bound], 1));
        if let Err(error) = checked {
            self.refused.get_or_insert(error.clone());
            return Err(error);
        }
        let terms = coefficients.iter().zip(&self.proposed).map(|(slope, value)| f64::from(*slope) * value);
        let bound = f64::from(bound);
        let size: f64 = bound.abs() + terms.clone().map(f64::abs).sum::<f64>();
        let room = bound - self.margin - terms.sum::<f64>() - ROUNDING * size;
        let scaled = coefficients.iter().zip(&self.scale).map(|(slope, scale)| f64::from(*slope) * scale);
        let slack = self.slack.map_or(0.0, |(_, give)| give);
        let norm = (scaled.clone().map(|slope| slope * slope).sum::<f64>() + slack * slack).sqrt();
        if norm == 0.0 {
            self.is_impossible |= room < 0.0;
            return Ok(());
        }
        self.coefficients.extend(scaled.map(|slope| slope / norm));
        let first = self.coefficients.len();
        self.coefficients.resize(first + self.slacks, 0.0);
        if let Some((column, give)) = self.slack {
            self.coefficients[first + column] = -give / norm;
        }
        self.bounds.push(room / norm);
        Ok(())
    }
}
