//! Observations in rows, as numbers of 32 bits, or of 8 where they are whole and small, as those of images are.

use shield_api::{Error, Result, Space};

use super::rows;

/// How observations are kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
pub enum Kept {
    /// As they are, four bytes a number.
    #[default]
    Floats,
    /// As whole numbers from 0 to 255, one byte each.
    Bytes,
}

impl Kept {
    /// Whether observations of this space can be kept so.
    ///
    /// # Errors
    /// Bytes are wanted, and some number may lie outside of them.
    pub fn check(self, space: &Space) -> Result<()> {
        let fits = match space {
            Space::Box { low, high } => {
                low.iter().all(|low| *low >= 0.0) && high.iter().all(|high| *high <= 255.0)
            }
            Space::Discrete { n } => *n <= 256,
        };
        if self == Self::Floats || fits {
            return Ok(());
        }
        Err(Error::invalid_config(
            "bytes hold whole numbers from 0 to 255, and the observation space is larger",
        ))
    }

    /// Bytes of one number.
    pub fn width(self) -> usize {
        match self {
            Self::Floats => size_of::<f32>(),
            Self::Bytes => 1,
        }
    }
}

/// One observation after another.
#[derive(Debug)]
pub(super) enum Observations {
    Floats(Vec<f32>),
    Bytes(Vec<u8>),
}

impl Observations {
    pub fn new(kept: Kept, capacity: usize, length: usize) -> Result<Self> {
        Ok(match kept {
            Kept::Floats => Self::Floats(rows(capacity, length)?),
            Kept::Bytes => Self::Bytes(rows(capacity, length)?),
        })
    }

    /// Becomes so many numbers.
    pub fn resize(&mut self, numbers: usize) {
        match self {
            Self::Floats(rows) => rows.resize(numbers, 0.0),
            Self::Bytes(rows) => rows.resize(numbers, 0),
        }
    }

    /// Writes an observation over an existing one, or appends it.
    pub fn put(&mut self, slot: usize, observation: &[f32]) {
        match self {
            Self::Floats(rows) => super::put(rows, slot, observation),
            Self::Bytes(rows) => {
                let start = slot * observation.len();
                if start >= rows.len() {
                    rows.extend(observation.iter().map(as_byte));
                } else {
                    let row = &mut rows[start..start + observation.len()];
                    row.iter_mut().zip(observation).for_each(|(byte, number)| *byte = as_byte(number));
                }
            }
        }
    }

    /// Reads an observation.
    pub fn get(&self, slot: usize, into: &mut [f32]) {
        let row = slot * into.len()..(slot + 1) * into.len();
        match self {
            Self::Floats(rows) => into.copy_from_slice(&rows[row]),
            Self::Bytes(rows) => {
                into.iter_mut().zip(&rows[row]).for_each(|(number, byte)| *number = f32::from(*byte));
            }
        }
    }

    /// Appends an observation of so many numbers as little-endian bytes.
    pub fn write(&self, slot: usize, length: usize, bytes: &mut Vec<u8>) {
        let row = slot * length..(slot + 1) * length;
        match self {
            Self::Floats(rows) => bytes.extend(rows[row].iter().flat_map(|number| number.to_le_bytes())),
            Self::Bytes(rows) => bytes.extend_from_slice(&rows[row]),
        }
    }

    /// Takes an observation of so many numbers from what [`write`](Self::write) wrote.
    pub fn read(&mut self, slot: usize, length: usize, bytes: &mut &[u8]) {
        let row = slot * length..(slot + 1) * length;
        match self {
            Self::Floats(rows) => {
                rows[row]
                    .iter_mut()
                    .for_each(|number| *number = f32::from_le_bytes(super::rows::take(bytes)));
            }
            Self::Bytes(rows) => rows[row].iter_mut().for_each(|byte| [*byte] = super::rows::take(bytes)),
        }
    }
}

/// Conversions of floats saturate, and NaN, which the cycle rejects before, becomes 0.
fn as_byte(number: &f32) -> u8 {
    number.round() as u8
}
