//! What is needed of a record that `shield report --record` wrote.

use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use anyhow::{Context, Result};
use serde::Deserialize;

/// The runs of one experiment.
#[derive(Debug, Deserialize)]
pub struct Record {
    pub variants: Vec<Variant>,
}

/// The runs of one variant.
#[derive(Debug, Deserialize)]
pub struct Variant {
    pub name: String,
    pub runs: Vec<Run>,
}

/// One finished run.
#[derive(Debug, Deserialize)]
pub struct Run {
    pub summary: Summary,
    pub aborts: Option<Aborts>,
}

/// What a run came to.
#[derive(Debug, Deserialize)]
pub struct Summary {
    pub steps: u64,
    pub forward_steps: u64,
    pub early_aborts: u64,
    pub hard_resets: u64,
    pub irreversible_entries: u64,
    pub final_return: Option<f64>,
    /// Version 1.0 evaluated either with the shield or without.
    #[serde(default)]
    pub final_return_without_shield: Option<f64>,
    pub best_return: Option<f64>,
    pub success_rate: Option<f64>,
    steps_to_solve: Option<u64>,
    #[serde(default)]
    solved: Option<bool>,
    pub lifetime_return: Option<f64>,
    /// Share of the attempts that failed; like those below, unknown of version 1.0.
    pub realised_risk: Option<f64>,
    pub accepted_risk: Option<f64>,
    pub calibration_error_last_half: Option<f64>,
}

impl Summary {
    pub fn forward_percent(&self) -> Option<f64> {
        Some(self.forward_steps as f64 / self.steps as f64 * 100.0)
    }

    /// Steps after which the task was solved; infinite if it never was.
    pub fn steps_until_solved(&self) -> Option<f64> {
        let steps = self.steps_to_solve?;
        // In version 1.0 the budget alone says it.
        let is_solved = self.solved.unwrap_or(steps < self.steps);
        Some(if is_solved { steps as f64 } else { f64::INFINITY })
    }
}

/// Where forward episodes were aborted; of continuous observations nothing is needed here.
#[derive(Debug, Deserialize)]
#[serde(untagged)]
pub enum Aborts {
    Discrete {
        #[serde(rename = "Cells")]
        cells: Vec<u64>,
    },
    Continuous(serde::de::IgnoredAny),
}

/// A median between two other figures: the quartiles, or the smallest and the largest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spread(pub f64, pub f64, pub f64);

impl Record {
    pub fn read(path: &Path) -> Result<Self> {
        let file = File::open(path).with_context(|| format!("{} cannot be read", path.display()))?;
        serde_json::from_reader(BufReader::new(file))
            .with_context(|| format!("{} is not a record of runs", path.display()))
    }

    /// The variant, if some run of it is finished.
    pub fn variant(&self, name: &str) -> Option<&Variant> {
        self.variants.iter().find(|variant| variant.name == name && !variant.runs.is_empty())
    }
}

impl Variant {
    /// Median and quartiles of a figure of every run that has it.
    pub fn spread(&self, figure: impl Fn(&Summary) -> Option<f64>) -> Option<Spread> {
        Spread::of(self.figures(figure))
    }

    /// The same with the smallest and the largest.
    pub fn range(&self, figure: impl Fn(&Summary) -> Option<f64>) -> Option<Spread> {
        Spread::around(self.figures(figure))
    }

    /// The median alone.
    pub fn median(&self, figure: impl Fn(&Summary) -> Option<f64>) -> Option<f64> {
        self.range(figure).map(Spread::median)
    }

    fn figures(&self, figure: impl Fn(&Summary) -> Option<f64>) -> Vec<f64> {
        self.runs.iter().filter_map(|run| figure(&run.summary)).collect()
    }
}

impl Spread {
    /// With the quartiles, linear between neighbours, as `shield report` has it. `None` of nothing.
    pub fn of(figures: Vec<f64>) -> Option<Self> {
        Self::with_ends(figures, 0.25)
    }

    /// With the smallest and the largest. `None` of nothing.
    pub fn around(figures: Vec<f64>) -> Option<Self> {
        Self::with_ends(figures, 0.0)
    }

    /// Around the median, what this share of the figures is below, and what it is above.
    fn with_ends(mut figures: Vec<f64>, share: f64) -> Option<Self> {
        figures.sort_by(f64::total_cmp);
        let last = figures.len().checked_sub(1)?;
        let at = |share: f64| {
            let place = share * last as f64;
            let (low, high) = (figures[place.floor() as usize], figures[place.ceil() as usize]);
            // Infinite figures have no difference.
            if low == high { low } else { low + (high - low) * place.fract() }
        };
        Some(Self(at(share), at(0.5), at(1.0 - share)))
    }

    pub fn median(self) -> f64 {
        self.1
    }

    /// The median with the figures around it, if they differ.
    pub fn show(self, decimals: usize) -> String {
        let show = |figure: f64| match figure {
            f64::INFINITY => "never".into(),
            figure => format!("{figure:.decimals$}"),
        };
        let [lower, median, upper] = [self.0, self.1, self.2].map(show);
        if lower == upper { median } else { format!("{median} ({lower} to {upper})") }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spread_is_shown_where_seeds_differ() {
        assert_eq!(Spread::of(vec![1.0, 2.0, 3.0, 4.0]).unwrap().show(2), "2.50 (1.75 to 3.25)");
        assert_eq!(Spread::with_ends(vec![4.0, 9.0, 1.0], 0.0), Some(Spread(1.0, 4.0, 9.0)));
        assert_eq!(Spread::of(vec![3.0, 3.0]).unwrap().show(0), "3");
        assert_eq!(Spread::of(Vec::new()), None);
        let never = f64::INFINITY;
        assert_eq!(Spread::of(vec![100.0, 200.0, never]).unwrap().show(0), "200 (150 to never)");
        assert_eq!(Spread::of(vec![never, never]).unwrap().show(0), "never");
    }
}
