//! The command `shield` as a user meets it: what it writes, what it refuses, and with which exit code.
#![allow(clippy::unwrap_used, reason = "tests")]

mod evaluations;
mod examples;
#[cfg(target_os = "linux")]
mod interruptions;
#[cfg(target_os = "linux")]
mod process_ffi;
mod refusals;
mod runs;

use std::{
    fs,
    path::Path,
    process::{Output, Stdio},
};

use serde_json::Value;
use shield_tests::{shield, text};
use tempfile::TempDir;

/// Runs `experiment` in a folder of its own.
fn run(experiment: &str, arguments: &[&str]) -> (Output, TempDir) {
    let folder = tempfile::tempdir().unwrap();
    let output = run_in(folder.path(), experiment, arguments);
    (output, folder)
}

fn run_in(folder: &Path, experiment: &str, arguments: &[&str]) -> Output {
    fs::write(folder.join("x.ron"), experiment).unwrap();
    shield().current_dir(folder).args(["run", "x.ron"]).args(arguments).output().unwrap()
}

fn summary(run: &Path) -> Value {
    serde_json::from_slice(&fs::read(run.join("summary.json")).unwrap()).unwrap()
}

#[test]
fn the_list_of_plugins_names_them() {
    let output = shield().args(["plugin", "list"]).output().unwrap();
    assert!(output.status.success());
    let printed = text(&output.stdout);
    for part in [
        "crossq",
        "ddpg",
        "ddqn",
        "sac",
        "td3",
        "gridworld",
        "mujoco/cliff-cart",
        "mujoco/cliff-cheetah",
        "near-start",
        "calibrated-start",
        "success-critic",
        "tabular-success",
        "undo-probability",
        "ensemble-threshold",
    ] {
        assert!(printed.contains(part), "{part} is missing in: {printed}");
    }
}

#[test]
fn help_shows_examples_and_options() {
    for (arguments, expected) in [(&["--help"][..], "Examples:"), (&["run", "--help"], "--overwrite")] {
        let output = shield().args(arguments).output().unwrap();
        assert!(output.status.success() && text(&output.stdout).contains(expected));
    }
}

#[test]
fn a_broken_pipe_is_not_an_error() {
    let mut list = shield();
    list.args(["plugin", "list"]).stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = list.spawn().unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success() && output.stderr.is_empty(), "{}", text(&output.stderr));
}
