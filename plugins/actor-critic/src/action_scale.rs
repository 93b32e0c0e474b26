//! The networks work with actions in [-1, 1]; the world with those of its box.

use crate::Error;

/// The affine map between [-1, 1] and a box, per dimension.
#[derive(Debug, Clone, PartialEq)]
pub struct ActionScale {
    low: Vec<f32>,
    high: Vec<f32>,
    centre: Vec<f32>,
    half_range: Vec<f32>,
}

impl ActionScale {
    /// The map for the given bounds, which must be finite, `low ≤ high`.
    ///
    /// # Errors
    /// [`Error::Bounds`] if they are not.
    pub fn new(low: &[f32], high: &[f32]) -> Result<Self, Error> {
        let is_box = low.len() == high.len()
            && low.iter().zip(high).all(|(low, high)| low <= high && (high - low).is_finite());
        if !is_box {
            return Err(Error::Bounds { low: low.to_vec(), high: high.to_vec() });
        }
        Ok(Self {
            low: low.to_vec(),
            high: high.to_vec(),
            centre: low.iter().zip(high).map(|(low, high)| low + (high - low) / 2.0).collect(),
            half_range: low.iter().zip(high).map(|(low, high)| (high - low) / 2.0).collect(),
        })
    }

    pub(crate) fn low(&self) -> &[f32] {
        &self.low
    }

    pub(crate) fn high(&self) -> &[f32] {
        &self.high
    }

    /// How many dimensions there are.
    pub fn len(&self) -> usize {
        self.low.len()
    }

    /// Whether there is no dimension at all.
    pub fn is_empty(&self) -> bool {
        self.low.is_empty()
    }

    /// From the box to [-1, 1], row by row. A dimension without extent becomes 0.
    pub fn to_unit(&self, actions: &[f32], unit: &mut [f32]) {
        for (row, unit) in actions.chunks_exact(self.len()).zip(unit.chunks_exact_mut(self.len())) {
            for (index, value) in unit.iter_mut().enumerate() {
                *value = match self.half_range[index] {
                    0.0 => 0.0,
                    half_range => (row[index] - self.centre[index]) / half_range,
                };
            }
        }
    }

    /// From [-1, 1] to the box; what lies outside, by noise or rounding, goes to the nearest bound. NaN stays NaN.
    pub fn from_unit(&self, unit: &[f32], action: &mut [f32]) {
        for (index, value) in action.iter_mut().enumerate() {
            let scaled = unit[index].mul_add(self.half_range[index], self.centre[index]);
            *value = scaled.clamp(self.low[index], self.high[index]);
        }
    }

    /// Turns ∂Q/∂unit into ∂Q/∂action. A dimension without extent gets 0.
    pub fn gradient_to_box(&self, gradient: &mut [f32]) {
        for (value, half_range) in gradient.iter_mut().zip(&self.half_range) {
            *value = if *half_range == 0.0 { 0.0 } else { *value / half_range };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ends_of_the_unit_interval_map_to_the_bounds() {
        let scale = ActionScale::new(&[-2.0, 1.0, 5.0], &[4.0, 3.0, 5.0]).unwrap();
        let mut action = [0.0; 3];
        scale.from_unit(&[-1.0, 1.0, 0.3], &mut action);
        assert_eq!(action, [-2.0, 3.0, 5.0]);
        scale.from_unit(&[-1.5, 9.0, 0.3], &mut action);
        assert_eq!(action, [-2.0, 3.0, 5.0]);
        let mut unit = [9.0; 3];
        scale.to_unit(&[1.0, 1.0, 5.0], &mut unit);
        assert_eq!(unit, [0.0, -1.0, 0.0]);
        let mut gradient = [3.0; 3];
        scale.gradient_to_box(&mut gradient);
        assert_eq!(gradient, [1.0, 3.0, 0.0]);
    }

    #[test]
    fn a_box_without_bounds_is_refused() {
        assert!(ActionScale::new(&[0.0], &[f32::INFINITY]).is_err());
        assert!(ActionScale::new(&[1.0], &[0.0]).is_err());
        assert!(ActionScale::new(&[f32::NAN], &[0.0]).is_err());
    }
}
