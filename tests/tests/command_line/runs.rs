//! What a run leaves in its folder, and what happens to the runs that are there already.

use std::fs;

use shield_tests::{gridworld, run_files, shield, text};

use super::{run, run_in, summary};

#[test]
fn a_run_writes_its_folder_and_prints_a_table() {
    let variants = r#"variants: {"a": [], "b": [("mode", StatusQuo)]},"#;
    let (output, folder) = run(&gridworld(1_000, variants), &[]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let printed = text(&output.stdout);
    for part in ["a ", "b ", "resets", "irreversible", "Runs are in runs/small"] {
        assert!(printed.contains(part), "{part:?} is missing in: {printed}");
    }
    for (variant, seed) in [("a", 0), ("a", 1), ("b", 0), ("b", 1)] {
        let run = folder.path().join(format!("runs/small/{variant}/seed-{seed}"));
        let files = [
            "config.ron",
            "metrics.csv",
            "interventions.csv",
            "evaluations.csv",
            "learning.csv",
            "timings.csv",
        ];
        for file in files {
            assert!(run.join(file).exists(), "{file} is missing");
        }
        let summary = summary(&run);
        assert_eq!(
            (&summary["steps"], &summary["variant"], &summary["seed"]),
            (&1_000.into(), &variant.into(), &seed.into())
        );
        assert_eq!(summary["complete"], true);
        let metrics = fs::read_to_string(run.join("metrics.csv")).unwrap();
        let length: u64 =
            metrics.lines().skip(1).map(|row| row.split(',').nth(3).unwrap().parse::<u64>().unwrap()).sum();
        assert_eq!(length, 1_000, "the episodes add up to the steps");
        let hard_resets = metrics.lines().skip(1).filter(|row| row.split(',').nth(9) == Some("1")).count();
        assert_eq!(summary["hard_resets"], hard_resets);
    }
}

#[test]
fn the_resolved_configuration_gives_the_same_results() {
    let (output, folder) = run(&gridworld(1_000, ""), &["--seeds", "1"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let first = folder.path().join("runs/small/default/seed-1");
    let resolved = fs::read_to_string(first.join("config.ron")).unwrap();
    assert!(resolved.contains("initial_high: 1.0"), "a plugin's defaults are written out: {resolved}");
    let output = run_in(folder.path(), &resolved, &["--out", "again"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let second = folder.path().join("again/small/default/seed-1");
    for file in ["metrics.csv", "interventions.csv", "evaluations.csv", "learning.csv", "config.ron"] {
        assert_eq!(fs::read(first.join(file)).unwrap(), fs::read(second.join(file)).unwrap(), "{file}");
    }
}

#[test]
fn arguments_override_the_experiment() {
    let variants = r#"variants: {"a": [], "b": []},"#;
    let arguments = [
        "--steps",
        "300",
        "--seeds",
        "7",
        "--variants",
        "b",
        "--set",
        "shield.rules[0].config.q_min=0.0",
        "--jobs",
        "1",
    ];
    let (output, folder) = run(&gridworld(1_000, variants), &arguments);
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert!(!folder.path().join("runs/small/a").exists());
    let summary = summary(&folder.path().join("runs/small/b/seed-7"));
    assert_eq!((&summary["steps"], &summary["early_aborts"]), (&300.into(), &0.into()));
}

#[test]
fn an_earlier_run_is_overwritten_only_when_told_to() {
    let (output, folder) = run(&gridworld(200, ""), &["--seeds", "0"]);
    assert!(output.status.success());
    let metrics = folder.path().join("runs/small/default/seed-0/metrics.csv");
    fs::write(&metrics, "precious").unwrap();
    let output = run_in(folder.path(), &gridworld(200, ""), &["--seeds", "1,0"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let kept = "1 run is finished already and kept; --overwrite makes it anew";
    assert!(text(&output.stderr).contains(kept), "{}", text(&output.stderr));
    assert_eq!(fs::read_to_string(&metrics).unwrap(), "precious");
    assert!(folder.path().join("runs/small/default/seed-1/summary.json").exists());
    let output =
        run_in(folder.path(), &gridworld(200, ""), &["--seeds", "2,0", "--set", "experience.batch=8"]);
    assert_eq!(output.status.code(), Some(2));
    let message = text(&output.stderr);
    assert!(message.contains("`experience.batch` is 16") && message.contains("--overwrite"), "{message}");
    assert_eq!(fs::read_to_string(&metrics).unwrap(), "precious");
    assert!(!folder.path().join("runs/small/default/seed-2").exists());
    let output = run_in(folder.path(), &gridworld(200, ""), &["--seeds", "0", "--overwrite"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert_ne!(fs::read_to_string(&metrics).unwrap(), "precious");
}

#[test]
fn a_folder_that_cannot_be_written_fails_the_run() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("runs"), "a file, not a folder").unwrap();
    let output = run_in(folder.path(), &gridworld(200, ""), &[]);
    assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
    assert!(text(&output.stderr).contains("runs/small/default/seed-0"), "{}", text(&output.stderr));
}

#[test]
fn stopped_runs_continue_from_their_folder() {
    let (output, folder) = run(&gridworld(2_000, "checkpoint: (every: 500),"), &["--seeds", "0"]);
    assert!(output.status.success());
    let run = folder.path().join("runs/small/default/seed-0");
    let expected = run_files(&run);
    fs::remove_file(run.join("summary.json")).unwrap();
    let output = shield().current_dir(folder.path()).args(["resume", "runs"]).output().unwrap();
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert!(text(&output.stdout).contains("default"), "{}", text(&output.stdout));
    assert!(run_files(&run) == expected, "the continued run differs");
    let output = shield().current_dir(folder.path()).args(["resume", "."]).output().unwrap();
    let kept = text(&output.stderr);
    assert!(kept.contains("finished already") && !kept.contains("--overwrite"), "{kept}");
    let empty = tempfile::tempdir().unwrap();
    let output = shield().arg("resume").arg(empty.path()).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(text(&output.stderr).contains("no run in it"), "{}", text(&output.stderr));
}
