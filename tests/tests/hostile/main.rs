//! What others sent, and machines on which something is missing: errors with their cause, never a panic, and nothing is executed.
#![cfg(target_os = "linux")]
#![allow(clippy::unwrap_used, reason = "tests")]

mod damage;
mod limits_ffi;
mod records;
mod streams;
mod threads;

use std::{
    fs,
    path::{Path, PathBuf},
    process::Output,
};

use shield_tests::shield;
use tempfile::TempDir;

/// A folder in which the experiment ran, with further arguments.
fn ran(experiment: &str, arguments: &[&str]) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("x.ron"), experiment).unwrap();
    let output = shield().current_dir(folder.path()).args(["run", "x.ron"]).args(arguments).output().unwrap();
    assert!(output.status.success(), "{}", said(&output));
    folder
}

/// What a program said on standard error; no program may say that it panicked.
fn said(output: &Output) -> String {
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!text.contains("panicked") && output.status.code() != Some(101), "{text}");
    text
}

/// Checks the exit code of a refusal, and what its message has.
fn refused(output: &Output, code: i32, parts: &[&str]) {
    let message = said(output);
    assert_eq!(output.status.code(), Some(code), "{message}");
    for part in parts {
        assert!(message.contains(part), "{part:?} is missing in: {message}");
    }
}

/// The folder of the run of the variant `default` with the seed 0.
fn first_run(folder: &Path) -> PathBuf {
    folder.join("runs/small/default/seed-0")
}
