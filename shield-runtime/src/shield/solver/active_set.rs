//! Several rows, exactly, where a few of them decide.

use super::{Program, dot};

/// By how much a constraint may fail, in units of its bound.
const TOLERANCE: f64 = 1e-9;
/// Below this square, what is left of a normal beside those of the active set is rounding.
const DEPENDENT: f64 = 1e-10;
/// Changes of the active set, after which the program is left to another solver.
const MOST_CHANGES: usize = 100;

/// The dual active-set method of Goldfarb and Idnani (1983) for the shortest vector of a polyhedron.
///
/// It begins at y = 0 with no constraint active and takes up the one that fails most. With the active normals N and the new normal g, the
/// least-squares solution r of Nᵀ r ≈ g splits g into Nᵀ r and a rest z; moving by −t z lowers the failure by t ‖z‖² and keeps the
/// active ones tight, while their multipliers fall by t r. A multiplier that would become negative leaves the active set before.
/// Throughout y = −Nᵀ λ with λ ≥ 0, so that the first y without a failure is the solution. What is nearly dependent is not decided here.
#[derive(Debug, Default)]
pub(super) struct ActiveSet {
    active: Vec<usize>,
    multipliers: Vec<f64>,
    /// Lower triangle of the Cholesky factor of N Nᵀ, row by row.
    factor: Vec<f64>,
    shares: Vec<f64>,
    rest: Vec<f64>,
}

/// A constraint by its number: first the rows, then an upper and a lower bound of each dimension.
#[derive(Clone, Copy)]
struct Constraints<'a>(Program<'a>);

impl Constraints<'_> {
    fn count(self) -> usize {
        self.0.bounds.len() + 2 * self.0.dimensions()
    }

    /// Dimension, sign and bound of a constraint of the box.
    fn side(self, index: usize) -> Option<(usize, f64, f64)> {
        let side = index.checked_sub(self.0.bounds.len())?;
        let dimension = side / 2;
        Some(match side % 2 {
            0 => (dimension, 1.0, self.0.upper[dimension]),
            _ => (dimension, -1.0, -self.0.lower[dimension]),
        })
    }

    fn bound(self, index: usize) -> f64 {
        self.side(index).map_or_else(|| self.0.bounds[index], |(_, _, bound)| bound)
    }

    /// By how much y fails it.
    fn excess(self, index: usize, y: &[f64]) -> f64 {
        match self.side(index) {
            Some((dimension, sign, bound)) => sign * y[dimension] - bound,
            None => dot(self.0.row(index), y) - self.0.bounds[index],
        }
    }

    fn product(self, one: usize, other: usize) -> f64 {
        match (self.side(one), self.side(other)) {
            (None, None) => dot(self.0.row(one), self.0.row(other)),
            (Some((dimension, sign, _)), None) => sign * self.0.row(other)[dimension],
            (None, Some((dimension, sign, _))) => sign * self.0.row(one)[dimension],
            (Some((left, one, _)), Some((right, other, _))) => {
                if left == right {
                    one * other
                } else {
                    0.0
                }
            }
        }
    }

    /// Adds a multiple of the normal.
    fn add(self, index: usize, factor: f64, target: &mut [f64]) {
        match self.side(index) {
            Some((dimension, sign, _)) => target[dimension] += factor * sign,
            None => {
                target.iter_mut().zip(self.0.row(index)).for_each(|(value, slope)| *value += factor * slope);
            }
        }
    }

    /// The one that y fails most, if it fails any.
    fn worst(self, y: &[f64]) -> Option<usize> {
        let excess = |index: usize| self.excess(index, y) - TOLERANCE * self.bound(index).abs().max(1.0);
        let failing =
            (0..self.count()).map(|index| (index, excess(index))).filter(|(_, excess)| *excess > 0.0);
        failing.max_by(|one, other| one.1.total_cmp(&other.1)).map(|(index, _)| index)
    }
}

