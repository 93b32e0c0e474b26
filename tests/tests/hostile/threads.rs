//! Machines on which no thread can be started.

use std::{path::Path, process::Output};

use shield_tests::{gridworld, shield};

use crate::{first_run, limits_ffi::without_threads, ran, refused};

fn call(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = shield();
    without_threads(command.current_dir(folder).args(arguments)).output().unwrap()
}

#[test]
fn a_run_without_a_thread_is_an_error_and_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("x.ron"), gridworld(300, "")).unwrap();
    let output = call(folder.path(), &["run", "x.ron"]);
    refused(&output, 1, &["error: a thread cannot be started: ", "`ulimit -u`"]);
    assert!(!folder.path().join("runs").exists());
}

#[test]
fn an_evaluation_whose_threads_cannot_be_started_says_so() {
    let folder = ran(&gridworld(300, "threads: 2,"), &["--seeds", "0"]);
    let output = call(folder.path(), &["eval", "runs", "--episodes", "4"]);
    refused(&output, 2, &["2 threads cannot be started"]);
    assert!(first_run(folder.path()).join("summary.json").exists());
}

#[test]
fn a_film_needs_no_thread() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("x.ron"), gridworld(300, "")).unwrap();
    let output = call(folder.path(), &["render", "x.ron", "--out", "x.png", "--steps", "3"]);
    assert!(output.status.success(), "{}", crate::said(&output));
}

#[test]
fn checks_whose_threads_cannot_be_started_fail_with_the_reason() {
    let folder = tempfile::tempdir().unwrap();
    let output = call(folder.path(), &["env", "check", "gridworld"]);
    refused(&output, 1, &["gridworld fails 1 of "]);
    assert!(String::from_utf8_lossy(&output.stdout).contains("a thread cannot be started"));
    let output = call(folder.path(), &["plugin", "check", "tabular-q"]);
    refused(&output, 1, &["a check cannot be run: "]);
}
