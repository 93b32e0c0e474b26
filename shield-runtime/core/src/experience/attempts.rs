//! How attempts to reset ended, kept beside the transitions that led there.
//!
//! A transition is stored before the attempt that follows it has ended. So nothing is written back: a log says which transitions each
//! attempt covers and how it ended, and a transition's outcome is looked up when it is drawn.

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};

/// Entries of the log. With the least attempts, of one step, it goes back that many steps.
const MOST_ATTEMPTS: usize = 1 << 16;

/// One attempt to reset that has an outcome, by the numbers of its transitions.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Attempt {
    /// The forward step directly before it; `None` after a hard reset or another attempt.
    pub before: Option<u64>,
    /// Its first transition.
    pub first: u64,
    /// The one after its last.
    pub end: u64,
    /// The first that led into the reset set.
    pub reached: Option<u64>,
    /// Whether it succeeded.
    pub succeeded: bool,
    /// Whether it ended because the environment could not go on, rather than for lack of time.
    pub terminated: bool,
}

/// What a transition's attempt says about it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Outcome {
    /// 1 if the reset set was reached, else 0.
    pub value: f32,
    /// How much that counts, from 0 to 1.
    pub weight: f32,
    /// Attempts that ended since.
    pub age: u64,
}

impl Attempt {
    /// Whether its numbers fit together.
    fn is_possible(&self) -> bool {
        self.first <= self.end
            && self.before.is_none_or(|before| before < self.first)
            && self.reached.is_none_or(|reached| (self.first..self.end).contains(&reached))
    }

    /// The outcome of the transition `number`, one of this attempt's or the one before it.
    ///
    /// A failure for lack of time counts by the share of the attempt's time that was left: its last steps were perhaps close to success.
    fn outcome_of(&self, number: u64) -> Outcome {
        match (self.succeeded, self.reached) {
            (true, Some(reached)) if number > reached => Outcome::default(),
            (true, _) => Outcome { value: 1.0, weight: 1.0, age: 0 },
            (false, _) if self.terminated || number < self.first => {
                Outcome { weight: 1.0, ..Outcome::default() }
            }
            (false, _) => {
                let left = (self.end - number) as f32 / (self.end - self.first) as f32;
                Outcome { weight: left, ..Outcome::default() }
            }
        }
    }
}

/// The attempts of the transitions that are kept, the oldest first.
#[derive(Debug)]
pub(super) struct AttemptLog {
    attempts: VecDeque<Attempt>,
    /// All that ever ended.
    ended: u64,
}

impl AttemptLog {
    /// An empty log for a memory of `capacity` transitions. It never allocates again.
    pub fn new(capacity: usize) -> Self {
        Self { attempts: VecDeque::with_capacity(capacity.min(MOST_ATTEMPTS)), ended: 0 }
    }

    /// Adds an attempt. Those that it overlaps, which only a state can hold that was kept, give way: so the log is in order.
    pub fn push(&mut self, attempt: Attempt) {
        while self.attempts.back().is_some_and(|last| last.end > attempt.first) {
            self.attempts.pop_back();
        }
        if self.attempts.len() == self.attempts.capacity() {
            self.attempts.pop_front();
        }
        self.attempts.push_back(attempt);
        self.ended = self.ended.saturating_add(1);
    }

    /// How many attempts ever ended.
    pub fn ended(&self) -> u64 {
        self.ended
    }

    /// Forgets attempts none of whose transitions is kept.
    pub fn forget_before(&mut self, number: u64) {
        while self.attempts.front().is_some_and(|attempt| attempt.end <= number) {
            self.attempts.pop_front();
        }
    }

    /// Forgets attempts that have a transition of this number or a later one.
    pub fn forget_from(&mut self, number: u64) {
        while self.attempts.back().is_some_and(|attempt| attempt.end > number) {
            self.attempts.pop_back();
        }
    }

    /// The outcome of a transition; of weight 0 where it has none.
    pub fn outcome_of(&self, number: u64) -> Outcome {
        let index = self.attempts.partition_point(|attempt| attempt.end <= number);
        match self.attempts.get(index) {
            Some(attempt) if number >= attempt.first || attempt.before == Some(number) => {
                Outcome { age: (self.attempts.len() - 1 - index) as u64, ..attempt.outcome_of(number) }
            }
            _ => Outcome::default(),
        }
    }

