//! The same seed gives the same run, byte for byte, whatever the number of threads and of runs at the same time.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::{collections::BTreeMap, fs};

use shield_tests::{cart, gridworld, run_files, shield};

fn run(experiment: &str, arguments: &[&str], seed: u64) -> BTreeMap<String, Vec<u8>> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.ron");
    fs::write(&path, experiment).unwrap();
    let output = shield().current_dir(folder.path()).args(["run", "x.ron"]).args(arguments).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let name = if experiment.contains("\"cart\"") { "cart" } else { "small" };
    run_files(&folder.path().join(format!("runs/{name}/default/seed-{seed}")))
}

#[test]
fn a_run_with_networks_does_not_depend_on_threads() {
    let one = run(&cart(1_500, "threads: 1"), &[], 0);
    let two = run(&cart(1_500, "threads: 2"), &[], 0);
    assert!(one.len() >= 5 && one["metrics.csv"].len() > 500);
    for (name, bytes) in &one {
        if name == "config.ron" {
            continue;
        }
        assert!(bytes == &two[name], "{name} differs");
    }
    assert!(one.contains_key("decisions/part-000000.parquet"));
    let other_seed = run(&cart(1_500, "").replace("seeds: [0]", "seeds: [1]"), &[], 1);
    assert_ne!(one["metrics.csv"], other_seed["metrics.csv"], "the seed changes nothing");
}

#[test]
fn an_earlier_run_on_the_same_thread_changes_nothing() {
    let variants = r#"variants: {"other": [("mode", ResetOnly())], "default": []},"#;
    let alone = run(&cart(500, variants), &["--variants", "default"], 0);
    let after = run(&cart(500, variants), &["--jobs", "1"], 0);
    assert!(alone == after, "the run differs after another");
}

#[test]
fn runs_at_the_same_time_do_not_disturb_each_other() {
    let alone = run(&gridworld(3_000, ""), &["--seeds", "1", "--jobs", "1"], 1);
    let together = run(&gridworld(3_000, ""), &["--seeds", "0,1,2,3", "--jobs", "4"], 1);
    assert_eq!(alone, together);
}

#[test]
fn an_isolated_environment_gives_the_same_run_as_a_loaded_one() {
    let loaded = run(&gridworld(1_000, ""), &["--seeds", "0"], 0);
    let isolated = run(&gridworld(1_000, ""), &["--seeds", "0", "--set", "environment.isolate=true"], 0);
    assert!(loaded.len() == isolated.len() && loaded["config.ron"] != isolated["config.ron"]);
    for (name, bytes) in loaded.iter().filter(|(name, _)| *name != "config.ron") {
        assert_eq!(String::from_utf8_lossy(bytes), String::from_utf8_lossy(&isolated[name]), "{name}");
    }
}
