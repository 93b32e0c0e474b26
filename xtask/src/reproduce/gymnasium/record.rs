//! What `train.py` wrote of one environment, and what it says of the target.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result};
use serde::Deserialize;

use crate::reproduce::record::Spread;

/// The shield works where the task has at least this share of the steps,
const FORWARD: f64 = 0.6;
/// and at most this part of its episodes ends in a hard reset.
const HARD_RESETS: f64 = 0.2;
/// Else it says why by this step.
const IN_TIME: u64 = 2_000;

/// The trainings in one environment.
#[derive(Debug, Deserialize)]
pub struct Record {
    pub steps: u64,
    pub runs: Vec<Run>,
}

/// One training.
#[derive(Debug, Deserialize)]
pub struct Run {
    pub seed: u64,
    pub hard_resets: u64,
    /// Of greedy episodes at the end, with the shield where there was one.
    #[serde(rename = "return")]
    pub gain: f64,
    /// What only a shielded one has.
    #[serde(flatten)]
    pub shielded: Option<Shielded>,
}

/// What the shield did in a training.
#[derive(Debug, Deserialize)]
pub struct Shielded {
    pub steps: u64,
    pub forward_steps: u64,
    pub episodes: u64,
    pub attempts: u64,
    pub reset_successes: u64,
    pub return_without_shield: f64,
    pub findings: Vec<Finding>,
}

/// A warning.
#[derive(Debug, Deserialize)]
pub struct Finding {
    pub name: String,
    pub step: u64,
    pub text: String,
}

/// Whether a training meets the target.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// It works.
    Works,
    /// It does not, and said so at this step.
    SaysWhy(u64),
    /// It does not, and said so too late or not at all.
    Missed,
}

impl Record {
    /// Reads a file that `train.py` wrote.
    ///
    /// # Errors
    /// It cannot be read, or is something else.
    pub fn read(path: &Path) -> Result<Self> {
        let text = fs::read_to_string(path).with_context(|| format!("{} cannot be read", path.display()))?;
        serde_json::from_str(&text)
            .with_context(|| format!("{} is not a record of trainings", path.display()))
    }

    /// The trainings with the shield.
    pub fn shielded(&self) -> impl Iterator<Item = (&Run, &Shielded)> {
        self.runs.iter().filter_map(|run| Some((run, run.shielded.as_ref()?)))
    }

    /// Those without.
    pub fn plain(&self) -> impl Iterator<Item = &Run> {
        self.runs.iter().filter(|run| run.shielded.is_none())
    }

    /// Of each shielded training; none without one to compare with.
    pub fn verdicts(&self) -> Vec<Verdict> {
        let plain = Spread::around(self.plain().map(|run| run.gain).collect());
        // A loss beyond the spread is larger than the difference between the best and the worst seed.
        let least = plain.map(|Spread(worst, median, best)| median - (best - worst));
        let of = |(run, shielded): (&Run, &Shielded)| Some(shielded.verdict(run, least?));
        self.shielded().filter_map(of).collect()
    }
}

impl Shielded {
    pub fn forward_share(&self) -> f64 {
        self.forward_steps as f64 / self.steps as f64
    }

    /// The share of attempts that failed.
    pub fn realised_risk(&self) -> Option<f64> {
        (self.attempts > 0).then(|| 1.0 - self.reset_successes as f64 / self.attempts as f64)
    }

    /// `least`: the smallest return that is no loss.
    fn verdict(&self, run: &Run, least: f64) -> Verdict {
        let has_few_resets = run.hard_resets as f64 <= HARD_RESETS * self.episodes as f64;
        if self.forward_share() >= FORWARD && has_few_resets && run.gain >= least {
            return Verdict::Works;
        }
        let first = self.findings.iter().map(|finding| finding.step).min();
        first.filter(|step| *step <= IN_TIME).map_or(Verdict::Missed, Verdict::SaysWhy)
    }
}

#[cfg(test)]
pub mod tests {
    use super::*;

    /// A record of three trainings without the shield, with returns around 10, and one with it.
    pub fn record(forward: u64, hard_resets: u64, gain: f64, warnings: &[u64]) -> Record {
        let findings: Vec<_> = warnings
            .iter()
            .map(|step| serde_json::json!({"name": "no-success", "step": step, "text": "no | success [no-success]"}))
            .collect();
        let mut runs: Vec<_> = [(0, 8.0), (1, 10.0), (2, 12.0)]
            .map(|(seed, gain)| {
                serde_json::json!({"seed": seed, "shielded": false, "findings": [], "steps": 20_480,
                "hard_resets": 100, "return": gain})
            })
            .into();
        runs.push(serde_json::json!({"seed": 0, "shielded": true, "steps": 20_000, "forward_steps": forward, "episodes": 100,
            "hard_resets": hard_resets, "aborts": 50, "attempts": 50, "reset_successes": 40, "realised_risk": 0.2, "accepted_risk": 0.2,
            "verdict": "helps", "return": gain, "return_without_shield": 3.0, "findings": findings}));
        serde_json::from_value(serde_json::json!({"environment": "x", "steps": 20_000, "runs": runs}))
            .unwrap()
    }

    #[test]
    fn a_training_works_at_the_borders_of_the_target_and_not_beyond() {
        let verdict = |forward, hard_resets, gain| record(forward, hard_resets, gain, &[]).verdicts()[0];
        assert_eq!(verdict(12_000, 20, 6.0), Verdict::Works);
        for (forward, hard_resets, gain) in [(11_999, 20, 8.0), (12_000, 21, 8.0), (12_000, 20, 5.9)] {
            assert_eq!(
                verdict(forward, hard_resets, gain),
                Verdict::Missed,
                "{forward} {hard_resets} {gain}"
            );
        }
    }

    #[test]
    fn one_that_does_not_work_must_say_so_in_time() {
        let verdict = |warnings: &[u64]| record(5_000, 50, 1.0, warnings).verdicts()[0];
        assert_eq!(verdict(&[5_000, 2_000]), Verdict::SaysWhy(2_000));
        assert_eq!(verdict(&[2_001]), Verdict::Missed);
    }

    #[test]
    fn without_anything_to_compare_with_there_is_no_verdict() {
        let mut record = record(15_000, 1, 10.0, &[]);
        record.runs.retain(|run| run.shielded.is_some());
        assert_eq!(record.verdicts(), []);
    }
}
