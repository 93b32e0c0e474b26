//! Pictures that environments draw.

use crate::{Error, Result};

/// A picture to be drawn by [`Environment::render`](crate::Environment::render): rows from the top, pixels from the left, three bytes each:
/// red, green, blue.
#[derive(Debug)]
pub struct Frame<'a> {
    width: usize,
    height: usize,
    pixels: &'a mut [u8],
    shades: &'a [f32],
}

impl<'a> Frame<'a> {
    /// A picture in the caller's buffer of `3 × width × height` bytes.
    ///
    /// # Errors
    /// The buffer has another length, or there is no pixel in it.
    pub fn new(width: usize, height: usize, pixels: &'a mut [u8]) -> Result<Self> {
        let length = width.checked_mul(height).and_then(|pixels| pixels.checked_mul(3));
        if length != Some(pixels.len()) || pixels.is_empty() {
            return Err(Error::invalid_argument(format!(
                "a picture of {width} × {height} pixels does not fit in {} bytes, three per pixel",
                pixels.len()
            )));
        }
        Ok(Self { width, height, pixels, shades: &[] })
    }

    /// Adds a figure for each observation of a discrete space, from 0 to 1, or NaN where there is none: an environment that can show where
    /// its observations lie shades them by it; every other ignores it.
    pub fn with_shades(mut self, shades: &'a [f32]) -> Self {
        self.shades = shades;
        self
    }

    /// Pixels in a row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// The bytes, `3 × width × height`.
    pub fn pixels(&mut self) -> &mut [u8] {
        self.pixels
    }

    /// What [`with_shades`](Self::with_shades) added; empty if nothing.
    pub fn shades(&self) -> &'a [f32] {
        self.shades
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_buffer_of_another_size_is_refused() {
        let mut bytes = [0; 12];
        assert!(Frame::new(2, 2, &mut bytes).is_ok());
        for (width, height) in [(2, 1), (3, 2), (0, 2), (usize::MAX, 2)] {
            assert!(Frame::new(width, height, &mut bytes).is_err(), "{width} × {height}");
        }
        assert!(Frame::new(0, 0, &mut []).is_err());
    }
}
