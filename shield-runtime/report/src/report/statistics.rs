//! Median and quartiles over seeds.

use serde::{Deserialize, Serialize};

/// Where the middle half of some figures lies.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// A quarter of the figures is not larger.
    pub lower: f64,
    /// Half of them.
    pub median: f64,
    /// Three quarters.
    pub upper: f64,
}

impl Spread {
    /// Of some figures; `None` of none. Those that are no numbers are left out.
    pub fn of(figures: impl IntoIterator<Item = f64>) -> Option<Self> {
        let mut sorted: Vec<f64> = figures.into_iter().filter(|figure| !figure.is_nan()).collect();
        if sorted.is_empty() {
            return None;
        }
        sorted.sort_by(f64::total_cmp);
        let at = |share: f64| quantile(&sorted, share);
        Some(Self { lower: at(0.25), median: at(0.5), upper: at(0.75) })
    }
}

/// Linear between the two figures beside it: type 7 of Hyndman and Fan 1996, as NumPy has it.
fn quantile(sorted: &[f64], share: f64) -> f64 {
    let place = share * (sorted.len() - 1) as f64;
    let (low, high) = (sorted[place.floor() as usize], sorted[place.ceil() as usize]);
    // Infinite figures have no difference.
    if low == high { low } else { low + (high - low) * place.fract() }
}

/// The median of some figures, and how far they reach.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Range {
    pub smallest: f64,
    pub median: f64,
    pub largest: f64,
}

impl Range {
    /// `None` of no figures; what is not a number does not count.
    pub fn of(figures: impl Iterator<Item = f64>) -> Option<Self> {
        let figures: Vec<f64> = figures.filter(|figure| !figure.is_nan()).collect();
        let smallest = figures.iter().copied().min_by(f64::total_cmp)?;
        let largest = figures.iter().copied().max_by(f64::total_cmp)?;
        Some(Self { smallest, median: median(&figures), largest })
    }
}

/// The median; of an even number, the mean of the middle two. NaN of none.
pub fn median(figures: &[f64]) -> f64 {
    Spread::of(figures.iter().copied()).map_or(f64::NAN, |spread| spread.median)
}

/// With so many decimals; half a count, as the median of an even number of them may be, keeps its half. What is infinitely late is `never`.
pub fn show(figure: f64, decimals: usize) -> String {
    if figure == f64::INFINITY {
        return "never".into();
    }
    let is_half = decimals == 0 && figure.fract().abs() == 0.5;
    format!("{figure:.*}", if is_half { 1 } else { decimals })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quartiles_are_interpolated_as_in_numpy() {
        let spread = Spread::of([4.0, 1.0, 3.0, f64::NAN, 2.0]).unwrap();
        assert_eq!(spread, Spread { lower: 1.75, median: 2.5, upper: 3.25 });
        assert_eq!(Spread::of([7.0]).unwrap(), Spread { lower: 7.0, median: 7.0, upper: 7.0 });
        assert_eq!(Spread::of([]), None);
        let spread = Spread::of([1.0, 2.0, f64::INFINITY, f64::INFINITY, f64::INFINITY]).unwrap();
        assert_eq!(spread, Spread { lower: 2.0, median: f64::INFINITY, upper: f64::INFINITY });
    }

    #[test]
    fn the_median_of_an_even_number_is_the_mean_of_the_middle_two() {
        assert_eq!(median(&[4.0, 1.0, 2.0, 9.0]), 3.0);
        let shown = [2.0, 2.5, 2.25].map(|figure| show(figure, 0));
        assert_eq!(shown, ["2", "2.5", "2"]);
    }
}
