//! How a worker can fail.

use std::{fmt, os::unix::process::ExitStatusExt, process::ExitStatus, time::Duration};

use thiserror::Error;

/// Why there is no answer. Each message ends with the last lines that the child printed.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum WorkerError {
    /// The command does not start, or the channel cannot be made.
    #[error("the worker {program:?} could not be started: {reason}")]
    Start {
        /// The program.
        program: String,
        /// What the system says.
        reason: String,
    },
    /// The child has ended.
    #[error("the worker process {ending}{}", printed(last_lines))]
    Died {
        /// How.
        ending: Ending,
        /// The last lines that it printed.
        last_lines: String,
    },
    /// No answer came in time; the child was ended.
    #[error("the worker process gave no answer within {} s and was ended{}", limit.as_secs_f64(), printed(last_lines))]
    Hung {
        /// How long it was waited for.
        limit: Duration,
        /// The last lines that it printed.
        last_lines: String,
    },
    /// The channel broke, or the child rang without an answer; it was ended.
    #[error("the worker process does not keep to the protocol: {reason}{}", printed(last_lines))]
    Protocol {
        /// What it did.
        reason: String,
        /// The last lines that it printed.
        last_lines: String,
    },
}

fn printed(last_lines: &str) -> String {
    if last_lines.is_empty() {
        "; it printed nothing".into()
    } else {
        format!("; the last that it printed:\n{last_lines}")
    }
}

/// How a process ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ending {
    /// By itself, with this exit code.
    Exit(i32),
    /// By this signal.
    Signal(i32),
}

impl From<ExitStatus> for Ending {
    fn from(status: ExitStatus) -> Self {
        match status.signal() {
            Some(signal) => Self::Signal(signal),
            None => Self::Exit(status.code().unwrap_or_default()),
        }
    }
}

/// As the end of "the process …".
impl fmt::Display for Ending {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Exit(code) => write!(formatter, "ended with exit code {code}"),
            Self::Signal(signal) => write!(formatter, "died of signal {signal}{}", meaning(*signal)),
        }
    }
}

/// What a signal that ends processes means; the numbers of the others say enough.
fn meaning(signal: i32) -> &'static str {
    use rustix::process::Signal;
    const MEANINGS: [(Signal, &str); 9] = [
        (Signal::ABORT, " (abort, or a panic that aborts)"),
        (Signal::SEGV, " (segmentation fault)"),
        (Signal::BUS, " (bus error)"),
        (Signal::FPE, " (arithmetic fault)"),
        (Signal::ILL, " (illegal instruction)"),
        (Signal::KILL, " (killed from outside, for example for want of memory)"),
        (Signal::TERM, " (told to end)"),
        (Signal::INT, " (interrupted)"),
        (Signal::PIPE, " (broken pipe)"),
    ];
    let known = MEANINGS.iter().find(|(known, _)| known.as_raw() == signal);
    known.map_or("", |(_, meaning)| meaning)
}
