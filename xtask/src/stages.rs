//! The stages of the tests.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, ExitCode, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use clap::ValueEnum;

use crate::cargo;
use crate::say::say;

/// A stage by its name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Name {
    /// Unit and integration tests of every crate, with every plugin built
    Core,
    /// The examples in the documentation
    Doc,
}

impl Name {
    /// The calls of Cargo that make up the stage.
    fn calls(self) -> &'static [&'static [&'static str]] {
        match self {
            // `cargo test` alone leaves no plugin for the tests to load: it builds a cdylib's unit tests, not the cdylib.
            Self::Core => &[
                &["build", "--workspace"],
                &["test", "--workspace", "--lib", "--bins", "--tests", "--examples", "--no-fail-fast"],
            ],
            Self::Doc => &[&["test", "--workspace", "--doc", "--no-fail-fast"]],
        }
    }
}

/// How a stage ended.
#[derive(Default)]
struct Outcome {
    tests: Tally,
    succeeded: bool,
    duration: Duration,
}

/// How many tests passed and failed.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
struct Tally {
    passed: u64,
    failed: u64,
}

/// Runs the stages, all if none is named, and prints a table of them.
///
/// # Errors
/// Cargo cannot be started. A failed test is not an error but an exit code.
pub fn run(root: &Path, names: &[Name]) -> anyhow::Result<ExitCode> {
    let names = if names.is_empty() { Name::value_variants() } else { names };
    let mut outcomes = Vec::new();
    for name in names {
        outcomes.push((*name, run_stage(root, *name)?));
    }
    say(format_args!("\n{:<8} {:>10} {:>8} {:>8}  result", "stage", "seconds", "passed", "failed"));
    let mut total = Tally::default();
    for (name, Outcome { tests, succeeded, duration }) in &outcomes {
        let result = if *succeeded { "ok" } else { "FAILED" };
        let (name, seconds) = (format!("{name:?}").to_lowercase(), duration.as_secs_f64());
        say(format_args!("{name:<8} {seconds:>10.1} {:>8} {:>8}  {result}", tests.passed, tests.failed));
        total.passed += tests.passed;
        // A stage that does not compile has no failed test and fails all the same.
        total.failed += if *succeeded { 0 } else { tests.failed.max(1) };
    }
    say(format_args!("\n{} passed, {} failed", total.passed, total.failed));
    Ok(if total.failed == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

fn run_stage(root: &Path, name: Name) -> anyhow::Result<Outcome> {
    let start = Instant::now();
    let mut outcome = Outcome { succeeded: true, ..Outcome::default() };
    for arguments in name.calls() {
        outcome.succeeded = outcome.succeeded && run_call(root, arguments, &mut outcome.tests)?;
    }
    outcome.duration = start.elapsed();
    Ok(outcome)
}

/// Runs the long forms of the tests that draw at random.
///
/// # Errors
/// Cargo cannot be started, or a test fails.
pub fn run_long(root: &Path) -> anyhow::Result<()> {
    for (target, variable, number) in
        [("solvers", "SHIELD_TEST_PROGRAMS", "1000000"), ("kill", "SHIELD_TEST_KILLS", "200")]
    {
        run_some(cargo::command(root).args(["test", "--workspace", "--test", target]).env(variable, number))?;
    }
    Ok(())
}

/// Runs a call of Cargo that selects tests.
///
/// # Errors
/// It cannot be started, it fails, or it selects no test.
pub fn run_some(command: &mut Command) -> anyhow::Result<()> {
    let mut tests = Tally::default();
    if !run_counted(command, &mut tests)? {
        bail!("{} failed", cargo::describe(command));
    }
    if tests.passed == 0 {
        bail!("{} ran no test: give it the name of one that exists", cargo::describe(command));
    }
    Ok(())
}

fn run_call(root: &Path, arguments: &[&str], tests: &mut Tally) -> anyhow::Result<bool> {
    run_counted(cargo::command(root).args(arguments), tests)
}

/// Runs Cargo, shows what it prints, and counts the tests in it.
fn run_counted(command: &mut Command, tests: &mut Tally) -> anyhow::Result<bool> {
    command.stdin(Stdio::null()).stdout(Stdio::piped());
    say(format_args!("$ {}", cargo::describe(command)));
    let mut child = command.spawn().context("cargo could not be started")?;
    let output = child.stdout.take().context("the output of cargo was asked for")?;
    for line in BufReader::new(output).split(b'\n') {
        let line = line.context("the output of cargo could not be read")?;
        let line = String::from_utf8_lossy(&line);
        say(&line);
        if let Some(Tally { passed, failed }) = count(&line) {
            tests.passed += passed;
            tests.failed += failed;
        }
    }
    Ok(child.wait().context("cargo was lost")?.success())
}

/// The figures of a line such as `test result: ok. 18 passed; 0 failed; 0 ignored; …`.
fn count(line: &str) -> Option<Tally> {
    let (_, figures) = line.strip_prefix("test result: ")?.split_once(". ")?;
    let figure = |word: &str| {
        let part = figures.split("; ").find_map(|part| part.strip_suffix(word))?;
        part.trim().parse().ok()
    };
    Some(Tally { passed: figure(" passed")?, failed: figure(" failed")? })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_call_that_runs_no_test_is_an_error() {
        let run = |line: &str| run_some(Command::new("echo").arg(line)).map_err(|error| error.to_string());
        assert_eq!(run("test result: ok. 1 passed; 0 failed; 0 ignored"), Ok(()));
        assert!(run("test result: ok. 0 passed; 0 failed; 0 ignored").unwrap_err().contains("no test"));
        assert!(run_some(&mut Command::new("false")).is_err());
    }

    #[test]
    fn only_lines_of_results_are_counted() {
        let line = "test result: FAILED. 17 passed; 1 failed; 2 ignored; 0 measured; 0 filtered out; finished in 0.01s";
        assert_eq!(count(line), Some(Tally { passed: 17, failed: 1 }));
        for other in ["test a ... ok", "test result: ok.", "17 passed; 1 failed", ""] {
            assert_eq!(count(other), None, "{other}");
        }
    }
}
