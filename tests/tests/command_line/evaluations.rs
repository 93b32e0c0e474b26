//! `shield eval` over finished runs, and the runs that it leaves out.

use std::{fs, process::Output};

use serde_json::Value;
use shield_tests::{gridworld, run_files, shield, text};

use super::{run, summary};

#[test]
fn an_evaluation_repeats_the_last_one_of_the_run_and_changes_nothing() {
    let (output, folder) = run(&gridworld(3_000, ""), &[]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let eval = |arguments: &[&str]| {
        shield().current_dir(folder.path()).args(["eval", "runs/small"]).args(arguments).output().unwrap()
    };
    let runs = [0, 1].map(|seed| folder.path().join(format!("runs/small/default/seed-{seed}")));
    let before =
        runs.clone().map(|run| (run_files(&run), fs::read(run.join("checkpoint/latest.bin")).unwrap()));
    let output = eval(&["--episodes", "1", "--json"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let evaluated: Value = serde_json::from_slice(&output.stdout).unwrap();
    for (index, run) in runs.iter().enumerate() {
        let summary = summary(run);
        assert_eq!(evaluated[index]["mean_return"], summary["final_return"]);
        assert_eq!(evaluated[index]["success_rate"], summary["success_rate"]);
        assert_eq!(
            (&evaluated[index]["step"], &evaluated[index]["seed"]),
            (&summary["steps"], &summary["seed"])
        );
    }
    let reset: Value =
        serde_json::from_slice(&eval(&["--episodes", "1", "--agent", "reset", "--json"]).stdout).unwrap();
    assert_ne!(evaluated[0]["mean_return"], reset[0]["mean_return"]);
    let output = eval(&["--episodes", "3", "--shielded"]);
    assert!(output.status.success() && text(&output.stdout).contains("3000"), "{}", text(&output.stderr));
    let after = runs.map(|run| (run_files(&run), fs::read(run.join("checkpoint/latest.bin")).unwrap()));
    assert!(before == after, "an evaluation changed a run");

    let refused = |output: Output, expected: &str| {
        let message = text(&output.stderr);
        assert!(output.status.code() == Some(2) && message.contains(expected), "{message}");
    };
    refused(eval(&["--start", "roof"]), "roof");
    fs::remove_dir_all(folder.path().join("runs/small/default/seed-0/checkpoint")).unwrap();
    let output = eval(&[]);
    let warning = text(&output.stderr);
    assert!(output.status.success(), "{warning}");
    assert!(warning.contains("left out: runs/small/default/seed-0: ") && warning.contains("no checkpoint"));
    let one = |command: &str, run: &str, more: &[&str]| {
        shield().current_dir(folder.path()).args([command, run]).args(more).output().unwrap()
    };
    refused(one("eval", "runs/small/default/seed-0", &[]), "no checkpoint");
    refused(one("render", "runs/small/default/seed-0", &["--out", "x.gif"]), "no checkpoint");
    refused(one("render", "runs/small", &["--out", "x.gif"]), "such as runs/small/default/seed-0");
    refused(one("export", "runs", &[]), "such as runs/small/default/seed-0");
    let nothing = shield().args(["eval"]).arg(folder.path().join("runs/small/default/seed-0/none")).output();
    refused(nothing.unwrap(), "none");
}

#[test]
fn a_run_that_cannot_be_evaluated_is_left_out() {
    let variants = r#"variants: {"a": [], "b": [("mode", StatusQuo)]},"#;
    let (output, folder) = run(&gridworld(300, variants), &["--seeds", "0"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let eval =
        |root: &str| shield().current_dir(folder.path()).args(["eval", root, "--shielded"]).output().unwrap();
    let output = eval("runs/small");
    let (table, warning) = (text(&output.stdout), text(&output.stderr));
    assert!(output.status.success() && table.contains("│ a ") && !table.contains("│ b "), "{table}");
    assert!(
        warning.contains("left out: runs/small/b/seed-0: ") && warning.contains("no shield"),
        "{warning}"
    );
    let output = eval("runs/small/b");
    assert_eq!(output.status.code(), Some(2));
    assert!(text(&output.stderr).contains("runs/small/b/seed-0"), "{}", text(&output.stderr));
    let out = ["render", "x.ron", "--out", "x.gif", "--policy", "reset", "--variant", "b"];
    let output = shield().current_dir(folder.path()).args(out).output().unwrap();
    assert_eq!(output.status.code(), Some(2), "{}", text(&output.stderr));
}
