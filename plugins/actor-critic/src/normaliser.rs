//! Running mean and variance of observations.

use serde::{Deserialize, Serialize};

use crate::Error;

/// Scales observations to mean 0 and variance 1 by the statistics of all rows seen so far.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Normaliser {
    count: f64,
    means: Vec<f64>,
    /// Σ (x − mean)² per dimension.
    squares: Vec<f64>,
}

impl Normaliser {
    /// Normalised observations are cut at ±10, as Stable-Baselines3's `VecNormalize` does.
    pub const BOUND: f32 = 10.0;

    /// Without rows it changes nothing.
    pub fn new(dimensions: usize) -> Self {
        Self { count: 0.0, means: vec![0.0; dimensions], squares: vec![0.0; dimensions] }
    }

    /// How many values an observation has.
    pub fn dimensions(&self) -> usize {
        self.means.len()
    }

    /// Takes in rows (Welford 1962).
    pub fn observe(&mut self, rows: &[f32]) {
        for row in rows.chunks_exact(self.means.len()) {
            self.count += 1.0;
            for ((value, mean), square) in row.iter().zip(&mut self.means).zip(&mut self.squares) {
                let difference = f64::from(*value) - *mean;
                *mean += difference / self.count;
                *square += difference * (f64::from(*value) - *mean);
            }
        }
    }

    /// Copies rows into `destination`, which becomes exactly as long; normalised if there is a normaliser.
    pub fn take_rows(normaliser: Option<&Self>, rows: &[f32], destination: &mut Vec<f32>) {
        destination.resize(rows.len(), 0.0);
        match normaliser {
            Some(normaliser) => normaliser.normalise(rows, destination),
            None => destination.copy_from_slice(rows),
        }
    }

    /// Whether two learners see observations of the same kind: both normalised, over as many dimensions, or neither.
    ///
    /// # Errors
    /// [`Error::ForeignState`].
    pub fn check_alike(own: Option<&Self>, other: Option<&Self>) -> Result<(), Error> {
        if own.map(Self::dimensions) == other.map(Self::dimensions) {
            Ok(())
        } else {
            Err(Error::ForeignState("its observations are normalised otherwise".into()))
        }
    }

    /// Mean and deviation of each dimension, as [`normalise`](Self::normalise) uses them.
    pub(crate) fn statistics(&self) -> [Vec<f32>; 2] {
        let deviation =
            |square: &f64| if self.count == 0.0 { 1.0 } else { (square / self.count + 1e-8).sqrt() as f32 };
        [self.means.iter().map(|mean| *mean as f32).collect(), self.squares.iter().map(deviation).collect()]
    }

    /// Writes the normalised rows into `normalised`.
    pub fn normalise(&self, rows: &[f32], normalised: &mut [f32]) {
        if self.count == 0.0 {
            normalised.copy_from_slice(rows);
            return;
        }
        let dimensions = self.means.len();
        for (row, normalised) in rows.chunks_exact(dimensions).zip(normalised.chunks_exact_mut(dimensions)) {
            for (index, value) in normalised.iter_mut().enumerate() {
                let variance = self.squares[index] / self.count;
                let scaled = (f64::from(row[index]) - self.means[index]) / (variance + 1e-8).sqrt();
                *value = (scaled as f32).clamp(-Self::BOUND, Self::BOUND);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normalised_observations_have_mean_zero_and_variance_one() {
        let rows: Vec<f32> =
            (0..200).map(|i| if i % 2 == 0 { i as f32 } else { 5.0 - 3.0 * i as f32 }).collect();
        let mut normaliser = Normaliser::new(2);
        rows.chunks(20).for_each(|chunk| normaliser.observe(chunk));
        let mut out = vec![0.0; rows.len()];
        normaliser.normalise(&rows, &mut out);
        for dimension in 0..2 {
            let column: Vec<f32> = out.iter().skip(dimension).step_by(2).copied().collect();
            let mean = column.iter().sum::<f32>() / 100.0;
            let variance = column.iter().map(|x| (x - mean).powi(2)).sum::<f32>() / 100.0;
            assert!(mean.abs() < 1e-5 && (variance - 1.0).abs() < 1e-4, "{mean} {variance}");
        }
    }

    #[test]
    fn a_constant_dimension_stays_bounded() {
        let mut normaliser = Normaliser::new(1);
        normaliser.observe(&[3.0; 10]);
        let mut out = [0.0; 2];
        normaliser.normalise(&[3.0, 4.0], &mut out);
        assert_eq!(out, [0.0, Normaliser::BOUND]);
    }
}
