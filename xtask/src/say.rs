//! What a chore prints. A terminal that is gone, or a full disk, ends no chore.

use std::{
    fmt::Display,
    io::{Write, stderr, stdout},
};

/// Prints a line to standard output.
pub fn say(line: impl Display) {
    writeln!(stdout(), "{line}").ok();
}

/// Prints a line to standard error.
pub fn complain(line: impl Display) {
    writeln!(stderr(), "{line}").ok();
}
