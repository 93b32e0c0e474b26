//! Checks that several learners make of their settings, their batches and their networks' answers.

use crate::Error;

fn check(
    is_valid: bool,
    name: &'static str,
    value: impl Into<f64>,
    allowed: &'static str,
) -> Result<(), Error> {
    if is_valid { Ok(()) } else { Err(Error::Setting { name, value: value.into(), allowed }) }
}

/// Refuses a setting that is not finite.
///
/// # Errors
/// [`Error::Setting`].
pub fn check_finite_setting(name: &'static str, value: impl Into<f64>) -> Result<(), Error> {
    let value = value.into();
    check(value.is_finite(), name, value, "finite")
}

/// Refuses a setting that is not a positive number.
///
/// # Errors
/// [`Error::Setting`].
pub fn check_positive(name: &'static str, value: impl Into<f64>) -> Result<(), Error> {
    let value = value.into();
    check(value.is_finite() && value > 0.0, name, value, "a positive number")
}

/// Refuses a setting that is negative or not finite.
///
/// # Errors
/// [`Error::Setting`].
pub fn check_not_negative(name: &'static str, value: impl Into<f64>) -> Result<(), Error> {
    let value = value.into();
    check(value.is_finite() && value >= 0.0, name, value, "0 or more")
}

/// Refuses a setting outside [0, 1].
///
/// # Errors
/// [`Error::Setting`].
pub fn check_share(name: &'static str, value: impl Into<f64>) -> Result<(), Error> {
    let value = value.into();
    check((0.0..=1.0).contains(&value), name, value, "in [0, 1]")
}

/// Refuses a setting outside [0, 1).
///
/// # Errors
/// [`Error::Setting`].
pub fn check_below_one(name: &'static str, value: impl Into<f64>) -> Result<(), Error> {
    let value = value.into();
    check((0.0..1.0).contains(&value), name, value, "at least 0 and below 1")
}

/// Refuses hidden layers that cannot be built: none, or one without units.
///
/// # Errors
/// [`Error::HiddenLayers`].
pub fn check_layers(name: &'static str, layers: &[usize]) -> Result<(), Error> {
    let is_valid = !layers.is_empty() && !layers.contains(&0);
    if is_valid { Ok(()) } else { Err(Error::HiddenLayers { name, layers: layers.to_vec() }) }
}

/// Refuses an argument of the wrong length or with a value that is not finite.
pub(crate) fn check_argument(what: &'static str, values: &[f32], expected: usize) -> Result<(), Error> {
    check_length(what, values, expected)?;
    match not_finite(values) {
        None => Ok(()),
        Some(index) => Err(Error::ArgumentNotFinite { what, index, value: values[index] }),
    }
}

/// Refuses an argument of the wrong length.
pub(crate) fn check_length(what: &'static str, values: &[f32], expected: usize) -> Result<(), Error> {
    if values.len() == expected { Ok(()) } else { Err(Error::Length { what, found: values.len(), expected }) }
}

fn not_finite(values: &[f32]) -> Option<usize> {
    values.iter().position(|value| !value.is_finite())
}

/// Refuses an argument of the wrong length or with a value outside [0, 1]: continuations and masks.
///
/// # Errors
/// [`Error::Length`], or [`Error::OutsideUnit`] for the first such value.
pub fn check_unit(what: &'static str, values: &[f32], expected: usize) -> Result<(), Error> {
    check_length(what, values, expected)?;
    match values.iter().position(|value| !(0.0..=1.0).contains(value)) {
        None => Ok(()),
        Some(index) => Err(Error::OutsideUnit { what, index, value: values[index] }),
    }
}

/// Refuses what the networks answered if it is not finite.
///
/// # Errors
/// [`Error::OutputNotFinite`] for the first such value.
pub fn check_finite_output(what: &'static str, values: &[f32]) -> Result<(), Error> {
    match not_finite(values) {
        None => Ok(()),
        Some(index) => Err(Error::OutputNotFinite { what, index, value: values[index] }),
    }
}
