//! `shield doctor`: exit codes, verdicts, and that a run's findings reach its summary and its notes.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::{fs, path::Path, process::Output};

use serde_json::Value;
use shield_tests::{cart, gridworld, shield};

fn in_folder(folder: &Path, arguments: &[&str]) -> (Option<i32>, String, String) {
    let Output { status, stdout, stderr } = shield().current_dir(folder).args(arguments).output().unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (status.code(), text(&stdout), text(&stderr))
}

#[test]
fn an_experiment_is_examined_without_writing_anything() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("x.ron"), cart(1_000, "")).unwrap();
    let far =
        r#"reset_task=Some((plugin: "near-start", config: (target: Some([9.0, 9.0, 9.0, 9.0, 9.0, 9.0]))))"#;
    for (arguments, code, verdict) in [
        (vec![], 0, "verdict: it works"),
        (vec!["--set", far], 1, "verdict: change this setting"),
        (vec!["--set", "mode=StatusQuo"], 2, ""),
    ] {
        let arguments = [["doctor", "x.ron", "--steps", "200"].as_slice(), &arguments].concat();
        let (found, printed, message) = in_folder(folder.path(), &arguments);
        assert_eq!(found, Some(code), "{arguments:?}: {printed}{message}");
        assert!(printed.contains(verdict), "{printed}");
    }
    let left: Vec<_> = fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(left, ["x.ron"]);
}

#[test]
fn a_run_says_what_kept_its_shield_from_helping() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("x.ron"), gridworld(3_000, "")).unwrap();
    // No state is allowed to be left, once the warm-up is over.
    let never = "shield.rules[0].config.q_min=1000.0";
    let run = ["run", "x.ron", "--seeds", "0", "--set", never, "--set", "shield.warm_up_steps=10"];
    let (code, printed, message) = in_folder(folder.path(), &run);
    assert_eq!(code, Some(0), "{message}");
    assert!(printed.contains("note: ") && printed.contains("[nothing-allowed, after"), "{printed}");
    let run = fs::read_dir(folder.path().join("runs/small"))
        .unwrap()
        .next()
        .unwrap()
        .unwrap()
        .path()
        .join("seed-0");
    let summary: Value = serde_json::from_slice(&fs::read(run.join("summary.json")).unwrap()).unwrap();
    let findings = summary["findings"].as_array().unwrap();
    let found = findings.iter().find(|found| found["name"] == "nothing-allowed").unwrap();
    assert_eq!(found["is_over"], false);
    let (code, printed, _) = in_folder(folder.path(), &["doctor", run.to_str().unwrap()]);
    assert_eq!(code, Some(1), "{printed}");
    assert!(printed.contains("CHANGE  nothing-allowed") && printed.contains("verdict: change this setting"));
    assert_eq!(in_folder(folder.path(), &["doctor", "runs"]).0, Some(2));
}
