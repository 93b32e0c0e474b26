//! Runs that end before their time: the disk is full, or the user stops them.

use std::{
    fs,
    process::Stdio,
    time::{Duration, Instant},
};

use shield_tests::{cart, gridworld, run_files, shield, text};
use tempfile::TempDir;

use super::{
    process_ffi::{interrupt, with_files_up_to},
    run, run_in, summary,
};

#[test]
fn a_full_disk_fails_the_run_with_a_message() {
    let folder = tempfile::tempdir().unwrap();
    let experiment = gridworld(4_000, "checkpoint: (every: 500),");
    fs::write(folder.path().join("x.ron"), &experiment).unwrap();
    let mut command = shield();
    command.current_dir(folder.path()).args(["run", "x.ron", "--seeds", "0"]);
    // A limit on the size of files stands for the full disk.
    with_files_up_to(&mut command, 400_000);
    let output = command.output().unwrap();
    assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
    assert!(text(&output.stderr).contains("seed-0"), "{}", text(&output.stderr));
    // With room again, nothing is lost.
    let output = run_in(folder.path(), &experiment, &["--seeds", "0"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert!(text(&output.stderr).contains("goes on after"), "{}", text(&output.stderr));
    let (_, calm) = run(&experiment, &["--seeds", "0"]);
    let files = |folder: &TempDir| run_files(&folder.path().join("runs/small/default/seed-0"));
    assert!(files(&folder) == files(&calm), "the continued run differs");
}

#[test]
fn ctrl_c_finishes_the_row_and_writes_the_summary() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("x.ron"), cart(100_000_000, "")).unwrap();
    let mut child = shield()
        .current_dir(folder.path())
        .args(["run", "x.ron"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let metrics = folder.path().join("runs/cart/default/seed-0/metrics.csv");
    let start = Instant::now();
    while fs::metadata(&metrics).map_or(0, |data| data.len()) < 500 {
        assert!(start.elapsed() < Duration::from_secs(60), "no row was written");
        std::thread::sleep(Duration::from_millis(50));
    }
    interrupt(&child);
    let status = child.wait().unwrap();
    assert_eq!(status.code(), Some(130));
    let summary = summary(metrics.parent().unwrap());
    assert_eq!(summary["complete"], false);
    let rows = fs::read_to_string(&metrics).unwrap();
    let last = rows.lines().last().unwrap();
    assert!(rows.ends_with('\n') && last.contains("interrupted"), "{last}");
    assert_eq!(last.split(',').next().unwrap(), summary["steps"].to_string());
}
