//! Where forward episodes were aborted.

use std::path::Path;

use anyhow::{Result, ensure};
use serde::{Deserialize, Serialize};

use super::course::rounded;
use shield_lab::run::read_decisions;

/// Most points that are kept of a run.
const MOST: usize = 300;

/// The observations at which the shield aborted forward episodes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum Places {
    /// How often at each observation of a discrete space.
    Cells(Vec<u64>),
    /// Two dimensions of each; of many, some at equal distances.
    Points {
        /// Which two dimensions.
        dimensions: [usize; 2],
        /// Aborts that there were.
        of: u64,
        /// Their places.
        points: Vec<[f64; 2]>,
    },
}

impl Places {
    /// From a run's recorded decisions; `None` if none were recorded, nothing was aborted, or no dimensions are given of observations that have
    /// less than two.
    ///
    /// # Errors
    /// They cannot be read, or their observations have no such dimensions.
    pub fn read(run: &Path, dimensions: Option<[usize; 2]>) -> Result<Option<Self>> {
        if !run.join("decisions").is_dir() {
            return Ok(None);
        }
        let mut aborts = Vec::new();
        read_decisions(run, |row| {
            if row.phase == "forward" && row.verdict == "abort" {
                aborts.push(row.observation);
            }
            Ok(true)
        })?;
        let Some(count) = aborts.first().map(Vec::len) else { return Ok(None) };
        let chosen = dimensions.unwrap_or([0, 1]);
        let places = Self::of(&aborts, chosen);
        if matches!(places, Self::Cells(_)) || chosen.iter().all(|dimension| *dimension < count) {
            return Ok(Some(places));
        }
        ensure!(
            dimensions.is_none(),
            "observations have {count} dimensions, counted from 0: there is no {}",
            chosen[0].max(chosen[1])
        );
        Ok(None)
    }

    fn of(aborts: &[Vec<f32>], [x, y]: [usize; 2]) -> Self {
        // What a discrete space observes is one-hot.
        if aborts.iter().all(|observation| is_one_hot(observation)) {
            let mut cells = vec![0; aborts[0].len()];
            let cell = |observation: &Vec<f32>| observation.iter().position(|value| *value == 1.0);
            aborts.iter().filter_map(cell).for_each(|cell| cells[cell] += 1);
            return Self::Cells(cells);
        }
        let figure = |observation: &Vec<f32>, dimension: usize| {
            observation.get(dimension).map_or(f64::NAN, |value| short(f64::from(*value)))
        };
        let every = aborts.len().div_ceil(MOST);
        let points = aborts.iter().step_by(every).map(|at| [figure(at, x), figure(at, y)]);
        Self::Points { dimensions: [x, y], of: aborts.len() as u64, points: points.collect() }
    }
}

/// To a thousandth, or to four digits where that is more: an axis may be narrow.
fn short(figure: f64) -> f64 {
    if figure.abs() >= 1.0 {
        return rounded(figure);
    }
    format!("{figure:.3e}").parse().unwrap_or(figure)
}

fn is_one_hot(observation: &[f32]) -> bool {
    let ones = observation.iter().filter(|value| **value == 1.0).count();
    ones == 1 && observation.iter().all(|value| *value == 0.0 || *value == 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn aborts_of_a_discrete_space_are_counted_by_cell() {
        let aborts = [vec![0.0, 1.0], vec![0.0, 1.0], vec![1.0, 0.0]];
        assert_eq!(Places::of(&aborts, [0, 1]), Places::Cells(vec![1, 2]));
    }

    #[test]
    fn some_of_many_aborts_are_kept_and_all_are_counted() {
        let aborts: Vec<Vec<f32>> = (0..1_000).map(|index| vec![index as f32, 7.0, 1.0]).collect();
        let Places::Points { of, points, .. } = Places::of(&aborts, [2, 0]) else { panic!("cells") };
        assert_eq!((of, points[1]), (1_000, [1.0, 4.0]));
        assert!(points.len() <= MOST);
    }

    #[test]
    fn coordinates_keep_their_significant_digits() {
        assert_eq!([-0.000_123_456, 0.5, 12.345_67, 0.0].map(short), [-0.000_123_5, 0.5, 12.346, 0.0]);
    }
}
