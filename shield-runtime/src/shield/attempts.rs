//! How the reset agent tries, and when it has given up.

use crate::settings::{BetweenAttempts, ResetTest};

/// How reset episodes go.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ResetSettings {
    /// Failed reset episodes in a row after which a hard reset is needed; `None`: never.
    pub attempts: Option<u32>,
    /// Steps after which a reset episode is over.
    pub episode_length: u64,
    /// Whether one ends as soon as the reset set is reached.
    pub stop_on_reset: bool,
    /// Which of its states count.
    pub test: ResetTest,
    /// What lies between two attempts.
    pub between_attempts: BetweenAttempts,
    /// Whether the rules judge the reset agent's exploratory actions; a rejected one gives way to its greedy one.
    pub shield_exploration: bool,
}

impl Default for ResetSettings {
    fn default() -> Self {
        Self {
            attempts: Some(1),
            episode_length: 500,
            stop_on_reset: true,
            test: ResetTest::default(),
            between_attempts: BetweenAttempts::default(),
            shield_exploration: false,
        }
    }
}

/// Counts failed attempts to reset, in a row.
#[derive(Debug, Clone, Copy)]
pub struct Attempts {
    limit: Option<u32>,
    failed: u32,
}

impl Attempts {
    /// A hard reset is needed after `limit` failures in a row; never, if there is no limit.
    pub fn new(limit: Option<u32>) -> Self {
        Self { limit, failed: 0 }
    }

    /// Failed attempts since the last success or hard reset.
    pub fn failed(&self) -> u32 {
        self.failed
    }

    /// Continues a count.
    pub fn restore(&mut self, failed: u32) {
        self.failed = failed;
    }

    /// Counts an attempt; returns whether a hard reset is needed now.
    pub fn record(&mut self, has_reset: bool) -> bool {
        self.failed = if has_reset { 0 } else { self.failed + 1 };
        self.limit.is_some_and(|limit| self.failed >= limit)
    }

    /// A hard reset was made.
    pub fn clear(&mut self) {
        self.failed = 0;
    }
}
