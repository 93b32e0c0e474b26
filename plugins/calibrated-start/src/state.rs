//! The form of the task in a checkpoint.

use shield_api::{Checkpoint, Error, Result};

use crate::{
    CalibratedStart,
    calibration::{Calibration, Scale},
    memory::Memory,
};

const MAGIC: &[u8; 4] = b"CST1";
/// In the place of a share of nothing.
const ABSENT: f64 = -1.0;

/// Magic, number of starts, steps and samples, whether a calibration is due; then starts, samples and calibration, all little-endian.
impl Checkpoint for CalibratedStart {
    fn save(&self, bytes: &mut Vec<u8>) -> Result<()> {
        let (starts, samples) = (self.memory.starts(), self.memory.samples());
        bytes.extend(MAGIC);
        for count in [starts.len() as u64, self.memory.steps(), samples.len() as u64] {
            bytes.extend(count.to_le_bytes());
        }
        bytes.push(u8::from(self.is_due));
        for value in starts.values().iter().chain(samples.values()) {
            bytes.extend(value.to_le_bytes());
        }
        let calibration = &self.calibration;
        let shares =
            [calibration.starts_inside, calibration.experience_inside].map(|share| share.unwrap_or(ABSENT));
        let scales = calibration.scales.iter().flat_map(|scale| [scale.per_unit, scale.tolerance]);
        for value in [calibration.radius, calibration.margin].into_iter().chain(shares).chain(scales) {
            bytes.extend(value.to_le_bytes());
        }
        Ok(())
    }

    fn load(&mut self, bytes: &[u8]) -> Result<()> {
        let (memory, calibration, is_due) = self.read(bytes).ok_or_else(|| {
            Error::invalid_argument(format!(
                "{} bytes that are no state of this task with these settings in {} dimensions",
                bytes.len(),
                self.observation_len
            ))
        })?;
        (self.memory, self.calibration, self.is_due) = (memory, calibration, is_due);
        Ok(())
    }
}

impl CalibratedStart {
    fn read(&self, bytes: &[u8]) -> Option<(Memory, Calibration, bool)> {
        let mut rest = bytes.strip_prefix(MAGIC)?;
        let starts = u64::from_le_bytes(take(&mut rest)?);
        let steps = u64::from_le_bytes(take(&mut rest)?);
        let samples = u64::from_le_bytes(take(&mut rest)?);
        let is_due = match take(&mut rest)? {
            [0] => false,
            [1] => true,
            _ => return None,
        };
        let starts = self.observations(&mut rest, starts)?;
        let samples = self.observations(&mut rest, samples)?;
        let memory = self.memory.with(&starts, &samples, steps, is_due)?;
        Some((memory, self.calibration(rest)?, is_due))
    }

    fn observations(&self, rest: &mut &[u8], count: u64) -> Option<Vec<f32>> {
        let len = usize::try_from(count).ok()?.checked_mul(self.observation_len)?;
        let (head, tail) = rest.split_at_checked(len.checked_mul(4)?)?;
        *rest = tail;
        let values: Vec<f32> = head.as_chunks().0.iter().map(|word| f32::from_le_bytes(*word)).collect();
        values.iter().all(|value| value.is_finite()).then_some(values)
    }

    fn calibration(&self, bytes: &[u8]) -> Option<Calibration> {
        let (words, rest) = bytes.as_chunks();
        let values: Vec<f64> = words.iter().map(|word| f64::from_le_bytes(*word)).collect();
        let ([radius, margin, starts_inside, experience_inside], scales) = values.split_first_chunk()?;
        let (scales, odd) = scales.as_chunks();
        let is_whole = rest.is_empty() && odd.is_empty() && scales.len() == self.observation_len;
        let is_valid = *radius >= 0.0
            && *margin > 0.0
            && scales.iter().flatten().all(|value| *value >= 0.0)
            && values.iter().all(|value| value.is_finite());
        if !is_whole || !is_valid {
            return None;
        }
        let mut read = Calibration::new(self.observation_len);
        (read.radius, read.margin) = (*radius, *margin);
        (read.starts_inside, read.experience_inside) = (share(*starts_inside)?, share(*experience_inside)?);
        read.scales = scales
            .iter()
            .map(|[per_unit, tolerance]| Scale { per_unit: *per_unit, tolerance: *tolerance })
            .collect();
        Some(read)
    }
}

fn take<const N: usize>(rest: &mut &[u8]) -> Option<[u8; N]> {
    let (head, tail) = rest.split_first_chunk()?;
    *rest = tail;
    Some(*head)
}

/// A share, or that there is none; `None` for what can be neither.
fn share(value: f64) -> Option<Option<f64>> {
    if value == ABSENT {
        return Some(None);
    }
    (0.0..=1.0).contains(&value).then_some(Some(value))
}
