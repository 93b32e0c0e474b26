//! How configurations are read: RON as a tree in which every value knows its place.
//!
//! One dialect holds for the host's files and for the configurations of plugins. `Some(field: 1)`, `Some((field: 1))` and
//! `(field: 1)` mean the same where a value is optional, and so do `Name(field: 1)` and `Name((field: 1))`. A text is read once:
//! [`parse`] makes the tree, [`from_node`] reads values out of it, and every [`Fault`] names the place of the value that is wrong.
//! Numbers, texts and characters are read by the `ron` crate.
//!
//! ```
//! use shield_api::notation;
//!
//! #[derive(Debug, serde::Deserialize)]
//! #[serde(deny_unknown_fields)]
//! struct Circle {
//!     radius: Option<f32>,
//! }
//! assert_eq!(notation::from_str::<Circle>("(radius: 2.5)").unwrap().radius, Some(2.5));
//! let text = "(\n    radios: 2.5,\n)";
//! let fault = notation::from_str::<Circle>(text).unwrap_err();
//! assert_eq!(fault.to_string(), "there is no field `radios`, only `radius`; did you mean `radius`?");
//! assert_eq!((fault.position(text).line, fault.position(text).column), (2, 5));
//! ```

mod access;
mod fault;
mod node;
mod parse;
mod path;
mod read;

use serde::Deserialize;

pub use fault::{Fault, did_you_mean, position_at};
pub use node::{Entry, Kind, Node};
pub use parse::{LONGEST, MAX_DEPTH, parse, skip_trivia};
pub use path::{Segment, nearest, segments};

/// The name under which the `ron` crate asks for a value's text as it is written.
pub const RAW_VALUE: &str = "$ron::private::RawValue";

/// Reads a whole text.
///
/// # Errors
/// The first fault, with its place.
pub fn from_str<'de, T: Deserialize<'de>>(text: &'de str) -> Result<T, Fault> {
    from_node(text, &parse(text)?)
}

/// Reads a value of `text`, whose tree or part of a tree `node` is.
///
/// # Errors
/// The first fault, with its place.
pub fn from_node<'de, T: Deserialize<'de>>(text: &'de str, node: &Node) -> Result<T, Fault> {
    T::deserialize(read::Value::new(text, node))
}

#[cfg(test)]
mod tests;
