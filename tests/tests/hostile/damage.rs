//! Damaged files of a run.

use std::{
    fs,
    path::{Path, PathBuf},
};

use shield_runtime::run::read_decisions;
use shield_tests::{call, gridworld};
use tempfile::TempDir;

use crate::{first_run, ran, refused, said};

/// Bytes of [`decided`]'s file in whose place others make the library that reads it panic, each in another way.
const DAMAGE: [&[(usize, u8)]; 2] =
    [&[(210, 0x1c), (2144, 0x85)], &[(1559, 0x10), (2516, 0x1a), (2162, 0xcc)]];

/// A short run with recorded decisions, and their file.
fn decided() -> (TempDir, PathBuf) {
    let folder = ran(&gridworld(40, ""), &["--seeds", "0"]);
    let part = first_run(folder.path()).join("decisions/part-000000.parquet");
    (folder, part)
}

/// Reading the decisions gives them, or an error that names their file.
fn check(run: &Path, part: &Path, damage: &[(usize, u8)]) {
    if let Err(error) = read_decisions(run, |_| Ok(true)) {
        let message = format!("{error:#}");
        assert!(message.starts_with(&part.display().to_string()), "{damage:?}: {message}");
    }
}

#[test]
fn damaged_decisions_are_an_error_that_names_their_file() {
    let (folder, part) = decided();
    let run = first_run(folder.path());
    let whole = fs::read(&part).unwrap();
    let flipped: Vec<_> = (0..whole.len()).step_by(5).map(|at| [(at, whole[at] ^ 1)]).collect();
    for damage in DAMAGE.into_iter().chain(flipped.iter().map(|damage| &damage[..])) {
        let mut bytes = whole.clone();
        damage.iter().for_each(|(at, value)| bytes[*at] = *value);
        fs::write(&part, bytes).unwrap();
        check(&run, &part, damage);
    }
    for length in (0..whole.len()).step_by(50) {
        fs::write(&part, &whole[..length]).unwrap();
        check(&run, &part, &[]);
    }
}

#[test]
fn commands_refuse_damaged_decisions_by_the_name_of_their_file() {
    let (folder, part) = decided();
    let whole = fs::read(&part).unwrap();
    for damage in DAMAGE {
        let mut bytes = whole.clone();
        damage.iter().for_each(|(at, value)| bytes[*at] = *value);
        fs::write(&part, bytes).unwrap();
        let run = "runs/small/default/seed-0";
        for arguments in [&["report", "runs/small"][..], &["what-if", run, "--q-min", "0.1"]] {
            refused(&call(folder.path(), arguments), 2, &["part-000000.parquet is damaged: "]);
        }
    }
}

#[test]
fn an_explanation_says_that_the_decisions_are_damaged() {
    let folder = ran(&gridworld(600, ""), &["--seeds", "0"]);
    let part = first_run(folder.path()).join("decisions/part-000000.parquet");
    let whole = fs::read(&part).unwrap();
    fs::write(&part, &whole[..whole.len() - 1]).unwrap();
    let output = call(folder.path(), &["explain", "runs/small/default/seed-0"]);
    let explained = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{}", said(&output));
    assert!(
        explained.contains("  members    ") && explained.contains("part-000000.parquet is damaged"),
        "{explained}"
    );
}
