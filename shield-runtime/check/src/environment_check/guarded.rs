//! Buffers that notice who writes where they must not.

const GUARD: usize = 16;
/// A NaN that nobody writes by accident.
const PATTERN: u32 = 0x7fa5_c3a5;

/// Numbers for a plugin, with guards before and behind them.
pub struct Guarded {
    cells: Vec<f32>,
    /// What an argument holds, so that a plugin that writes into it is found. `None` for a place that it shall write into.
    given: Option<Vec<u32>>,
    what: &'static str,
}

impl Guarded {
    /// An argument: it must stay as it is.
    pub fn input(what: &'static str, values: &[f32]) -> Self {
        let mut input = Self::output(what, values.len());
        input.slice_mut().copy_from_slice(values);
        input.given = Some(bits(values));
        input
    }

    /// A place for an answer.
    pub fn output(what: &'static str, length: usize) -> Self {
        let cells = vec![f32::from_bits(PATTERN); length + 2 * GUARD];
        Self { cells, given: None, what }
    }

    pub fn slice(&self) -> &[f32] {
        &self.cells[GUARD..self.cells.len() - GUARD]
    }

    pub fn slice_mut(&mut self) -> &mut [f32] {
        let end = self.cells.len() - GUARD;
        &mut self.cells[GUARD..end]
    }

    /// What it holds, once it is sure that nothing was written where nothing must be.
    ///
    /// # Errors
    /// A sentence that says what was overwritten.
    pub fn checked(&self) -> Result<&[f32], String> {
        let what = self.what;
        let (before, rest) = self.cells.split_at(GUARD);
        let (values, behind) = rest.split_at(rest.len() - GUARD);
        for (place, guard) in [("before", before), ("behind", behind)] {
            if guard.iter().any(|cell| cell.to_bits() != PATTERN) {
                return Err(format!("it writes {place} the buffer of the {what}"));
            }
        }
        match &self.given {
            Some(given) if *given != bits(values) => {
                Err(format!("it writes into the {what}, which it was given to read"))
            }
            _ => Ok(values),
        }
    }
}

/// Numbers as bits, so that equal means equal.
pub fn bits(values: &[f32]) -> Vec<u32> {
    values.iter().map(|value| value.to_bits()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_write_outside_a_buffer_or_into_an_input_is_noticed() {
        let mut output = Guarded::output("action", 2);
        output.slice_mut().copy_from_slice(&[1.0, f32::NAN]);
        assert!(output.checked().is_ok());
        let end = output.cells.len() - GUARD;
        output.cells[end] = 0.0;
        assert!(output.checked().unwrap_err().contains("behind the buffer of the action"));
        output.cells[end] = f32::from_bits(PATTERN);
        output.cells[GUARD - 1] = 0.0;
        assert!(output.checked().unwrap_err().contains("before"));

        let mut input = Guarded::input("observation", &[f32::NAN]);
        assert!(input.checked().is_ok(), "what was given may be NaN");
        input.slice_mut()[0] = 0.0;
        assert!(input.checked().unwrap_err().contains("given to read"));
    }
}
