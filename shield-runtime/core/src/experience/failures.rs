//! The steps around the starts of failed attempts, kept apart: what teaches where the way back ends must neither be diluted nor evicted.

use serde::{Deserialize, Serialize};

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
    pushed: u64,
}

/// What is kept of [`Failures`].
#[derive(Debug, Clone, Serialize, Deserialize)]
pub(super) struct FailuresState {
    rows: Vec<f32>,
    labels: Vec<Label>,
    pushed: u64,
}

impl Failures {
    /// Room for transitions of `width` numbers, of a memory of `capacity` transitions.
    pub fn new(capacity: usize, width: usize) -> Self {
        let capacity = capacity.min(CAPACITY);
        Self {
            rows: Vec::with_capacity(capacity * width),
            labels: Vec::with_capacity(capacity),
            capacity,
            width,
            pushed: 0,
        }
    }

    pub fn len(&self) -> usize {
        self.labels.len()
    }

    pub fn push(&mut self, parts: [&[f32]; 3], label: Label) {
        let slot = (self.pushed % self.capacity as u64) as usize;
        if slot < self.labels.len() {
            self.labels[slot] = label;
            let mut at = slot * self.width;
            for part in parts {
                self.rows[at..at + part.len()].copy_from_slice(part);
                at += part.len();
            }
        } else {
            self.labels.push(label);
            parts.iter().for_each(|part| self.rows.extend_from_slice(part));
        }
        self.pushed += 1;
    }

    pub fn get(&self, index: usize) -> (&[f32], Label) {
        (&self.rows[index * self.width..(index + 1) * self.width], self.labels[index])
    }

    pub fn save(&self) -> FailuresState {
        FailuresState { rows: self.rows.clone(), labels: self.labels.clone(), pushed: self.pushed }
    }

    /// Becomes what was saved; `false` if that belongs to other spaces. What there is no room for is left out.
    pub fn restore(&mut self, state: &FailuresState) -> bool {
        let FailuresState { rows, labels, pushed } = state;
        if rows.len() != labels.len() * self.width {
            return false;
        }
        let count = labels.len().min(self.capacity);
        self.rows.clear();
        self.rows.extend_from_slice(&rows[..count * self.width]);
        self.labels.clear();
        self.labels.extend_from_slice(&labels[..count]);
        self.pushed = *pushed;
        true
    }

    /// Counts every number from `back` on. What is older stays, as if it were number 0.
    pub fn renumber(&mut self, back: u64) {
        self.labels.iter_mut().for_each(|label| label.number = label.number.saturating_sub(back));
    }
}
