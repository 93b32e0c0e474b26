//! `kill -9` at random moments: a run that was killed and continued is the run that never was, byte for byte, and nothing is lost.
//!
//! `cargo xtask test --long` kills 200 times.
#![cfg(unix)]
#![allow(clippy::unwrap_used, reason = "tests")]

use std::{
    collections::BTreeMap,
    fs,
    path::Path,
    process::{Child, Command, Stdio},
    time::{Duration, Instant},
};

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use shield_tests::{cart, gridworld, run_files, shield, with_shield};

fn kills() -> u32 {
    std::env::var("SHIELD_TEST_KILLS").map_or(5, |number| number.parse().unwrap())
}

/// The command again, as the program advises: a run that was killed before its first checkpoint must be begun anew.
fn command(folder: &Path, run: &Path) -> Command {
    let mut command = shield();
    command.current_dir(folder).args(["run", "x.ron", "--seeds", "0"]);
    let has_checkpoint =
        ["latest.bin", "previous.bin"].iter().any(|file| run.join("checkpoint").join(file).exists());
    if run.join("config.ron").exists() && !has_checkpoint {
        command.arg("--overwrite");
    }
    command.stdout(Stdio::null()).stderr(Stdio::from(fs::File::create(folder.join("stderr")).unwrap()));
    command
}

fn said(folder: &Path) -> String {
    fs::read_to_string(folder.join("stderr")).unwrap()
}

/// Whether the program ended by itself before it was killed.
fn ends_within(mut child: Child, patience: Duration) -> bool {
    let start = Instant::now();
    loop {
        if let Some(status) = child.try_wait().unwrap() {
            assert!(status.success(), "a continued run failed: {status}");
            return true;
        }
        if start.elapsed() >= patience {
            // SIGKILL on Unix.
            child.kill().unwrap();
            child.wait().unwrap();
            return false;
        }
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// The steps from which the program said that it goes on; 0 if it began anew.
fn steps_before(folder: &Path) -> u64 {
    let said = said(folder);
    let after = said.split("goes on after ").nth(1).and_then(|rest| rest.split(' ').next());
    after.map_or(0, |steps| steps.parse().unwrap())
}

/// Kills runs of `experiment` until there were enough kills, each at a moment drawn from the time that a whole run takes.
fn survives(experiment: &str, name: &str) {
    let home = || {
        let home = tempfile::tempdir().unwrap();
        fs::write(home.path().join("x.ron"), experiment).unwrap();
        home
    };
    let run = |home: &Path| home.join(format!("runs/{name}/default/seed-0"));
    let results = |home: &Path| run_files(&run(home));
    let start_in = |home: &Path| command(home, &run(home)).spawn().unwrap();
    let calm = home();
    // The first start may build the program; only the second is measured.
    shield();
    let start = Instant::now();
    assert!(ends_within(start_in(calm.path()), Duration::MAX), "{}", said(calm.path()));
    let whole = start.elapsed();
    let expected: BTreeMap<String, Vec<u8>> = results(calm.path());

    let mut random = Pcg64::seed_from_u64(7);
    let mut killed = 0;
    while killed < kills() {
        let home = home();
        let mut reached = 0;
        loop {
            let patience =
                if killed < kills() { whole.mul_f64(random.random_range(0.0..0.7)) } else { Duration::MAX };
            let has_ended = ends_within(start_in(home.path()), patience);
            let before = steps_before(home.path());
            // It may have been killed before it could say from where it goes on.
            assert!(
                before == 0 || before >= reached,
                "from {reached} back to {before} steps: {}",
                said(home.path())
            );
            reached = reached.max(before);
            if has_ended {
                break;
            }
            killed += 1;
        }
        let files = results(home.path());
        assert_eq!(expected.keys().collect::<Vec<_>>(), files.keys().collect::<Vec<_>>());
        for (file, bytes) in &expected {
            assert!(
                *bytes == files[file],
                "{file} differs after {killed} kills; the last run said: {}",
                said(home.path())
            );
        }
    }
}

#[test]
fn a_killed_run_in_the_gridworld_continues_exactly() {
    let experiment =
        gridworld(12_000, "checkpoint: (every: 61),").replace("batch: 16", "batch: 16, capacity: 3_000");
    survives(&experiment, "small");
}

#[test]
fn a_killed_run_of_the_cart_with_networks_continues_exactly() {
    survives(&cart(3_000, "checkpoint: (every: 83),"), "cart");
}

#[test]
fn a_killed_run_with_a_success_critic_continues_exactly() {
    let learned = r#"rules: [(plugin: "undo-probability")], success_critic: (plugin: "tabular-success"),
        shield_exploration: true,"#;
    let experiment = with_shield(&gridworld(6_000, "checkpoint: (every: 61),"), learned)
        .replace("batch: 16", "batch: 16, capacity: 1_000");
    survives(&experiment, "small");
}