    pub fn len(&self) -> usize {
        self.attempts.len()
    }

    pub fn get(&self, index: usize) -> &Attempt {
        &self.attempts[index]
    }

    pub fn to_vec(&self) -> Vec<Attempt> {
        self.attempts.iter().copied().collect()
    }

    /// Becomes a log of these attempts, the last of all that ended; `false` if there cannot be such attempts in such an order.
    pub fn restore(&mut self, attempts: &[Attempt], ended: u64) -> bool {
        let is_ordered = attempts.windows(2).all(|pair| pair[0].end <= pair[1].first);
        if !is_ordered || !attempts.iter().all(Attempt::is_possible) {
            return false;
        }
        self.attempts.clear();
        attempts.iter().for_each(|attempt| self.push(*attempt));
        self.ended = ended;
        true
    }

    /// Counts every number from `back` later on; attempts that began before it are forgotten.
    pub fn renumber(&mut self, back: u64) {
        self.attempts.retain(|attempt| attempt.first >= back);
        for attempt in &mut self.attempts {
            attempt.before = attempt.before.and_then(|number| number.checked_sub(back));
            attempt.reached = attempt.reached.map(|number| number - back);
            (attempt.first, attempt.end) = (attempt.first - back, attempt.end - back);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn attempt(before: Option<u64>, first: u64, end: u64, reached: Option<u64>) -> Attempt {
        Attempt { before, first, end, reached, succeeded: reached.is_some(), terminated: false }
    }

    fn outcomes(log: &AttemptLog, numbers: std::ops::Range<u64>) -> Vec<(f32, f32)> {
        numbers.map(|number| log.outcome_of(number)).map(|o| (o.value, o.weight)).collect()
    }

    #[test]
    fn the_step_before_an_attempt_and_its_own_have_its_outcome() {
        let mut log = AttemptLog::new(10);
        log.push(attempt(Some(2), 3, 5, Some(4)));
        // An abort was stored as number 8.
        log.push(attempt(Some(7), 9, 13, None));
        let (none, success) = ((0.0, 0.0), (1.0, 1.0));
        assert_eq!(outcomes(&log, 0..8), [none, none, success, success, success, none, none, (0.0, 1.0)]);
        assert_eq!(outcomes(&log, 8..14), [none, (0.0, 1.0), (0.0, 0.75), (0.0, 0.5), (0.0, 0.25), none]);
    }

    #[test]
    fn what_follows_the_first_entry_into_the_reset_set_has_no_outcome() {
        let mut log = AttemptLog::new(10);
        log.push(attempt(None, 0, 4, Some(1)));
        assert_eq!(outcomes(&log, 0..4), [(1.0, 1.0), (1.0, 1.0), (0.0, 0.0), (0.0, 0.0)]);
    }

    #[test]
    fn an_environment_that_ended_leaves_no_doubt() {
        let mut log = AttemptLog::new(10);
        log.push(Attempt { terminated: true, ..attempt(None, 0, 3, None) });
        // In a forward episode: an attempt of no steps.
        log.push(Attempt { terminated: true, ..attempt(Some(5), 6, 6, None) });
        assert_eq!(outcomes(&log, 0..3), [(0.0, 1.0); 3]);
        assert_eq!(outcomes(&log, 3..7), [(0.0, 0.0), (0.0, 0.0), (0.0, 1.0), (0.0, 0.0)]);
    }

    #[test]
    fn a_full_log_forgets_the_oldest() {
        let mut log = AttemptLog::new(2);
        (0..5).for_each(|number| log.push(attempt(None, number, number + 1, None)));
        assert_eq!(log.to_vec().iter().map(|attempt| attempt.first).collect::<Vec<_>>(), [3, 4]);
        log.forget_before(4);
        assert_eq!(log.len(), 1);
        log.renumber(4);
        assert_eq!(log.get(0).first, 0);
    }
}
