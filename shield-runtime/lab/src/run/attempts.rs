//! What became of the attempts to get back to the start, and what was expected of them.

use std::path::Path;

use anyhow::{Context, Result};
use serde::{Deserialize, Serialize};
use shield_api::regular_file;

use super::accepted_risk::AcceptedRisk;
use crate::reliability::{Forecast, Reliability};
use shield_core::events::{AttemptOutcome, EpisodeEvent};
use shield_decisions::tables::{MetricsRow, Row as _};

/// An attempt that has an outcome.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RecordedAttempt {
    /// Environment steps before its end.
    pub step: u64,
    /// How it ended.
    pub outcome: AttemptOutcome,
    /// The mean of the success critic's estimates at its start; `None` without a critic, and where it failed before its first step.
    pub undo_probability: Option<f32>,
}

/// What is needed of a row of `metrics.csv`. Version 1.0.0 wrote neither of the optional columns.
#[derive(Deserialize)]
pub(super) struct RecordedEpisode {
    pub step: u64,
    pub hard_reset: u8,
    #[serde(default)]
    pub has_reset: u8,
    #[serde(default)]
    pub attempt: Option<AttemptOutcome>,
    #[serde(default)]
    undo_probability: Option<f32>,
}

/// The episodes of a run, in their order.
pub(super) fn read_episodes(run: &Path) -> Result<Vec<RecordedEpisode>> {
    let path = run.join(MetricsRow::FILE);
    let cannot = || format!("{} cannot be read", path.display());
    let file = regular_file::open(&path).with_context(cannot)?;
    let episodes: Result<_, _> = csv::Reader::from_reader(file).into_deserialize().collect();
    episodes.with_context(cannot)
}

/// The attempts of a run, in their order.
///
/// # Errors
/// `metrics.csv` cannot be read.
pub fn read_attempts(run: &Path) -> Result<Vec<RecordedAttempt>> {
    let attempt = |RecordedEpisode { step, attempt, undo_probability, .. }: RecordedEpisode| {
        attempt.map(|outcome| RecordedAttempt { step, outcome, undo_probability })
    };
    Ok(read_episodes(run)?.into_iter().filter_map(attempt).collect())
}

impl RecordedAttempt {
    /// The attempt that ended with this episode after so many steps, if one did.
    pub(super) fn of(step: u64, episode: &EpisodeEvent) -> Option<Self> {
        let undo_probability = episode.undo_probability;
        episode.attempt.map(|outcome| Self { step, outcome, undo_probability })
    }

    pub(super) fn has_failed(&self) -> bool {
        self.outcome == AttemptOutcome::Failed
    }
}

/// The later half of the attempts, the one in the middle included: what a critic that has learned is worth.
pub fn last_half(attempts: &[RecordedAttempt]) -> &[RecordedAttempt] {
    &attempts[attempts.len() / 2..]
}

/// What was expected of the attempts, against their outcomes.
pub fn reliability(attempts: &[RecordedAttempt]) -> Reliability {
    let forecast = |attempt: &RecordedAttempt| {
        Forecast::new(f64::from(attempt.undo_probability?), !attempt.has_failed())
    };
    attempts.iter().filter_map(forecast).collect()
}

/// The share of the attempts that failed; `None` without any.
pub(super) fn realised_risk(attempts: &[RecordedAttempt]) -> Option<f64> {
    let failed = attempts.iter().filter(|attempt| attempt.has_failed()).count();
    (!attempts.is_empty()).then(|| failed as f64 / attempts.len() as f64)
}

/// What the attempts of a run come to, as part of its summary. `None` of a run that did not count them.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct AttemptSummary {
    /// Attempts that reached the reset set.
    pub reset_successes: Option<u64>,
    /// Attempts that did not; forward episodes in which the environment terminated are among them.
    pub failed_attempts: Option<u64>,
    /// Share of the attempts that failed.
    pub realised_risk: Option<f64>,
    /// The same of the later half of the attempts.
    pub realised_risk_last_half: Option<f64>,
    /// The share of attempts that may fail, where the rule `undo-probability` has one.
    pub accepted_risk: Option<f64>,
    /// Mean squared difference between the success critic's estimate at the start of an attempt and its outcome.
    pub brier_score: Option<f64>,
    /// Expected calibration error of these estimates.
    pub calibration_error: Option<f64>,
    /// The same of the later half of the attempts.
    pub calibration_error_last_half: Option<f64>,
}

