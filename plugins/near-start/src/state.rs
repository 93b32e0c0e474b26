//! What was seen of the starts: a running mean, and its form in a checkpoint.

use shield_api::{Error, Result};

const MAGIC: &[u8; 4] = b"NST1";

/// The running mean of the observed starts.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Starts {
    mean: Vec<f64>,
    count: u64,
}

impl Starts {
    pub(crate) fn new(dimensions: usize) -> Self {
        Self { mean: vec![0.0; dimensions], count: 0 }
    }

    /// Moves the mean by one more observation: m ← m + (x − m) / n.
    pub(crate) fn observe(&mut self, observation: &[f32]) {
        self.count += 1;
        for (mean, value) in self.mean.iter_mut().zip(observation) {
            *mean += (f64::from(*value) - *mean) / self.count as f64;
        }
    }

    /// The mean, if anything was observed.
    pub(crate) fn mean(&self) -> Option<&[f64]> {
        (self.count > 0).then_some(&self.mean)
    }

    pub(crate) fn count(&self) -> u64 {
        self.count
    }

    /// Magic, count, then the mean, little-endian.
    pub(crate) fn write(&self, bytes: &mut Vec<u8>) {
        bytes.extend(MAGIC);
        bytes.extend(self.count.to_le_bytes());
        self.mean.iter().for_each(|value| bytes.extend(value.to_le_bytes()));
    }

    pub(crate) fn read(bytes: &[u8], dimensions: usize) -> Result<Self> {
        let foreign = || {
            Error::invalid_argument(format!(
                "{} bytes that are no state of this task in {dimensions} dimensions",
                bytes.len()
            ))
        };
        let (words, rest) = bytes.strip_prefix(MAGIC).ok_or_else(foreign)?.as_chunks::<8>();
        let (count, mean) = words.split_first().ok_or_else(foreign)?;
        let mean: Vec<f64> = mean.iter().map(|word| f64::from_le_bytes(*word)).collect();
        if !rest.is_empty() || mean.len() != dimensions || mean.iter().any(|value| !value.is_finite()) {
            return Err(foreign());
        }
        Ok(Self { mean, count: u64::from_le_bytes(*count) })
    }
}
