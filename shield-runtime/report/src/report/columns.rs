//! The columns that the final table has everywhere: on the terminal, and on the page.

use serde::Serialize;
use shield_lab::run::Summary;

use super::statistics::{Range, show};

/// A column: its heading, the figure of one run, and how many decimals it has.
#[derive(Debug, Clone, Copy)]
pub struct Column {
    /// In one line or two.
    pub heading: &'static str,
    pub(super) figure: fn(&Summary) -> Option<f64>,
    pub(super) decimals: usize,
}

/// In their order. One in which no run has a figure can be left out.
pub const COLUMNS: [Column; 10] = [
    Column { heading: "steps", figure: |run| Some(run.steps as f64), decimals: 0 },
    Column { heading: "of them\nforward, %", figure: |run| Some(forward_share(run) * 100.0), decimals: 0 },
    Column { heading: "early\naborts", figure: |run| Some(run.early_aborts as f64), decimals: 0 },
    Column { heading: "hard\nresets", figure: |run| Some(run.hard_resets as f64), decimals: 0 },
    Column {
        heading: "irreversible\nentries",
        figure: |run| Some(run.irreversible_entries as f64),
        decimals: 0,
    },
    Column { heading: "final\nreturn", figure: |run| run.final_return, decimals: 2 },
    Column { heading: "without\nthe shield", figure: |run| run.final_return_without_shield, decimals: 2 },
    Column { heading: "best\nreturn", figure: |run| run.best_return, decimals: 2 },
    Column { heading: "success,\n%", figure: |run| run.success_rate.map(|rate| rate * 100.0), decimals: 0 },
    Column { heading: "steps\nto solve", figure: Summary::steps_until_solved, decimals: 0 },
];

/// A figure over the seeds of a variant.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Cell {
    /// The median, or `–` where there is no figure.
    pub median: String,
    /// The smallest and the largest; empty where they are shown alike.
    pub range: String,
}

impl Column {
    /// Whether some run has a figure in it.
    pub fn has_figures<'a>(&self, runs: impl IntoIterator<Item = &'a Summary>) -> bool {
        runs.into_iter().any(|run| (self.figure)(run).is_some())
    }

    /// What these runs have in it.
    pub fn cell<'a>(&self, runs: impl IntoIterator<Item = &'a Summary>) -> Cell {
        Cell::of(runs.into_iter().filter_map(self.figure), self.decimals)
    }
}

impl Cell {
    /// Of figures with so many decimals.
    pub fn of(figures: impl Iterator<Item = f64>, decimals: usize) -> Self {
        let Some(range) = Range::of(figures) else {
            return Self { median: "–".into(), range: String::new() };
        };
        let show = |figure: f64| show(figure, decimals);
        let [smallest, largest] = [show(range.smallest), show(range.largest)];
        let range_text = if smallest == largest { String::new() } else { format!("{smallest} to {largest}") };
        Self { median: show(range.median), range: range_text }
    }
}

/// Which share of a run's steps the forward agent was in charge.
pub fn forward_share(run: &Summary) -> f64 {
    run.forward_steps as f64 / run.steps.max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cell_has_the_median_and_the_range_over_the_seeds() {
        let cell = |figures: &[f64]| {
            let Cell { median, range } = Cell::of(figures.iter().copied(), 0);
            [median, range]
        };
        assert_eq!(cell(&[]), ["–", ""]);
        assert_eq!(cell(&[7.0, 7.0]), ["7", ""]);
        assert_eq!(cell(&[9.0, 1.0, 3.0]), ["3", "1 to 9"]);
    }

    #[test]
    fn a_run_that_never_solved_the_task_is_later_than_all_others() {
        let cell = |figures: &[f64]| {
            let Cell { median, range } = Cell::of(figures.iter().copied(), 0);
            [median, range]
        };
        let never = f64::INFINITY;
        assert_eq!(cell(&[never, 200.0, 100.0]), ["200", "100 to never"]);
        assert_eq!(cell(&[never, 200.0]), ["never", "200 to never"]);
        assert_eq!(cell(&[never, 100.0, never]), ["never", "100 to never"]);
        assert_eq!(cell(&[never, never]), ["never", ""]);
    }
}
