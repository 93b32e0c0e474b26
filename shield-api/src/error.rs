//! What can go wrong in a plugin, as both sides of the boundary see it.

use std::fmt;

/// Result of everything that a plugin does.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// The class of a failure. The host decides by it; the message is for people.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ErrorKind {
    /// An argument has the wrong length, is not finite, or is outside its space.
    InvalidArgument,
    /// The plugin's own configuration is wrong; [`Error::position`] may say where.
    InvalidConfig,
    /// The plugin does not offer this ability. A legal answer to `save`, `load` and `linearise`.
    Unsupported,
    /// The plugin tried and failed.
    Failed,
    /// The plugin panicked. The instance must not be called again, except to destroy it.
    Panicked,
}

/// Line and column in a plugin's configuration text, both counted from 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Position {
    /// Line, from 1.
    pub line: u32,
    /// Column in characters, from 1.
    pub column: u32,
}

/// A failure of a plugin: a kind, a sentence that a person can act on, and perhaps a place.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Error {
    kind: ErrorKind,
    message: String,
    position: Option<Position>,
    field: Option<Box<str>>,
}

impl Error {
    /// An error of the given kind.
    pub fn new(kind: ErrorKind, message: impl Into<String>) -> Self {
        Self { kind, message: message.into(), position: None, field: None }
    }

    /// The plugin tried and failed.
    pub fn failed(message: impl Into<String>) -> Self {
        Self::new(ErrorKind::Failed, message)
    }

    /// An argument is wrong: name the argument, what was expected and what came.
    pub fn invalid_argument(message: impl Into<String>) -> Self {
        Self::new(ErrorKind::InvalidArgument, message)
    }

    /// A configuration value is wrong: say its value and what is allowed, and name its field with [`in_field`](Self::in_field).
    pub fn invalid_config(message: impl Into<String>) -> Self {
        Self::new(ErrorKind::InvalidConfig, message)
    }

    /// The ability does not exist in this plugin.
    pub fn unsupported(ability: impl fmt::Display) -> Self {
        Self::new(ErrorKind::Unsupported, format!("{ability} is not supported by this plugin"))
    }

    /// The same error with a place in the configuration text.
    #[must_use]
    pub fn at(mut self, line: u32, column: u32) -> Self {
        self.position = Some(Position { line, column });
        self
    }

    /// The same error about a field of the plugin's configuration, such as `final_q_min` or `constraints[0].a`. Of an error of
    /// [`Plugin::create`](crate::Plugin::create), the user is told where in the file that field stands.
    #[must_use]
    pub fn in_field(mut self, path: impl Into<String>) -> Self {
        self.field = Some(path.into().into());
        self
    }

    /// The class of the failure.
    pub fn kind(&self) -> ErrorKind {
        self.kind
    }

    /// The sentence for a person.
    pub fn message(&self) -> &str {
        &self.message
    }

    /// Where in the plugin's configuration text, where that is known.
    pub fn position(&self) -> Option<Position> {
        self.position
    }

    /// The path of the field in the plugin's configuration that is wrong, where that is known.
    pub fn field(&self) -> Option<&str> {
        self.field.as_deref()
    }
}

impl fmt::Display for Error {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(&self.message)
    }
}

impl std::error::Error for Error {}

/// Refuses a slice of the wrong length. `what` names the argument.
///
/// # Errors
/// [`ErrorKind::InvalidArgument`], naming both lengths.
#[inline]
pub fn check_length(what: &str, slice: &[f32], expected: usize) -> Result<()> {
    if slice.len() == expected { Ok(()) } else { Err(wrong_length(what, slice.len(), expected)) }
}

#[cold]
fn wrong_length(what: &str, length: usize, expected: usize) -> Error {
    Error::invalid_argument(format!("{what} has {length} values, expected {expected}"))
}

/// Refuses a slice of the wrong length or with a value that is NaN or infinite. `what` names the argument.
///
/// # Errors
/// [`ErrorKind::InvalidArgument`], naming the length or the first offending value.
#[inline]
pub fn check_finite(what: &str, slice: &[f32], expected: usize) -> Result<()> {
    check_length(what, slice, expected)?;
    match slice.iter().position(|value| !value.is_finite()) {
        None => Ok(()),
        Some(index) => Err(not_finite(what, index, slice[index])),
    }
}

#[cold]
fn not_finite(what: &str, index: usize, value: f32) -> Error {
    Error::invalid_argument(format!("{what}[{index}] is {value}"))
}
