//! Whole runs with a plugin that ends its own process.

use std::{fs, path::Path, process::Output};

use serde_json::Value;
use shield_tests::shield;

use crate::fixtures::fixture;

/// A run in which the environment ends its process at the 31st step that it makes there.
fn run(folder: &Path, end: &str, isolation: &str) -> Output {
    let library = fixture("deadly");
    let experiment = format!(
        r#"Experiment(
    name: "deadly", steps: 100, seeds: [0], mode: StatusQuo,
    environment: (plugin: "deadly/world", path: {library:?}, config: (end: {end:?}, after: 30), {isolation}),
    forward: Policy(plugin: "deadly/actor", path: {library:?}),
)"#
    );
    fs::write(folder.join("x.ron"), experiment).unwrap();
    shield().current_dir(folder).args(["run", "x.ron"]).output().unwrap()
}

fn summary(folder: &Path) -> Value {
    let path = folder.join("runs/deadly/default/seed-0/summary.json");
    serde_json::from_slice(&fs::read(path).unwrap()).unwrap()
}

#[test]
fn a_segmentation_fault_in_an_isolated_environment_ends_the_program() {
    let folder = tempfile::tempdir().unwrap();
    let output = run(folder.path(), "fault", "isolate: true");
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("segmentation fault") && message.contains("failed after 30 steps"), "{message}");
    let summary = summary(folder.path());
    assert_eq!((&summary["steps"], &summary["complete"]), (&30.into(), &false.into()));
    assert!(summary["error"].as_str().unwrap().contains("deadly/world"), "{summary}");
}

#[test]
fn a_hang_is_not_cut_short_by_the_limit_of_the_experiment() {
    let folder = tempfile::tempdir().unwrap();
    let output = run(folder.path(), "hang", "isolate: true, worker: (step_timeout_s: 0.5)");
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(message.contains("no answer within 0.5 s"), "{message}");
}

#[test]
fn a_lost_world_ends_the_run_although_it_may_be_started_again() {
    let folder = tempfile::tempdir().unwrap();
    let output = run(folder.path(), "exit", "isolate: true, worker: (on_failure: Restart)");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let summary = summary(folder.path());
    assert_eq!((&summary["steps"], &summary["worker_restarts"]), (&100.into(), &3.into()), "{summary}");
    assert_eq!(summary["hard_resets"], 3);
    let metrics = fs::read_to_string(folder.path().join("runs/deadly/default/seed-0/metrics.csv")).unwrap();
    assert_eq!(metrics.matches("worker_lost").count(), 3, "{metrics}");
}

/// A run whose forward policy ends it after 50 actions, with an isolated world that ends its process while it loads the state after `after` steps
/// or more. Says what came of it.
fn ends_while_loading(folder: &Path, after: u32) -> Output {
    let library = fixture("deadly");
    let experiment = format!(
        r#"Experiment(
    name: "deadly", steps: 100, seeds: [0], mode: StatusQuo, checkpoint: (every: 20),
    environment: (plugin: "deadly/world", path: {library:?}, isolate: true, config: (end: "fault", within: "load", after: {after})),
    forward: Policy(plugin: "deadly/actor", path: {library:?}, config: (end: "panic", after: 50)),
)"#
    );
    fs::write(folder.join("x.ron"), experiment).unwrap();
    let output = shield().current_dir(folder).args(["run", "x.ron"]).output().unwrap();
    assert_eq!(output.status.code(), Some(1), "{}", String::from_utf8_lossy(&output.stderr));
    let run = folder.join("runs/deadly/default/seed-0");
    fs::write(run.join("notes.txt"), "mine").unwrap();
    let again = shield().current_dir(folder).args(["resume", "runs"]).output().unwrap();
    assert_eq!(fs::read_to_string(run.join("notes.txt")).unwrap(), "mine");
    assert_eq!(again.status.code(), Some(1), "{}", String::from_utf8_lossy(&again.stderr));
    again
}

#[test]
fn a_state_that_ends_an_isolated_plugin_leaves_the_run_as_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let output = ends_while_loading(folder.path(), 0);
    let message = String::from_utf8_lossy(&output.stderr);
    for part in [
        "latest.bin is refused: `environment`",
        "previous.bin is refused",
        "segmentation fault",
        "--overwrite",
    ] {
        assert!(message.contains(part), "{message}");
    }
    let run = folder.path().join("runs/deadly/default/seed-0");
    assert!(["latest.bin", "previous.bin"].iter().all(|file| run.join("checkpoint").join(file).exists()));
    assert_eq!(summary(folder.path())["steps"], 50);
}

#[test]
fn a_state_that_ends_an_isolated_plugin_is_passed_over_for_the_one_before() {
    let folder = tempfile::tempdir().unwrap();
    let output = ends_while_loading(folder.path(), 40);
    let message = String::from_utf8_lossy(&output.stderr);
    for part in [
        "passed over",
        "latest.bin is refused: `environment`",
        "goes on after 20 steps",
        "failed after 70 steps",
    ] {
        assert!(message.contains(part), "{message}");
    }
}
