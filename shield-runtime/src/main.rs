//! The command `shield`.
#![allow(clippy::print_stdout, clippy::print_stderr, reason = "this is the command line")]

mod cli;

use std::process::ExitCode;

fn main() -> ExitCode {
    cli::main()
}
