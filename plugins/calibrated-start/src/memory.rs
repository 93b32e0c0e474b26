//! What was seen: the first starts, and a thinned record of the first steps.

use crate::calibration::Rows;

/// The most observations of the experience that are kept.
const MOST_SAMPLES: u64 = 512;

/// The first starts, and every so-many-th observation of the first steps. Its room is reserved when it is made.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Memory {
    dimensions: usize,
    most_starts: usize,
    most_steps: u64,
    starts: Vec<f32>,
    samples: Vec<f32>,
    steps: u64,
}

impl Memory {
    pub(crate) fn new(dimensions: usize, most_starts: usize, most_steps: u64) -> Self {
        let most_samples = most_steps.min(MOST_SAMPLES) as usize;
        Self {
            dimensions,
            most_starts,
            most_steps,
            starts: Vec::with_capacity(dimensions * most_starts),
            samples: Vec::with_capacity(dimensions * most_samples),
            steps: 0,
        }
    }

    pub(crate) fn starts(&self) -> Rows<'_> {
        Rows::new(&self.starts, self.dimensions)
    }

    pub(crate) fn samples(&self) -> Rows<'_> {
        Rows::new(&self.samples, self.dimensions)
    }

    pub(crate) fn steps(&self) -> u64 {
        self.steps
    }

    /// Keeps a start if there is room. Returns whether it was kept.
    pub(crate) fn start(&mut self, observation: &[f32]) -> bool {
        let has_room = self.starts().len() < self.most_starts;
        if has_room {
            self.starts.extend_from_slice(observation);
        }
        has_room
    }

    /// Counts a step, and keeps it if it is one of those that are kept. Returns whether the spread is due to be taken
    /// again: at every power of two, and at the last step that counts.
    pub(crate) fn experience(&mut self, observation: &[f32]) -> bool {
        if self.steps == self.most_steps {
            return false;
        }
        if self.steps.is_multiple_of(self.stride()) {
            self.samples.extend_from_slice(observation);
        }
        self.steps += 1;
        self.steps.is_power_of_two() || self.steps == self.most_steps
    }

    fn stride(&self) -> u64 {
        self.most_steps.div_ceil(MOST_SAMPLES)
    }

    /// How many samples so many steps leave behind.
    fn samples_after(&self, steps: u64) -> usize {
        steps.div_ceil(self.stride()) as usize
    }

    /// Whether nothing that comes will be kept.
    pub(crate) fn is_complete(&self) -> bool {
        self.starts().len() == self.most_starts && self.steps == self.most_steps
    }

    /// Once everything was seen, the calibration is final and needs no samples.
    pub(crate) fn forget_samples_if_complete(&mut self) {
        if self.is_complete() {
            self.samples = Vec::new();
        }
    }

    /// A memory with the same bounds and another content, if it is one that this could have.
    pub(crate) fn with(&self, starts: &[f32], samples: &[f32], steps: u64, is_due: bool) -> Option<Self> {
        let mut other = Self::new(self.dimensions, self.most_starts, self.most_steps);
        let starts_fit = starts.len() <= self.dimensions * self.most_starts && steps <= self.most_steps;
        let is_evaluated = !starts.is_empty() || (steps == 0 && !is_due);
        if !starts_fit || !is_evaluated || !starts.len().is_multiple_of(self.dimensions) {
            return None;
        }
        other.starts.extend_from_slice(starts);
        other.steps = steps;
        let kept = if other.is_complete() && !is_due { 0 } else { other.samples_after(steps) };
        if samples.len() != kept * self.dimensions {
            return None;
        }
        other.samples.extend_from_slice(samples);
        if !is_due {
            other.forget_samples_if_complete();
        }
        Some(other)
    }
}
