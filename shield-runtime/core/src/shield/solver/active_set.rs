//! Several rows, exactly, where a few of them decide.

use super::{Program, dot};

/// By how much a constraint may fail, in units of its bound.
const TOLERANCE: f64 = 1e-9;
/// A normal of which no more than this is left beside those of the active set depends on them: within the box it says what they say.
const DEPENDENT: f64 = 1e-9;
/// How negative a multiplier may be by rounding, in units of the solution's length: what it can shorten the solution by.
const NEGATIVE: f64 = 1e-7;
/// Changes of the active set, after which the program is left to another solver.
const MOST_CHANGES: usize = 100;

/// The dual active-set method of Goldfarb and Idnani (1983) for the shortest vector of a polyhedron.
///
/// It begins at y = 0 with no constraint active and takes up the one that fails most. With the active normals N and the new normal g, the
/// least-squares solution r of Nᵀ r ≈ g splits g into Nᵀ r and a rest z; moving by −t z lowers the failure by t ‖z‖² and keeps the
/// active ones tight, while their multipliers fall by t r. A multiplier that would become negative leaves the active set before.
/// Throughout y = −Nᵀ λ with λ ≥ 0, so that the first y without a failure is the solution.
///
/// The normals are kept as Nᵀ = Q R with Q orthonormal to the last bits, so that rows that are almost parallel are told apart down to
/// [`DEPENDENT`]: of N Nᵀ, half of the digits would be lost.
#[derive(Debug, Default)]
pub(super) struct ActiveSet {
    active: Vec<usize>,
    multipliers: Vec<f64>,
    /// Qᵀ, a row per active constraint.
    basis: Vec<f64>,
    /// The upper triangle R, column by column.
    triangle: Vec<f64>,
    /// The last normal that was split: its part in each row of the basis,
    parts: Vec<f64>,
    /// its shares r of the active normals,
    shares: Vec<f64>,
    /// and its rest z.
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
        self.clear(y.len());
        y.fill(0.0);
        let mut changes = 0;
        while let Some(new) = constraints.worst(y) {
            if !self.take_up(constraints, new, y, &mut changes) {
                return false;
            }
        }
        self.place(constraints, y);
        constraints.worst(y).is_none() && self.multipliers.iter().all(|multiplier| *multiplier >= -NEGATIVE)
    }

    fn clear(&mut self, width: usize) {
        // No more can be active; reserved now, so that later programs allocate nothing.
        let most = width + 1;
        self.active.clear();
        self.active.reserve(most);
        for (buffer, length) in [
            (&mut self.multipliers, most),
            (&mut self.basis, most * width),
            (&mut self.triangle, most * (most + 1) / 2),
            (&mut self.parts, most),
            (&mut self.shares, most),
            (&mut self.rest, width),
        ] {
            buffer.clear();
            buffer.reserve(length);
        }
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
            if *changes > MOST_CHANGES {
                return false;
            }
            self.split(constraints, new);
            self.find_shares();
            let square = dot(&self.rest, &self.rest);
            let is_independent = square > DEPENDENT * DEPENDENT;
            let full = if is_independent { constraints.excess(new, y) / square } else { f64::INFINITY };
            let leaving = self.first_to_leave();
            let step = leaving.map_or(full, |(_, step)| step.min(full));
            if step == f64::INFINITY {
                return false;
            }
            if is_independent {
                y.iter_mut().zip(&self.rest).for_each(|(value, rest)| *value -= step * rest);
            }
            self.multipliers.iter_mut().zip(&self.shares).for_each(|(value, share)| *value -= step * share);
            multiplier += step;
            match leaving {
                Some((position, earlier)) if earlier < full => self.remove(constraints, position),
                _ => {
                    self.append_split();
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

    fn remove(&mut self, constraints: Constraints<'_>, position: usize) {
        self.active.remove(position);
        self.multipliers.remove(position);
        self.basis.truncate(position * constraints.0.dimensions());
        self.triangle.truncate(position * (position + 1) / 2);
        for later in position..self.active.len() {
            self.split(constraints, self.active[later]);
            self.append_split();
        }
    }

    /// Splits the normal of a constraint into its parts in the basis and a rest.
    fn split(&mut self, constraints: Constraints<'_>, index: usize) {
        let width = constraints.0.dimensions();
        self.rest.clear();
        self.rest.resize(width, 0.0);
        constraints.add(index, 1.0, &mut self.rest);
        self.parts.clear();
        self.parts.resize(self.basis.len() / width, 0.0);
        // The second time takes out what rounding has left of the basis in a short rest (Giraud et al. 2005: twice is enough).
        for _ in 0..2 {
            for (part, direction) in self.parts.iter_mut().zip(self.basis.chunks_exact(width)) {
                let more = dot(direction, &self.rest);
                self.rest.iter_mut().zip(direction).for_each(|(rest, value)| *rest -= more * value);
                *part += more;
            }
        }
    }

    /// Takes the normal that was split last into Q and R.
    fn append_split(&mut self) {
        let length = dot(&self.rest, &self.rest).sqrt();
        self.basis.extend(self.rest.iter().map(|value| value / length));
        self.triangle.extend_from_slice(&self.parts);
        self.triangle.push(length);
    }

    /// Solves R r = parts.
    fn find_shares(&mut self) {
        self.shares.clear();
        self.shares.extend_from_slice(&self.parts);
        for index in (0..self.shares.len()).rev() {
            let (above, diagonal) = column(&self.triangle, index);
            let share = self.shares[index] / diagonal;
            self.shares[..index].iter_mut().zip(above).for_each(|(value, entry)| *value -= share * entry);
            self.shares[index] = share;
        }
    }

    /// Once more, without what rounding has added up: y as the shortest that keeps the active ones tight, and the multipliers that belong to it.
    ///
    /// With y = Q c, the active ones are tight where Rᵀ c = b; and y = −Q R λ.
    fn place(&mut self, constraints: Constraints<'_>, y: &mut [f64]) {
        y.fill(0.0);
        self.parts.clear();
        for (position, index) in self.active.iter().enumerate() {
            let (above, diagonal) = column(&self.triangle, position);
            self.parts.push((constraints.bound(*index) - dot(above, &self.parts)) / diagonal);
        }
        for (part, direction) in self.parts.iter().zip(self.basis.chunks_exact(y.len())) {
            y.iter_mut().zip(direction).for_each(|(value, direction)| *value += part * direction);
        }
        self.find_shares();
        self.multipliers.clear();
        self.multipliers.extend(self.shares.iter().map(|share| -share));
    }
}

/// A column of a packed upper triangle: what lies above the diagonal, and the diagonal.
fn column(triangle: &[f64], index: usize) -> (&[f64], f64) {
    let start = index * (index + 1) / 2;
    (&triangle[start..start + index], triangle[start + index])
}
