//! How a run went, at equal distances.

use std::path::Path;

use anyhow::{Context, Result};
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use shield_api::regular_file;

/// Into how many parts of equal length a run is cut.
const PARTS: u64 = 50;

/// The counts of a run after each fiftieth of its steps. A column is as long as `step`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Course {
    /// Environment steps.
    pub step: Vec<u64>,
    /// Those of forward episodes.
    pub forward_steps: Vec<u64>,
    /// Early aborts so far.
    pub early_aborts: Vec<u64>,
    /// Hard resets so far.
    pub hard_resets: Vec<u64>,
    /// Entries into irreversible states so far.
    pub irreversible_entries: Vec<u64>,
    /// Sum of the task's rewards so far, of both phases: what a lifetime is worth.
    pub lifetime_return: Vec<f64>,
    /// Mean return of the forward episodes that ended in this part; `None` if none did.
    pub forward_return: Vec<Option<f64>>,
}

/// What is needed of a row of `metrics.csv`.
#[derive(Debug, Clone, Default, Deserialize)]
struct Episode {
    step: u64,
    phase: String,
    forward_return: f64,
    early_aborts: u64,
    hard_resets: u64,
    irreversible_entries: u64,
    forward_steps: u64,
}

/// The evaluations of a run. A column is as long as `step`.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct EvaluationCourse {
    /// Environment steps before each.
    pub step: Vec<u64>,
    /// Mean return of its episodes.
    pub mean_return: Vec<f64>,
    /// Share of its episodes that achieved the task.
    pub success_rate: Vec<f64>,
    /// Mean return without the shield; empty where the columns above are without one.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub mean_return_without_shield: Vec<f64>,
    /// The same of the share of episodes that achieved the task.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub success_rate_without_shield: Vec<f64>,
}

/// What is needed of a row of `evaluations.csv`. Version 1.0 had no columns for figures without the shield.
#[derive(Debug, Deserialize)]
struct Evaluation {
    step: u64,
    mean_return: f64,
    success_rate: f64,
    #[serde(default)]
    mean_return_without_shield: Option<f64>,
    #[serde(default)]
    success_rate_without_shield: Option<f64>,
}

impl EvaluationCourse {
    /// From the `evaluations.csv` of a run.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn read(run: &Path) -> Result<Self> {
        let mut course = Self::default();
        for row in rows::<Evaluation>(&run.join("evaluations.csv"))? {
            course.step.push(row.step);
            course.mean_return.push(rounded(row.mean_return));
            course.success_rate.push(rounded(row.success_rate));
            course.mean_return_without_shield.extend(row.mean_return_without_shield.map(rounded));
            course.success_rate_without_shield.extend(row.success_rate_without_shield.map(rounded));
        }
        Ok(course)
    }
}

impl Course {
    /// From the `metrics.csv` of a run of so many steps. What happened within an episode counts from its end on.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn read(run: &Path, steps: u64) -> Result<Self> {
        Ok(Self::of(&rows(&run.join("metrics.csv"))?, steps))
    }

    fn of(episodes: &[Episode], steps: u64) -> Self {
        let mut course = Self::default();
        let (mut last, mut lifetime) = (Episode::default(), 0.0);
        let mut rest = episodes.iter().peekable();
        for part in 1..=PARTS {
            let end = (u128::from(steps) * u128::from(part) / u128::from(PARTS)) as u64;
            let (mut sum, mut count) = (0.0, 0_u32);
            while let Some(episode) = rest.next_if(|episode| episode.step <= end) {
                lifetime += episode.forward_return;
                if episode.phase == "forward" {
                    (sum, count) = (sum + episode.forward_return, count + 1);
                }
                last = episode.clone();
            }
            course.step.push(end);
            course.forward_steps.push(last.forward_steps);
            course.early_aborts.push(last.early_aborts);
            course.hard_resets.push(last.hard_resets);
            course.irreversible_entries.push(last.irreversible_entries);
            course.lifetime_return.push(rounded(lifetime));
            course.forward_return.push((count > 0).then(|| rounded(sum / f64::from(count))));
        }
        course
    }
}

/// The rows of a table; further columns are passed over.
fn rows<R: DeserializeOwned>(path: &Path) -> Result<Vec<R>> {
    let file = regular_file::open(path).with_context(|| format!("{} cannot be read", path.display()))?;
    let rows: Result<Vec<R>, _> = csv::Reader::from_reader(file).into_deserialize().collect();
    rows.with_context(|| format!("{} is damaged", path.display()))
}

/// To a thousandth: a record is read by people too.
pub(super) fn rounded(figure: f64) -> f64 {
    (figure * 1_000.0).round() / 1_000.0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn episode(step: u64, phase: &str, forward_return: f64, hard_resets: u64) -> Episode {
        Episode { step, phase: phase.into(), forward_return, hard_resets, ..Episode::default() }
    }

    #[test]
    fn the_lifetime_return_counts_both_phases_at_the_end_of_each_episode() {
        let episodes =
            [episode(30, "forward", 4.0, 0), episode(50, "reset", 0.5, 1), episode(100, "forward", 2.0, 1)];
        let course = Course::of(&episodes, 100);
        assert_eq!(course.step.len(), 50);
        let at = |step: u64| course.step.iter().position(|end| *end == step).unwrap();
        assert_eq!(course.lifetime_return[at(28)], 0.0);
        assert_eq!(course.lifetime_return[at(50)], 4.5);
        assert_eq!((course.hard_resets[at(48)], course.hard_resets[at(50)]), (0, 1));
        assert_eq!((course.forward_return[at(50)], course.forward_return[at(100)]), (None, Some(2.0)));
        assert_eq!(course.lifetime_return[at(100)], 6.5);
    }
}
