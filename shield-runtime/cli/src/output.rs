//! What the program prints: the result of a command, and notes and messages beside it.

use std::{
    fmt::{self, Display},
    io::{self, ErrorKind, Write},
};

use super::Failure;

/// Prints what the command was asked for, with a line break at its end. A reader such as `head` may have seen enough: that is no fault.
pub fn result(text: impl Display) -> Result<(), Failure> {
    match write(&mut io::stdout(), format_args!("{text}\n")) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            Err(Failure::Run(format!("the result cannot be written to standard output: {error}")))
        }
        _ => Ok(()),
    }
}

/// Prints to standard output what stands in a file, too: the command has succeeded even where nobody can read it.
pub fn note(text: impl Display) {
    write(&mut io::stdout(), format_args!("{text}\n")).ok();
}

/// Prints to standard error. Where that cannot be written, there is nobody to tell.
pub fn message(text: impl Display) {
    write(&mut io::stderr(), format_args!("{text}\n")).ok();
}

/// In one piece, so that lines of several threads do not mix.
fn write(stream: &mut impl Write, text: fmt::Arguments<'_>) -> io::Result<()> {
    stream.write_all(text.to_string().as_bytes())?;
    stream.flush()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A stream in which there is no room for what is written.
    struct Full;

    impl Write for Full {
        fn write(&mut self, _: &[u8]) -> io::Result<usize> {
            Err(ErrorKind::StorageFull.into())
        }

        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn a_full_stream_is_an_error_and_no_panic() {
        let error = write(&mut Full, format_args!("a line\n")).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::StorageFull);
    }
}
