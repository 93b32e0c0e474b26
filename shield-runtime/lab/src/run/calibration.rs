//! How well the reset ensemble's values foretell success.

use std::path::Path;

use anyhow::{Context, Result};
use serde::Deserialize;

/// At most so many groups, of equally many episodes.
const BINS: usize = 10;

/// Reset episodes whose values at their start were alike.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CalibrationBin {
    /// The least value at the start of such an episode.
    pub low: f64,
    /// The largest.
    pub high: f64,
    /// How many episodes.
    pub episodes: usize,
    /// Of these, successful ones.
    pub successes: usize,
}

#[derive(Deserialize)]
struct Episode {
    has_reset: u8,
    reset_value: Option<f64>,
}

/// The reset episodes of a run in groups of rising value at their start, with the successes of each; none if none has a value.
///
/// # Errors
/// `metrics.csv` cannot be read.
pub fn calibration(run: &Path) -> Result<Vec<CalibrationBin>> {
    let path = run.join("metrics.csv");
    let cannot = || format!("{} cannot be read; give the folder of a run", path.display());
    let mut table = csv::Reader::from_path(&path).with_context(cannot)?;
    let mut episodes = Vec::new();
    for episode in table.deserialize() {
        let Episode { has_reset, reset_value } = episode.with_context(cannot)?;
        episodes.extend(reset_value.map(|value| (value, has_reset == 1)));
    }
    episodes.sort_by(|one, other| one.0.total_cmp(&other.0));
    let size = episodes.len().div_ceil(BINS).max(1);
    Ok(episodes.chunks(size).map(bin).collect())
}

fn bin(episodes: &[(f64, bool)]) -> CalibrationBin {
    CalibrationBin {
        low: episodes[0].0,
        high: episodes[episodes.len() - 1].0,
        episodes: episodes.len(),
        successes: episodes.iter().filter(|(_, has_reset)| *has_reset).count(),
    }
}
