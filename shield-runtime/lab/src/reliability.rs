//! How well probabilities foretold what happened.
//!
//! A forecast is a probability with what happened then. Forecasts are *calibrated* if, among those of a probability p, a share p came true.
//!
//! - Reliability diagram: realised share against mean forecast, in bins (DeGroot and Fienberg 1983, "The comparison and evaluation of
//!   forecasters", The Statistician 32).
//! - [Expected calibration error](Reliability::calibration_error): Naeini, Cooper and Hauskrecht 2015, "Obtaining well calibrated
//!   probabilities using Bayesian binning", AAAI.
//! - [Brier score](Reliability::brier_score): Brier 1950, "Verification of forecasts expressed in terms of probability", Monthly Weather
//!   Review 78.

use std::ops::AddAssign;

use serde::{Deserialize, Serialize};

/// Bins of equal width over [0, 1].
pub const BINS: usize = 10;

/// A probability, and whether what it was given for happened.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Forecast {
    probability: f64,
    came_true: bool,
}

impl Forecast {
    /// `None` unless the probability lies in [0, 1].
    pub fn new(probability: f64, came_true: bool) -> Option<Self> {
        (0.0..=1.0).contains(&probability).then_some(Self { probability, came_true })
    }

    /// Which bin it lies in. A bin holds its lower bound; the last one also holds 1.
    fn bin(self) -> usize {
        ((self.probability * BINS as f64) as usize).min(BINS - 1)
    }
}

/// The forecasts of one bin.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Bin {
    /// How many.
    pub forecasts: u64,
    /// Of these, how many came true.
    pub came_true: u64,
    /// Sum of their probabilities.
    pub sum: f64,
}

impl Bin {
    /// Mean probability; `None` without a forecast.
    pub fn predicted(&self) -> Option<f64> {
        (self.forecasts > 0).then(|| self.sum / self.forecasts as f64)
    }

    /// Share that came true; `None` without a forecast.
    pub fn realised(&self) -> Option<f64> {
        (self.forecasts > 0).then(|| self.came_true as f64 / self.forecasts as f64)
    }
}

/// Forecasts, summed up.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Reliability {
    /// From the lowest probabilities to the highest.
    pub bins: [Bin; BINS],
    /// Sum of the squared differences between probability and outcome.
    pub squared_error: f64,
}

impl Reliability {
    /// How many forecasts.
    pub fn forecasts(&self) -> u64 {
        self.bins.iter().map(|bin| bin.forecasts).sum()
    }

    /// Mean squared difference between probability and outcome, from 0 (certain and right) to 1; always 0.5 gives 0.25. It is half of what
    /// Brier sums over both outcomes, as is usual today. `None` without a forecast.
    pub fn brier_score(&self) -> Option<f64> {
        self.mean(self.squared_error)
    }

    /// Mean distance between predicted and realised share over the bins, weighted by their forecasts: 0 is calibrated. `None` without a
    /// forecast.
    pub fn calibration_error(&self) -> Option<f64> {
        self.mean(self.bins.iter().map(|bin| (bin.sum - bin.came_true as f64).abs()).sum())
    }

    fn mean(&self, sum: f64) -> Option<f64> {
        let forecasts = self.forecasts();
        (forecasts > 0).then(|| sum / forecasts as f64)
    }
}

impl AddAssign<Forecast> for Reliability {
    fn add_assign(&mut self, forecast: Forecast) {
        let Forecast { probability, came_true } = forecast;
        let outcome = f64::from(u8::from(came_true));
        let bin = &mut self.bins[forecast.bin()];
        bin.forecasts += 1;
        bin.came_true += u64::from(came_true);
        bin.sum += probability;
        self.squared_error += (probability - outcome).powi(2);
    }
}

impl AddAssign<&Self> for Reliability {
    fn add_assign(&mut self, other: &Self) {
        for (bin, more) in self.bins.iter_mut().zip(&other.bins) {
            bin.forecasts += more.forecasts;
            bin.came_true += more.came_true;
            bin.sum += more.sum;
        }
        self.squared_error += other.squared_error;
    }
}