impl ActiveSet {
    /// Writes the solution into `y`; `false` if it was not found.
    pub fn solve(&mut self, program: &Program<'_>, y: &mut [f64]) -> bool {
        let constraints = Constraints(*program);
        self.active.clear();
        self.multipliers.clear();
        // No more can be active; reserved now, so that later programs allocate nothing.
        let width = y.len();
        self.active.reserve(width + 1);
        self.multipliers.reserve(width + 1);
        self.shares.reserve(width + 1);
        self.factor.reserve((width + 1) * (width + 1));
        y.fill(0.0);
        let mut changes = 0;
        while let Some(new) = constraints.worst(y) {
            if !self.take_up(constraints, new, y, &mut changes) {
                return false;
            }
        }
        // Once more from the multipliers, without what rounding has added up.
        y.fill(0.0);
        for (index, multiplier) in self.active.iter().zip(&self.multipliers) {
            constraints.add(*index, -multiplier, y);
        }
        let is_tight = |index: &usize| {
            constraints.excess(*index, y).abs() <= 10.0 * TOLERANCE * constraints.bound(*index).abs().max(1.0)
        };
        constraints.worst(y).is_none() && self.active.iter().all(is_tight)
    }

    /// Moves y until the constraint `new` holds; `false` if that cannot be decided.
    fn take_up(
        &mut self,
        constraints: Constraints<'_>,
        new: usize,
        y: &mut [f64],
        changes: &mut usize,
    ) -> bool {
        let mut multiplier = 0.0;
        loop {
            *changes += 1;
            if *changes > MOST_CHANGES || !self.split(constraints, new, y.len()) {
                return false;
            }
            let square = dot(&self.rest, &self.rest);
            let full = if square > DEPENDENT { constraints.excess(new, y) / square } else { f64::INFINITY };
            let leaving = self.first_to_leave();
            let step = leaving.map_or(full, |(_, step)| step.min(full));
            if step == f64::INFINITY {
                return false;
            }
            if full < f64::INFINITY {
                y.iter_mut().zip(&self.rest).for_each(|(value, rest)| *value -= step * rest);
            }
            self.multipliers.iter_mut().zip(&self.shares).for_each(|(value, share)| *value -= step * share);
            multiplier += step;
            match leaving {
                Some((position, earlier)) if earlier < full => {
                    self.active.remove(position);
                    self.multipliers.remove(position);
                }
                _ => {
                    self.active.push(new);
                    self.multipliers.push(multiplier);
                    return true;
                }
            }
        }
    }

    /// The active constraint whose multiplier is the first to become 0, and the step at which it does.
    fn first_to_leave(&self) -> Option<(usize, f64)> {
        let ratios = self.multipliers.iter().zip(&self.shares).enumerate();
        let falling = ratios.filter(|(_, (_, share))| **share > 1e-12);
        falling
            .map(|(position, (multiplier, share))| (position, multiplier.max(0.0) / share))
            .min_by(|one, other| one.1.total_cmp(&other.1))
    }

    /// Splits the normal of `new` into shares of the active normals and a rest; `false` if these are dependent.
    fn split(&mut self, constraints: Constraints<'_>, new: usize, width: usize) -> bool {
        let size = self.active.len();
        self.factor.clear();
        self.factor.resize(size * size, 0.0);
        self.shares.clear();
        self.shares.extend(self.active.iter().map(|index| constraints.product(*index, new)));
        for row in 0..size {
            for column in 0..=row {
                let product = constraints.product(self.active[row], self.active[column]);
                let (above, left) = (&self.factor[column * size..], &self.factor[row * size..]);
                let rest = product - dot(&left[..column], &above[..column]);
                self.factor[row * size + column] = if row > column {
                    rest / self.factor[column * size + column]
                } else if rest > DEPENDENT {
                    rest.sqrt()
                } else {
                    return false;
                };
            }
        }
        for row in 0..size {
            let known = dot(&self.factor[row * size..row * size + row], &self.shares[..row]);
            self.shares[row] = (self.shares[row] - known) / self.factor[row * size + row];
        }
        for row in (0..size).rev() {
            let later = row + 1..size;
            let known: f64 = later.map(|below| self.factor[below * size + row] * self.shares[below]).sum();
            self.shares[row] = (self.shares[row] - known) / self.factor[row * size + row];
        }
        self.rest.clear();
        self.rest.resize(width, 0.0);
        constraints.add(new, 1.0, &mut self.rest);
        for (index, share) in self.active.iter().zip(&self.shares) {
            constraints.add(*index, -share, &mut self.rest);
        }
        true
    }
}
