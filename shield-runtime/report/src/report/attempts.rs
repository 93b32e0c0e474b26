//! Attempts to get back to the start: how many succeeded, the risk, and how well their success was foretold.

use std::path::Path;

use anyhow::Result;
use serde::{Deserialize, Serialize};
use shield_lab::{
    reliability::{BINS, Bin, Reliability},
    run::{Summary, last_half, read_attempts, reliability},
};

use super::{columns::Column, course::rounded, record::VariantRecord};

/// The columns of the table of attempts.
pub const ATTEMPT_COLUMNS: [Column; 8] = [
    Column { heading: "attempts", figure: |run| made(run).map(|made| made as f64), decimals: 0 },
    Column {
        heading: "succeeded",
        figure: |run| run.attempts.reset_successes.map(|count| count as f64),
        decimals: 0,
    },
    Column { heading: "failed,\n%", figure: |run| percent(run.attempts.realised_risk), decimals: 1 },
    Column {
        heading: "in the last\nhalf, %",
        figure: |run| percent(run.attempts.realised_risk_last_half),
        decimals: 1,
    },
    Column { heading: "accepted,\n%", figure: |run| percent(run.attempts.accepted_risk), decimals: 1 },
    Column { heading: "Brier\nscore", figure: |run| run.attempts.brier_score, decimals: 3 },
    Column { heading: "calibration\nerror", figure: |run| run.attempts.calibration_error, decimals: 3 },
    Column {
        heading: "in the\nlast half",
        figure: |run| run.attempts.calibration_error_last_half,
        decimals: 3,
    },
];

/// What stands below the table.
pub const ATTEMPT_NOTE: &str = "\
An attempt is a reset episode; a forward episode in which the environment terminates counts as a failed attempt.
Failed: the realised risk. Accepted: the risk that the rule undo-probability may take. The last half is that of the attempts.
Brier score and expected calibration error compare the success critic's estimate at the start of an attempt with its outcome: 0 is best.";

fn percent(share: Option<f64>) -> Option<f64> {
    share.map(|share| share * 100.0)
}

/// Attempts that have an outcome, where they were counted.
fn made(run: &Summary) -> Option<u64> {
    Some(run.attempts.reset_successes?.saturating_add(run.attempts.failed_attempts?))
}

/// Whether a run made an attempt.
pub fn has_attempts(run: &Summary) -> bool {
    made(run).is_some_and(|made| made > 0)
}

/// What the success critic expected of the attempts of a run, against their outcomes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Forecasts {
    /// Of all attempts.
    pub all: Reliability,
    /// Of the later half of them.
    pub last_half: Reliability,
}

impl Forecasts {
    /// From the episodes of a run; `None` without a success critic.
    ///
    /// # Errors
    /// They cannot be read.
    pub(super) fn read(run: &Path) -> Result<Option<Self>> {
        let attempts = read_attempts(run)?;
        let [all, last_half] = [&attempts[..], last_half(&attempts)].map(|some| short(reliability(some)));
        Ok((all.forecasts() > 0).then_some(Self { all, last_half }))
    }
}

/// To a thousandth: a record is read by people too.
fn short(mut reliability: Reliability) -> Reliability {
    reliability.bins.iter_mut().for_each(|bin| bin.sum = rounded(bin.sum));
    reliability.squared_error = rounded(reliability.squared_error);
    reliability
}

/// What the success critic of a variant expected against what came, all seeds together.
#[derive(Debug, Clone, PartialEq)]
pub struct Diagram {
    /// Name of the file.
    pub name: String,
    /// What it shows.
    pub title: String,
    /// Of all attempts.
    pub all: Reliability,
    /// Of the later half of each run's attempts.
    pub last_half: Reliability,
}

impl Diagram {
    /// `None` where nothing was expected.
    pub(super) fn of(variant: &VariantRecord) -> Option<Self> {
        let (mut all, mut last_half) = (Reliability::default(), Reliability::default());
        for forecasts in variant.runs.iter().filter_map(|run| run.forecasts.as_ref()) {
            all += &forecasts.all;
            last_half += &forecasts.last_half;
        }
        (all.forecasts() > 0).then(|| Self {
            name: format!("reliability-{}", variant.name),
            title: format!("{}: undo probability and outcome of attempts", variant.name),
            all,
            last_half,
        })
    }

    /// The points of a line: of each bin with attempts, mean estimate and realised share, and how many there are.
    pub fn points(reliability: &Reliability) -> Vec<((f64, f64), u64)> {
        let point = |bin: &Bin| Some(((bin.predicted()?, bin.realised()?), bin.forecasts));
        reliability.bins.iter().filter_map(point).collect()
    }

    /// The borders of a bin.
    pub fn borders(index: usize) -> [f64; 2] {
        [index, index + 1].map(|border| border as f64 / BINS as f64)
    }
}
