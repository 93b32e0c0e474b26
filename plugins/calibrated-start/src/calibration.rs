//! How near to a start is near enough: units from the experience, a radius from the starts.

use shield_api::ResetSignal;

/// A dimension whose spread is less than this share of its largest value is constant: f32 resolves 1.2e-7 of a value.
const RESOLUTION: f64 = 1e-6;
/// One value in so many may lie far out at either end without moving the spread: a simulation that explodes.
const OUTLIERS: usize = 128;
/// A single dimension may lie so many times as far out as all of them on average.
const LARGEST_OVER_MEAN: f64 = 2.0;
/// After so many dimensions a start that is farther than another is given up.
const CHUNK: usize = 16;
/// The share of the experience that lies within the radius and the margin, where the reward is at least 0.05.
const WITHIN_MARGIN: f64 = 0.95;

/// Observations, one after another.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rows<'a> {
    values: &'a [f32],
    dimensions: usize,
}

impl<'a> Rows<'a> {
    pub(crate) fn new(values: &'a [f32], dimensions: usize) -> Self {
        Self { values, dimensions }
    }

    pub(crate) fn len(self) -> usize {
        self.values.len() / self.dimensions
    }

    pub(crate) fn is_empty(self) -> bool {
        self.values.is_empty()
    }

    pub(crate) fn values(self) -> &'a [f32] {
        self.values
    }

    fn iter(self) -> impl Iterator<Item = &'a [f32]> + Clone {
        self.values.chunks_exact(self.dimensions)
    }

    fn column(self, dimension: usize) -> impl Iterator<Item = f64> + Clone {
        self.iter().map(move |row| f64::from(row[dimension]))
    }
}

/// What is asked of the reset set.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Aims {
    pub(crate) coverage: f64,
    pub(crate) least_radius: f64,
}

/// How differences in one dimension count.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Scale {
    /// 1 / spread; 0 where the dimension never varied.
    pub(crate) per_unit: f64,
    /// A larger difference puts a state outside the reset set: finite only where the dimension never varied.
    pub(crate) tolerance: f64,
}

/// The reset set and the reward around it.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Calibration {
    pub(crate) scales: Vec<Scale>,
    pub(crate) radius: f64,
    /// How far beyond the radius the reward has fallen to 0.05.
    pub(crate) margin: f64,
    /// The share of starts that lie inside if they are left out; none where there is one start.
    pub(crate) starts_inside: Option<f64>,
    /// The share of the experience that lies inside.
    pub(crate) experience_inside: Option<f64>,
    /// Room for one dimension, or one distance per observation.
    scratch: Vec<f64>,
}

impl Calibration {
    pub(crate) fn new(dimensions: usize) -> Self {
        let scales = vec![Scale { per_unit: 0.0, tolerance: 0.0 }; dimensions];
        Self {
            scales,
            radius: 0.0,
            margin: 1.0,
            starts_inside: None,
            experience_inside: None,
            scratch: Vec::with_capacity(512),
        }
    }

    /// How many dimensions have a spread.
    pub(crate) fn dimensions(&self) -> usize {
        self.scales.iter().filter(|scale| scale.per_unit > 0.0).count()
    }

    /// Concludes anew from everything that was seen. Both may hold up to 512 observations without an allocation.
    pub(crate) fn renew(&mut self, starts: Rows<'_>, samples: Rows<'_>, aims: Aims) {
        let mut scratch = std::mem::take(&mut self.scratch);
        for dimension in 0..self.scales.len() {
            self.scales[dimension] = scale(starts, samples, dimension, &mut scratch);
        }
        let own = self.distances_of_starts(starts, &mut scratch);
        let needed = own.and_then(|distances| conformal_quantile(distances, aims.coverage)).unwrap_or(0.0);

        scratch.clear();
        scratch.extend(samples.iter().map(|sample| self.distance(starts, sample, None)));
        scratch.sort_unstable_by(f64::total_cmp);
        self.radius = needed.max(aims.least_radius.min(reach(&scratch, 1.0 - aims.coverage)));
        self.experience_inside = share_within(&scratch, self.radius);
        let far = quantile(&scratch, WITHIN_MARGIN).unwrap_or(0.0);
        let margin = (far - self.radius).max(self.radius);
        self.margin = if margin > 0.0 { margin } else { 1.0 };

        let own = self.distances_of_starts(starts, &mut scratch);
        self.starts_inside = own.and_then(|distances| share_within(distances, self.radius));
        self.scratch = scratch;
    }

    /// Of each start the distance to the nearest other one, sorted; none where there is no other.
    fn distances_of_starts<'s>(&self, starts: Rows<'_>, scratch: &'s mut Vec<f64>) -> Option<&'s [f64]> {
        if starts.len() < 2 {
            return None;
        }
        scratch.clear();
        let distances =
            starts.iter().enumerate().map(|(index, start)| self.distance(starts, start, Some(index)));
        scratch.extend(distances);
        scratch.sort_unstable_by(f64::total_cmp);
        Some(scratch)
    }

