//! The deadline of a decision.

use std::time::{Duration, Instant};

/// Measures one decision with a monotonic clock; without a limit it does not look at the clock at all.
#[derive(Debug, Clone, Copy)]
pub(super) struct Clock(Option<(Instant, Duration)>);

impl Clock {
    pub fn start(limit: Option<Duration>) -> Self {
        Self(limit.map(|limit| (Instant::now(), limit)))
    }

    pub fn is_late(&self) -> bool {
        self.0.is_some_and(|(start, limit)| start.elapsed() > limit)
    }
}