impl AttemptSummary {
    /// Of the attempts of so many steps.
    pub(super) fn of(attempts: &[RecordedAttempt], steps: u64, accepted: Option<AcceptedRisk>) -> Self {
        let failed = attempts.iter().filter(|attempt| attempt.has_failed()).count() as u64;
        let count = attempts.len() as u64;
        let (all, later) = (reliability(attempts), reliability(last_half(attempts)));
        Self {
            reset_successes: Some(count - failed),
            failed_attempts: Some(failed),
            realised_risk: realised_risk(attempts),
            realised_risk_last_half: realised_risk(last_half(attempts)),
            accepted_risk: accepted.and_then(|accepted| accepted.share(steps, count)),
            brier_score: all.brier_score(),
            calibration_error: all.calibration_error(),
            calibration_error_last_half: later.calibration_error(),
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use AttemptOutcome::{Failed, Succeeded};

    fn attempts(outcomes: &[(AttemptOutcome, Option<f32>)]) -> Vec<RecordedAttempt> {
        let attempt =
            |(index, (outcome, undo_probability)): (usize, &(AttemptOutcome, Option<f32>))| RecordedAttempt {
                step: 10 * index as u64,
                outcome: *outcome,
                undo_probability: *undo_probability,
            };
        outcomes.iter().enumerate().map(attempt).collect()
    }

    #[test]
    fn attempts_are_summed_up() {
        let attempts = attempts(&[
            (Failed, Some(1.0)),
            (Failed, None),
            (Succeeded, Some(0.5)),
            (Succeeded, Some(1.0)),
            (Failed, Some(0.5)),
        ]);
        let summary = AttemptSummary::of(&attempts, 100, Some(AcceptedRisk::Share(0.1)));
        assert_eq!(summary.reset_successes, Some(2));
        assert_eq!(summary.failed_attempts, Some(3));
        assert_eq!(summary.realised_risk, Some(0.6));
        // The last three.
        assert_eq!(summary.realised_risk_last_half, Some(1.0 / 3.0));
        assert_eq!(summary.accepted_risk, Some(0.1));
        assert_eq!(summary.brier_score, Some((1.0 + 0.25 + 0.25) / 4.0));
        assert_eq!(summary.calibration_error, Some(1.0 / 4.0));
        assert_eq!(summary.calibration_error_last_half, Some(0.0));
    }

    #[test]
    fn without_attempts_or_a_critic_there_is_nothing_to_compare() {
        let none = AttemptSummary::of(&[], 100, None);
        let expected = AttemptSummary {
            reset_successes: Some(0),
            failed_attempts: Some(0),
            ..AttemptSummary::default()
        };
        assert_eq!(none, expected);
        let blind = AttemptSummary::of(&attempts(&[(Succeeded, None)]), 100, None);
        assert_eq!(
            (blind.realised_risk, blind.brier_score, blind.calibration_error),
            (Some(0.0), None, None)
        );
    }

    #[test]
    fn attempts_are_read_from_new_tables_and_are_unknown_in_old_ones() {
        let folder = tempfile::tempdir().unwrap();
        let read = |text: &str| {
            std::fs::write(folder.path().join("metrics.csv"), text).unwrap();
            read_attempts(folder.path()).unwrap()
        };
        assert_eq!(read("step,hard_reset,has_reset\n10,0,0\n20,0,1\n"), []);
        let text = "step,hard_reset,undo_probability,attempt\n10,0,,\n20,0,0.75,succeeded\n30,1,,failed\n";
        let expected = [
            RecordedAttempt { step: 20, outcome: Succeeded, undo_probability: Some(0.75) },
            RecordedAttempt { step: 30, outcome: Failed, undo_probability: None },
        ];
        assert_eq!(read(text), expected);
    }
}
