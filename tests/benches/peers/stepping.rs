//! Environment steps per second while learning with one critic, against Stable-Baselines3.

use std::fs;
use std::path::Path;
use std::process::Command;

use serde_json::{Value, json};
use shield_tests::{plugins_folder, workspace};

/// Steps of a measurement of ours and of theirs.
const STEPS: [u32; 2] = [6_000, 1_500];
const ROUNDS: usize = 2;

/// The best of two rounds for each learner and number of threads.
pub fn measure(python: &Path) -> Vec<Value> {
    let mut rows = Vec::new();
    for threads in [1, 2] {
        let mut best = [("td3", [0.0_f64; 2]), ("ddpg", [0.0; 2])];
        for _ in 0..ROUNDS {
            let theirs = stable_baselines3(python, threads);
            for (learner, speeds) in &mut best {
                speeds[0] = speeds[0].max(ours(learner, threads));
                speeds[1] = speeds[1].max(speed_in(&theirs, learner));
            }
        }
        for (learner, [ours, theirs]) in best {
            let ratio = ours / theirs;
            println!(
                "{learner} on the half-cheetah, {threads} threads: ours {ours:.0} steps/s, Stable-Baselines3 {theirs:.0}: {ratio:.1} times"
            );
            rows.push(json!({
                "learner": learner, "threads": threads, "ours_steps_per_second": ours,
                "stable_baselines3_steps_per_second": theirs, "ratio": ratio,
            }));
        }
    }
    rows
}

/// A run of `examples/learners/half-cheetah.ron`, without evaluations.
fn ours(learner: &str, threads: usize) -> f64 {
    let folder = tempfile::tempdir().expect("a folder");
    // Its plugins lie beside it.
    let release = plugins_folder().parent().expect("deps lies in the profile's folder").to_path_buf();
    let output = Command::new(release.join("shield"))
        .arg("run")
        .arg(workspace().join("examples/learners/half-cheetah.ron"))
        .args(["--seeds", "0", "--variants", learner, "--steps", &STEPS[0].to_string()])
        .args(["--set", "evaluation=None", "--set", &format!("threads={threads}"), "--out"])
        .arg(folder.path())
        .output()
        .expect("`shield` was built");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let summary = folder.path().join("half-cheetah").join(learner).join("seed-0/summary.json");
    let summary = fs::read_to_string(summary).expect("a summary");
    let summary: Value = serde_json::from_str(&summary).expect("JSON");
    summary["steps_per_second"].as_f64().expect("a number")
}

fn stable_baselines3(python: &Path, threads: usize) -> String {
    let output = Command::new(python)
        .args(["-W", "ignore"])
        .arg(workspace().join("examples/learners/peer_curves.py"))
        .args(["--speed", &STEPS[1].to_string(), "--threads", &threads.to_string()])
        .output()
        .expect("Python starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// The figure of a line such as `td3 98.3`.
fn speed_in(text: &str, learner: &str) -> f64 {
    let line = text.lines().find_map(|line| line.strip_prefix(learner)).expect("a line for each learner");
    line.trim().parse().expect("a number")
}
