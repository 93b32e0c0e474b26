//! The steps around the starts of failed attempts, kept apart: what teaches where the way back ends must neither be diluted nor evicted.

use serde::{Deserialize, Serialize};

use super::undo::Fate;

/// Steps before and after the start of a failed attempt.
pub(super) const WINDOW: u64 = 20;

/// How many transitions are kept: those of the last 200 failures at least.
const CAPACITY: usize = 200 * 2 * WINDOW as usize;

/// A transition by its number, and what its attempt says about it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct Label {
    pub number: u64,
    /// Attempts that had ended until then.
    pub ended: u64,
    pub fate: f32,
    pub outcome: f32,
    pub weight: f32,
}

/// Copies of transitions, the oldest overwritten.
#[derive(Debug)]
pub(super) struct Failures {
    /// Observation, action and next observation, one after the other.
    rows: Vec<f32>,
    labels: Vec<Label>,
    capacity: usize,
    width: usize,
    /// Where the next one goes: behind the others, or over the oldest.
    next: usize,
}

/// What is kept of [`Failures`].
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct FailuresState {
    pub rows: Vec<f32>,
    pub labels: Vec<Label>,
    pub next: usize,
}

impl Label {
    fn is_possible(&self) -> bool {
        let is_share = |value: f32| (0.0..=1.0).contains(&value);
        Fate::is_executed(self.fate) && is_share(self.outcome) && is_share(self.weight)
    }
}

impl Failures {
    /// How many are kept beside a memory of `capacity` transitions.
    pub fn most(capacity: usize) -> usize {
        capacity.min(CAPACITY)
    }

    /// Room for transitions of `width` numbers, of a memory of `capacity` transitions.
    pub fn new(capacity: usize, width: usize) -> Self {
        let capacity = Self::most(capacity);
        Self {
            rows: Vec::with_capacity(capacity * width),
            labels: Vec::with_capacity(capacity),
            capacity,
            width,
            next: 0,
        }
    }

    pub fn len(&self) -> usize {
        self.labels.len()
    }

    /// Makes place for one more transition, over the oldest one where it is full; its numbers are to be written there.
    pub fn place(&mut self, label: Label) -> &mut [f32] {
        let at = if self.labels.len() < self.capacity { self.labels.len() } else { self.next };
        if at == self.labels.len() {
            self.labels.push(label);
            self.rows.resize(self.labels.len() * self.width, 0.0);
        } else {
            self.labels[at] = label;
        }
        self.next = (self.next + 1) % self.capacity;
        &mut self.rows[at * self.width..(at + 1) * self.width]
    }

    pub fn get(&self, index: usize) -> (&[f32], Label) {
        (&self.rows[index * self.width..(index + 1) * self.width], self.labels[index])
    }

    pub fn save(&self) -> FailuresState {
        FailuresState { rows: self.rows.clone(), labels: self.labels.clone(), next: self.next }
    }

    /// Becomes what was saved; `false` if that belongs to other spaces, or cannot be. Of more than there is room for, the newest stay.
    pub fn restore(&mut self, state: &FailuresState) -> bool {
        let FailuresState { rows, labels, next } = state;
        let count = labels.len();
        let is_possible = rows.len() == count * self.width
            && *next <= count
            && rows.iter().all(|value| value.is_finite())
            && labels.iter().all(Label::is_possible);
        if !is_possible {
            return false;
        }
        self.rows.clear();
        self.labels.clear();
        // In as much room, each stays in its place: batches are drawn by places.
        let is_alike = count == self.capacity;
        let oldest = if is_alike || *next == count { 0 } else { *next };
        for index in (oldest..count).chain(0..oldest).skip(count.saturating_sub(self.capacity)) {
            self.labels.push(labels[index]);
            self.rows.extend_from_slice(&rows[index * self.width..(index + 1) * self.width]);
        }
        self.next = if is_alike { *next } else { self.labels.len() } % self.capacity;
        true
    }

    /// Counts every number from `back` on. What is older stays, as if it were number 0.
    pub fn renumber(&mut self, back: u64) {
        self.labels.iter_mut().for_each(|label| label.number = label.number.saturating_sub(back));
    }
}
