//! The attempts of a run while it goes on.

use std::path::Path;

use anyhow::Result;

use super::{
    accepted_risk::AcceptedRisk,
    attempts::{AttemptSummary, RecordedAttempt, read_attempts},
};
use shield_core::events::EpisodeEvent;

/// The attempts so far. A checkpoint does not hold them: a run that goes on reads them back from its table.
#[derive(Debug, Default)]
pub(super) struct AttemptLog {
    attempts: Vec<RecordedAttempt>,
    failed: u64,
    accepted: Option<AcceptedRisk>,
}

impl AttemptLog {
    /// Of a run that begins.
    pub fn new(accepted: Option<AcceptedRisk>) -> Self {
        Self { accepted, ..Self::default() }
    }

    /// Goes on from the table of the run, cut back to its checkpoint.
    pub fn read_back(&mut self, run: &Path) -> Result<()> {
        self.attempts = read_attempts(run)?;
        self.failed = self.attempts.iter().filter(|attempt| attempt.has_failed()).count() as u64;
        Ok(())
    }

    /// Takes note of an episode that ended after so many steps. If an attempt ended with it, returns what is to be shown: counts, risk
    /// and forecast.
    pub fn note(&mut self, step: u64, episode: &EpisodeEvent) -> Vec<(&'static str, f64)> {
        let Some(attempt) = RecordedAttempt::of(step, episode) else { return Vec::new() };
        self.attempts.push(attempt);
        self.failed += u64::from(attempt.has_failed());
        let (count, failed) = (self.attempts.len() as u64, self.failed);
        let mut figures = vec![
            ("counts/reset_successes", (count - failed) as f64),
            ("risk/realised", failed as f64 / count as f64),
        ];
        let accepted = self.accepted.and_then(|accepted| accepted.share(step, count));
        figures.extend(accepted.map(|accepted| ("risk/accepted", accepted)));
        let expected = attempt.undo_probability.map(f64::from);
        figures.extend(expected.map(|expected| ("reset/undo_probability", expected)));
        figures
    }

    /// What they come to after so many steps.
    pub fn summary(&self, steps: u64) -> AttemptSummary {
        AttemptSummary::of(&self.attempts, steps, self.accepted)
    }
}
