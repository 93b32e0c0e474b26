//! When the reset agent has given up.

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