impl FromIterator<Forecast> for Reliability {
    fn from_iter<I: IntoIterator<Item = Forecast>>(forecasts: I) -> Self {
        let mut all = Self::default();
        forecasts.into_iter().for_each(|forecast| all += forecast);
        all
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    use super::*;

    fn of(forecasts: &[(f64, bool)]) -> Reliability {
        forecasts
            .iter()
            .filter_map(|(probability, came_true)| Forecast::new(*probability, *came_true))
            .collect()
    }

    fn near(figure: Option<f64>, expected: f64) -> bool {
        figure.is_some_and(|figure| (figure - expected).abs() < 1e-12)
    }

    #[test]
    fn a_figure_that_is_no_probability_is_no_forecast() {
        for none in [-0.1, 1.000_001, f64::NAN, f64::INFINITY] {
            assert_eq!(Forecast::new(none, true), None, "{none}");
        }
        assert!(Forecast::new(0.0, true).is_some() && Forecast::new(1.0, false).is_some());
    }

    #[test]
    fn without_a_forecast_there_are_no_figures() {
        let none = of(&[]);
        assert_eq!((none.forecasts(), none.brier_score(), none.calibration_error()), (0, None, None));
        assert_eq!((none.bins[0].predicted(), none.bins[0].realised()), (None, None));
    }

    #[test]
    fn bins_have_equal_widths_and_hold_their_lower_bounds() {
        for (probability, bin) in [(0.0, 0), (0.099, 0), (0.1, 1), (0.55, 5), (0.999, 9), (1.0, 9)] {
            let filled = of(&[(probability, true)]).bins.iter().position(|bin| bin.forecasts == 1);
            assert_eq!(filled, Some(bin), "{probability}");
        }
    }

    #[test]
    fn the_figures_are_those_computed_by_hand() {
        // Bin 9: 0.9 and 1.0, one of two came true. Bin 2: 0.2 and 0.25, none of two.
        let all = of(&[(0.9, true), (1.0, false), (0.2, false), (0.25, false)]);
        assert!(near(all.bins[9].predicted(), 0.95) && near(all.bins[9].realised(), 0.5));
        assert!(near(all.bins[2].predicted(), 0.225) && near(all.bins[2].realised(), 0.0));
        assert!(near(all.brier_score(), (0.01 + 1.0 + 0.04 + 0.0625) / 4.0));
        assert!(near(all.calibration_error(), 0.5 * 0.45 + 0.5 * 0.225));
    }

    #[test]
    fn certainty_is_right_or_wrong() {
        let right = of(&[(1.0, true), (0.0, false)]);
        assert_eq!((right.brier_score(), right.calibration_error()), (Some(0.0), Some(0.0)));
        let wrong = of(&[(1.0, false), (0.0, true)]);
        assert_eq!((wrong.brier_score(), wrong.calibration_error()), (Some(1.0), Some(1.0)));
        // Calibrated, and yet of no use.
        let undecided = of(&[(0.5, true), (0.5, false)]);
        assert_eq!((undecided.brier_score(), undecided.calibration_error()), (Some(0.25), Some(0.0)));
    }

    #[test]
    fn errors_of_opposite_signs_in_different_bins_do_not_cancel() {
        assert!(near(of(&[(0.0, true), (1.0, false), (1.0, true), (0.0, false)]).calibration_error(), 0.5));
    }

    #[test]
    fn sums_of_parts_are_those_of_the_whole() {
        let parts = [vec![(0.9, true), (0.4, false)], vec![(0.45, true)]];
        let mut sum = Reliability::default();
        parts.iter().for_each(|part| sum += &of(part));
        assert_eq!(sum, of(&parts.concat()));
    }

    #[test]
    fn forecasts_that_come_true_as_often_as_they_say_are_calibrated() {
        let mut rng = Pcg64::seed_from_u64(5);
        let mut draw = |bias: f64| {
            let probability: f64 = rng.random_range(0.0..=1.0);
            let came_true = rng.random_range(0.0..1.0) < probability;
            Forecast::new((probability + bias).clamp(0.0, 1.0), came_true)
        };
        let calibrated: Reliability = (0..20_000).filter_map(|_| draw(0.0)).collect();
        assert!(calibrated.calibration_error().unwrap() < 0.02, "{calibrated:?}");
        // The mean of p (1 − p) over uniform p.
        assert!((calibrated.brier_score().unwrap() - 1.0 / 6.0).abs() < 0.01);
        let biased: Reliability = (0..20_000).filter_map(|_| draw(0.2)).collect();
        assert!((biased.calibration_error().unwrap() - 0.18).abs() < 0.02, "{biased:?}");
    }
}
