//! How many steps an attempt may take, where that follows from the attempts before it.

use serde::{Deserialize, Serialize};

/// Before any attempt has succeeded, so many steps, or as many as there are to be undone.
const FIRST: u64 = 200;
/// Fewer are never granted: below, the noise of exploration decides.
const LEAST: u64 = 50;
/// The last successes that count: an agent that learns becomes faster.
const SUCCESSES: usize = 20;
/// Of these, one in ten may have been slower than what is measured: a single straggler says little.
const SLOWEST: usize = 10;
/// The multiple of their length that is granted.
const MARGIN: u64 = 3;
/// A time-out gives the next attempt half as many steps more, so that no way back stays out of reach.
const GROWTH: f64 = 1.5;

/// What the lengths of attempts tell of the next one.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
pub(super) struct AttemptLengths {
    /// Of the last attempts that succeeded, in a ring.
    successes: [u32; SUCCESSES],
    succeeded: u64,
    /// Attempts in a row that ran out of time.
    timed_out: u32,
    /// Steps of the last forward episode.
    to_undo: u64,
    /// What the successes come to; 0 before the first.
    usual: u64,
}

impl AttemptLengths {
    /// A forward episode of so many steps ended.
    pub fn note_forward(&mut self, length: u64) {
        self.to_undo = length;
    }

    /// An attempt of so many steps succeeded.
    pub fn note_success(&mut self, length: u64) {
        self.successes[self.succeeded as usize % SUCCESSES] = u32::try_from(length).unwrap_or(u32::MAX);
        self.succeeded += 1;
        self.timed_out = 0;
        let known = self.succeeded.min(SUCCESSES as u64) as usize;
        let mut sorted = self.successes;
        sorted[..known].sort_unstable();
        let slow = sorted[known - 1 - known / SLOWEST];
        self.usual = (MARGIN * u64::from(slow)).max(LEAST);
    }

    /// An attempt ran out of time.
    pub fn note_time_out(&mut self) {
        self.timed_out = self.timed_out.saturating_add(1);
    }

    /// What the next attempt is granted, at most `most`.
    pub fn granted(&self, most: u64) -> u64 {
        let usual = if self.usual > 0 { self.usual } else { FIRST.max(self.to_undo) };
        let grown = usual as f64 * GROWTH.powi(self.timed_out.min(64) as i32);
        (grown as u64).min(most)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn after(successes: &[u64]) -> AttemptLengths {
        let mut lengths = AttemptLengths::default();
        successes.iter().for_each(|length| lengths.note_success(*length));
        lengths
    }

    #[test]
    fn before_the_first_success_there_is_time_to_undo_as_much_as_was_done() {
        let mut lengths = AttemptLengths::default();
        lengths.note_forward(30);
        assert_eq!([1_000, 120].map(|most| lengths.granted(most)), [200, 120]);
        lengths.note_forward(800);
        assert_eq!(lengths.granted(1_000), 800);
    }

    #[test]
    fn successes_shorten_the_next_attempt_and_a_straggler_does_not_lengthen_it() {
        assert_eq!(after(&[40]).granted(1_000), 120);
        assert_eq!(after(&[2; 30]).granted(1_000), 50);
        let straggling = [[40; 9].as_slice(), &[300], &[40; 9]].concat();
        assert_eq!(after(&straggling).granted(1_000), 120);
        assert_eq!(after(&[straggling.as_slice(), &[300, 300]].concat()).granted(1_000), 900);
    }

    #[test]
    fn old_successes_are_forgotten() {
        let slow_then_fast = [[200; 20].as_slice(), &[20; 20]].concat();
        assert_eq!(after(&slow_then_fast).granted(1_000), 60);
    }

    #[test]
    fn each_time_out_grants_more_until_an_attempt_succeeds() {
        let mut lengths = after(&[20]);
        let granted: Vec<u64> = (0..9)
            .map(|_| {
                lengths.note_time_out();
                lengths.granted(1_000)
            })
            .collect();
        assert_eq!(granted, [90, 135, 202, 303, 455, 683, 1_000, 1_000, 1_000]);
        lengths.note_success(20);
        assert_eq!(lengths.granted(1_000), 60);
        lengths.timed_out = u32::MAX;
        assert_eq!(lengths.granted(1_000), 1_000);
    }
}
