//! The other side: a Python program that is asked for times.

use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use shield_tests::workspace;

/// `tests/peers/torch_update.py`, running.
pub struct Torch {
    program: Child,
    requests: ChildStdin,
    answers: BufReader<ChildStdout>,
    version: String,
}

impl Torch {
    pub fn start(python: &Path) -> Self {
        let script = workspace().join("tests/peers/torch_update.py");
        let mut command = Command::new(python);
        command.args(["-W", "ignore"]).arg(script).stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut program = command.spawn().expect("Python starts");
        let requests = program.stdin.take().expect("a pipe was asked for");
        let answers = BufReader::new(program.stdout.take().expect("a pipe was asked for"));
        let mut torch = Self { program, requests, answers, version: String::new() };
        torch.version = torch.line();
        torch
    }

    pub fn version(&self) -> &str {
        &self.version
    }

    /// The seconds that each repetition took.
    pub fn time(&mut self, request: &str) -> Vec<f64> {
        writeln!(self.requests, "{request}").expect("torch listens");
        let line = self.line();
        line.split(' ').map(|seconds| seconds.parse().expect("a number")).collect()
    }

    fn line(&mut self) -> String {
        let mut line = String::new();
        self.answers.read_line(&mut line).expect("torch answers");
        assert!(!line.is_empty(), "torch has ended; its message stands above");
        line.trim_end().to_owned()
    }
}

impl Drop for Torch {
    fn drop(&mut self) {
        // It may have ended by itself; there is nothing left to do then.
        if self.program.kill().is_ok() {
            self.program.wait().expect("it was started");
        }
    }
}
