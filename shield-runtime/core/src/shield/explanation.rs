//! The sentence that explains a rejection.

use std::fmt::{Display, Write};

use shield_api::{ErrorKind, Reason};

use crate::decision::{Abort, Cause};

const CAPACITY: usize = 480;

/// A sentence in a buffer of its own; what does not fit is cut.
pub(super) struct Explanation {
    buffer: [u8; CAPACITY],
    length: usize,
    /// Something that was asked will never answer again.
    pub is_final: bool,
}

impl Explanation {
    pub fn new() -> Self {
        Self { buffer: [0; CAPACITY], length: 0, is_final: false }
    }

    pub fn clear(&mut self) {
        self.length = 0;
    }

    /// Forgets the sentence, unless it says why nothing will be decided any more.
    pub fn forget(&mut self) {
        if !self.is_final {
            self.clear();
        }
    }

    pub fn text(&self) -> &str {
        std::str::from_utf8(&self.buffer[..self.length]).unwrap_or("")
    }

    /// Adds to the sentence.
    pub fn append(&mut self, addition: impl Display) {
        let mut rest = Reason::new(&mut self.buffer[self.length..]);
        // A reason takes what fits and never fails.
        write!(rest, "{addition}").ok();
        self.length += rest.len();
    }

    /// Explains an abort by its error.
    pub fn failed(&mut self, cause: Cause, error: &shield_api::Error) -> Abort {
        self.clear();
        self.append(error);
        self.is_final |= error.kind() == ErrorKind::Panicked;
        Abort::without_rule(cause)
    }
}

#[cfg(test)]
mod tests {
    use shield_api::Error;

    use super::*;

    #[test]
    fn only_the_reason_of_a_panic_is_kept() {
        let mut why = Explanation::new();
        why.failed(Cause::RuleFailed, &Error::failed("not today"));
        why.forget();
        assert_eq!(why.text(), "");
        why.failed(Cause::RuleFailed, &Error::new(ErrorKind::Panicked, "never again"));
        why.forget();
        assert_eq!(why.text(), "never again");
    }
}