    /// The distance to the nearest start, in units of the spread: the larger of the root mean square over the dimensions, and half of the
    /// largest difference. A mean alone would forgive one dimension of a hundred anything.
    fn distance(&self, starts: Rows<'_>, observation: &[f32], left_out: Option<usize>) -> f64 {
        let share = 1.0 / self.dimensions().max(1) as f64;
        let mut nearest = f64::INFINITY;
        for (index, start) in starts.iter().enumerate() {
            if Some(index) == left_out {
                continue;
            }
            let (mut sum, mut largest) = (0.0, 0.0f64);
            let parts = self.scales.chunks(CHUNK).zip(start.chunks(CHUNK)).zip(observation.chunks(CHUNK));
            let is_nearer = parts.into_iter().all(|((scales, start), observation)| {
                for ((scale, start), value) in scales.iter().zip(start).zip(observation) {
                    let units = (f64::from(*value) - f64::from(*start)) * scale.per_unit;
                    sum += units * units;
                    largest = largest.max(units * units);
                }
                // Both only grow: what is no nearer by now will not be.
                (sum * share).max(largest / (LARGEST_OVER_MEAN * LARGEST_OVER_MEAN)) < nearest
            });
            if is_nearer {
                nearest = (sum * share).max(largest / (LARGEST_OVER_MEAN * LARGEST_OVER_MEAN));
            }
        }
        nearest.sqrt()
    }

    /// Whether a dimension that never varied, has now.
    fn is_new(&self, starts: Rows<'_>, observation: &[f32]) -> bool {
        starts.iter().take(1).any(|start| {
            let differences =
                start.iter().zip(observation).map(|(a, b)| (f64::from(*a) - f64::from(*b)).abs());
            self.scales.iter().zip(differences).any(|(scale, difference)| difference > scale.tolerance)
        })
    }

    /// 1 inside, else 1 − tanh²(artanh(√0.95) · beyond / margin): the tolerance of `dm_control`, as the robots' reset rewards have it.
    pub(crate) fn judge(&self, starts: Rows<'_>, observation: &[f32]) -> ResetSignal {
        let distance = self.distance(starts, observation, None);
        let is_new = self.is_new(starts, observation);
        // What never varied has no unit: it counts as one margin.
        let beyond = (distance - self.radius).max(0.0) + if is_new { self.margin } else { 0.0 };
        let reward = 1.0 - (0.95f64.sqrt().atanh() * beyond / self.margin).tanh().powi(2);
        ResetSignal { reward: reward as f32, in_reset_set: distance <= self.radius && !is_new }
    }
}

/// The spread of one dimension: the larger of those in the experience and among the starts.
fn scale(starts: Rows<'_>, samples: Rows<'_>, dimension: usize, scratch: &mut Vec<f64>) -> Scale {
    let of_starts = deviation(starts.column(dimension));
    scratch.clear();
    scratch.extend(samples.column(dimension));
    scratch.sort_unstable_by(f64::total_cmp);
    let spread = robust_deviation(scratch).max(of_starts);
    let ends = starts.column(dimension).chain(without_outliers(scratch).into_iter().flatten());
    let constant = RESOLUTION * ends.fold(0.0, |largest: f64, value| largest.max(value.abs()));
    if spread > constant {
        return Scale { per_unit: 1.0 / spread, tolerance: f64::MAX };
    }
    let first = starts.column(dimension).next().unwrap_or(0.0);
    let seen = starts.column(dimension).chain(samples.column(dimension));
    let farthest = seen.fold(0.0, |farthest: f64, value| farthest.max((value - first).abs()));
    Scale { per_unit: 0.0, tolerance: constant + farthest }
}

/// Root mean square deviation from the mean; 0 of nothing.
fn deviation(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let count = values.clone().count().max(1) as f64;
    let mean = values.clone().sum::<f64>() / count;
    (values.map(|value| (value - mean) * (value - mean)).sum::<f64>() / count).sqrt()
}

/// The deviation of sorted values, with the outermost taken for the next ones. Where that leaves nothing, as of a contact that is
/// rare, it is the plain one.
fn robust_deviation(sorted: &[f64]) -> f64 {
    let Some([low, high]) = without_outliers(sorted) else { return 0.0 };
    let clipped = deviation(sorted.iter().map(|value| value.clamp(low, high)));
    if clipped > 0.0 { clipped } else { deviation(sorted.iter().copied()) }
}

/// The ends of sorted values but for the outermost.
fn without_outliers(sorted: &[f64]) -> Option<[f64; 2]> {
    let outliers = sorted.len() / OUTLIERS;
    Some([*sorted.get(outliers)?, *sorted.iter().nth_back(outliers)?])
}

/// Of n + 1 distances that come in any order, the last lies within this one with the probability `coverage` (conformal prediction). None
/// where n are too few to say so.
fn conformal_quantile(sorted: &[f64], coverage: f64) -> Option<f64> {
    let rank = ((sorted.len() + 1) as f64 * coverage).ceil() as usize;
    sorted.get(rank.checked_sub(1)?).copied()
}

/// The largest of the distances within which no more than `share` of them lie.
fn reach(sorted: &[f64], share: f64) -> f64 {
    let allowed = (sorted.len() as f64 * share).floor() as usize;
    let Some(excluded) = sorted.get(allowed) else { return sorted.last().copied().unwrap_or(0.0) };
    let within = sorted.partition_point(|distance| distance < excluded);
    within.checked_sub(1).map_or(0.0, |last| sorted[last])
}

fn quantile(sorted: &[f64], share: f64) -> Option<f64> {
    let rank = (sorted.len() as f64 * share).ceil() as usize;
    sorted.get(rank.saturating_sub(1)).copied()
}

fn share_within(sorted: &[f64], radius: f64) -> Option<f64> {
    let within = sorted.partition_point(|distance| *distance <= radius);
    (!sorted.is_empty()).then(|| within as f64 / sorted.len() as f64)
}
