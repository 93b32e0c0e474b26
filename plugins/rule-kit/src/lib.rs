#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod combine;

use std::{
    cell::RefCell,
    fmt::{Arguments, Write},
};

use shield_api::{Error, Reason, Result, Rows, check_length};

pub use combine::Combine;

/// Refuses a context in which the reset ensemble's values are missing.
///
/// # Errors
/// They are.
pub fn require_values(values: &[f32]) -> Result<()> {
    if values.is_empty() {
        return Err(Error::invalid_argument("the reset ensemble's values are missing; this rule needs them"));
    }
    Ok(())
}

/// Refuses undo probabilities of this name that are missing, not one of each member, or outside [0, 1].
///
/// # Errors
/// They are such.
pub fn require_probabilities(name: &str, probabilities: &[f32], members: usize) -> Result<()> {
    if probabilities.is_empty() {
        let message = format!("the {name} are missing; this rule needs a success critic");
        return Err(Error::invalid_argument(message));
    }
    check_length(name, probabilities, members)?;
    // Written so that NaN is refused.
    match probabilities.iter().position(|value| !(0.0..=1.0).contains(value)) {
        None => Ok(()),
        Some(member) => {
            let value = probabilities[member];
            Err(Error::invalid_argument(format!("{name}[{member}] is {value}, which is no probability")))
        }
    }
}

/// Refuses a setting of this name that is not finite.
///
/// # Errors
/// It is NaN or infinite.
pub fn require_finite(name: &str, value: f32) -> Result<()> {
    if value.is_finite() {
        return Ok(());
    }
    Err(Error::invalid_config(format!("{name} is {value}, but must be finite")).in_field(name))
}

/// Writes why an action is rejected.
///
/// # Errors
/// The host's buffer refuses it.
pub fn explain(reason: &mut Reason<'_>, words: Arguments<'_>) -> Result<()> {
    reason.write_fmt(words).map_err(|error| Error::failed(error.to_string()))
}

/// The sum of products, added in `f64`.
pub fn dot(left: &[f32], right: &[f32]) -> f64 {
    left.iter().zip(right).map(|(left, right)| f64::from(*left) * f64::from(*right)).sum()
}

/// The mean, added in `f64`; NaN of nothing.
pub fn mean(values: impl ExactSizeIterator<Item = f32>) -> f64 {
    let count = values.len() as f64;
    values.map(f64::from).sum::<f64>() / count
}

/// Room for a row `A a ≤ b`, reused from row to row.
#[derive(Debug, Default)]
pub struct Row(RefCell<Vec<f32>>);

impl Row {
    /// Adds the row under which a figure reaches `threshold`: near the proposed action a₀ the figure is value + g·(a − a₀), so that it does
    /// where −g·a ≤ value − g·a₀ − threshold. `gradient` gives g.
    ///
    /// # Errors
    /// The row is refused.
    pub fn push_at_least(
        &self,
        proposed: &[f32],
        value: f32,
        gradient: impl Iterator<Item = f32>,
        threshold: f32,
        rows: &mut dyn Rows,
    ) -> Result<()> {
        let mut row = self.0.borrow_mut();
        row.clear();
        row.extend(gradient.map(|slope| -slope));
        rows.push(&row, (f64::from(value) + dot(&row, proposed) - f64::from(threshold)) as f32)
    }

    /// Adds the row under which a figure stays at or below `limit`.
    ///
    /// # Errors
    /// The row is refused.
    pub fn push_at_most(
        &self,
        proposed: &[f32],
        value: f32,
        gradient: impl Iterator<Item = f32>,
        limit: f32,
        rows: &mut dyn Rows,
    ) -> Result<()> {
        self.push_at_least(proposed, -value, gradient.map(|slope| -slope), -limit, rows)
    }
}

/// Room for the difference of two figures of each member, reused from action to action.
#[derive(Debug, Default)]
pub struct Differences(RefCell<Vec<f32>>);

impl Differences {
    /// Hands `figures` less `others`, member by member, to `use_them`.
    ///
    /// # Errors
    /// There are more of one than of the other; or that of `use_them`.
    pub fn with<T>(
        &self,
        figures: &[f32],
        others: &[f32],
        use_them: impl FnOnce(&[f32]) -> Result<T>,
    ) -> Result<T> {
        check_length("the greedy action's figures", others, figures.len())?;
        let mut differences = self.0.borrow_mut();
        differences.clear();
        differences.extend(figures.iter().zip(others).map(|(figure, other)| figure - other));
        use_them(&differences)
    }
}

/// [`Checkpoint`](shield_api::Checkpoint) for rules without state: theirs is empty, and no other is taken.
#[macro_export]
macro_rules! stateless {
    ($rule:ty) => {
        impl shield_api::Checkpoint for $rule {
            fn save(&self, _bytes: &mut Vec<u8>) -> shield_api::Result<()> {
                Ok(())
            }

            fn load(&mut self, bytes: &[u8]) -> shield_api::Result<()> {
                if bytes.is_empty() {
                    return Ok(());
                }
                let message = format!("this rule has no state, but {} bytes are given", bytes.len());
                Err(shield_api::Error::invalid_argument(message))
            }
        }
    };
}
