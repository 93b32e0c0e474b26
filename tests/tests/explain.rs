//! What is recorded of decisions, and the commands that explain and replay them.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::{
    fs,
    path::{Path, PathBuf},
    process::Output,
};

use serde_json::Value;
use shield_runtime::run::{DecisionRow, read_decisions};
use shield_tests::{cart, gridworld, shield, text};
use tempfile::TempDir;

/// Runs `experiment`, which must succeed; returns the folder of seed 0.
fn run(experiment: &str, sets: &[&str]) -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("x.ron"), experiment).unwrap();
    let mut command = shield();
    command.current_dir(folder.path()).args(["run", "x.ron", "--seeds", "0", "--out", "runs"]);
    for set in sets {
        command.args(["--set", set]);
    }
    let output = command.output().unwrap();
    assert!(output.status.success(), "{}", text(&output.stderr));
    let name = if experiment.contains("\"cart\"") { "cart" } else { "small" };
    let run = folder.path().join(format!("runs/{name}/default/seed-0"));
    (folder, run)
}

fn command(name: &str, run: &Path, arguments: &[&str]) -> Output {
    shield().arg(name).arg(run).args(arguments).output().unwrap()
}

fn succeed(name: &str, run: &Path, arguments: &[&str]) -> String {
    let output = command(name, run, arguments);
    assert!(output.status.success(), "{arguments:?}: {}", text(&output.stderr));
    text(&output.stdout)
}

fn decisions(run: &Path) -> Vec<DecisionRow> {
    let mut rows = Vec::new();
    read_decisions(run, |row| {
        rows.push(row);
        Ok(true)
    })
    .unwrap();
    rows
}

fn summary(run: &Path) -> Value {
    serde_json::from_slice(&fs::read(run.join("summary.json")).unwrap()).unwrap()
}

/// The figures of the rows of a table.
fn rows(table: &str) -> Vec<Vec<String>> {
    let lines = table.lines().filter(|line| line.starts_with('│'));
    lines
        .skip(1)
        .map(|line| line.trim_matches('│').split('┆').map(|cell| cell.trim().to_owned()).collect())
        .collect()
}

#[test]
fn every_decision_is_recorded_with_every_members_value() {
    let (_folder, run) =
        run(&gridworld(2_500, ""), &["shield.shield_exploration=true", "shield.warm_up_steps=100"]);
    let (rows, summary) = (decisions(&run), summary(&run));
    let count = |verdict: &str| rows.iter().filter(|row| row.verdict == verdict).count();
    let unjudged = rows.iter().filter(|row| row.verdict == "warm_up" && row.phase == "forward").count();
    assert_eq!(count("abort"), summary["early_aborts"].as_u64().unwrap() as usize);
    assert_eq!(unjudged, summary["warm_up_decisions"].as_u64().unwrap() as usize);
    assert_eq!(count("replace"), summary["exploration_replaced"].as_u64().unwrap() as usize);
    let forward = rows.iter().filter(|row| row.phase == "forward" && row.verdict != "abort").count();
    assert_eq!(forward, summary["forward_steps"].as_u64().unwrap() as usize);
    assert!(count("abort") > 0 && count("replace") > 0);
    for row in &rows {
        assert_eq!(
            (row.observation.len(), row.proposed.len(), row.values.len(), row.scores.len()),
            (25, 1, 5, 1)
        );
        let is_judged = row.verdict != "warm_up";
        assert!(row.values.iter().chain(&row.scores).all(|value| value.is_finite() == is_judged), "{row:?}");
        assert_eq!(row.executed[0].is_nan(), row.verdict == "abort");
        assert!(row.state.is_empty() && row.cause.is_empty() == (row.verdict == "allow" || !is_judged));
        // Optimistic: the largest member is compared.
        let largest = row.values.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        assert!(!is_judged || row.scores[0] == largest, "{row:?}");
    }
}

#[test]
fn decisions_are_recorded_as_often_as_configured() {
    let all = decisions(&run(&gridworld(1_000, ""), &[]).1);
    let (_folder, folder) = run(&gridworld(1_000, ""), &["record=(decisions: 10, states_every: 25)"]);
    let thin = decisions(&folder);
    let is_due = |row: &DecisionRow| {
        row.verdict == "abort" || row.step.is_multiple_of(10) || row.step.is_multiple_of(25)
    };
    let expected: Vec<u64> = all.iter().filter(|row| is_due(row)).map(|row| row.step).collect();
    assert_eq!(thin.iter().map(|row| row.step).collect::<Vec<_>>(), expected);
    assert!(thin.iter().all(|row| row.state.is_empty() != row.step.is_multiple_of(25)));
    let replayed = succeed("what-if", &folder, &[]);
    assert!(replayed.contains("only one in 10 was recorded"), "{replayed}");
    let (_folder, none) = run(&gridworld(1_000, ""), &["record.decisions=0"]);
    assert!(!none.join("decisions").exists());
    let output = command("what-if", &none, &[]);
    assert_eq!(output.status.code(), Some(2));
    assert!(text(&output.stderr).contains("`record: (decisions: 1)`"), "{}", text(&output.stderr));
}

#[test]
fn a_replay_of_the_same_settings_rejects_the_same_actions() {
    // A rule with a state, and one that judges the change of the action.
    let experiment = cart(2_000, "").replace(
        "rules: [",
        r#"rules: [(plugin: "deadline-latch", config: (steps: 4)), (plugin: "linear-constraints", config: (max_change: Some([1.2]))), "#,
    );
    for experiment in [gridworld(2_500, ""), experiment] {
        let (_folder, run) = run(&experiment, &[]);
        let aborts = summary(&run)["early_aborts"].to_string();
        assert_ne!(aborts, "0");
        let table = succeed("what-if", &run, &[]);
        let rows = rows(&table);
        assert_eq!(
            (rows.len(), &rows[0][3], &rows[0][6], &rows[0][7]),
            (1, &aborts, &"0".into(), &"0".into())
        );
    }
}

#[test]
fn another_threshold_or_combination_changes_what_is_rejected() {
    let (_folder, run) = run(&gridworld(2_500, ""), &[]);
    let table = succeed("what-if", &run, &["--q-min", "0,0.4,2", "--combine", "min,max"]);
    let rows = rows(&table);
    let settings: Vec<String> = rows.iter().map(|row| row[..2].join(" ").trim().to_owned()).collect();
    assert_eq!(
        settings,
        ["as recorded", "0 min", "0 max", "0.4 min", "0.4 max", "2 min", "2 max"].map(str::to_owned)
    );
    let rejected: Vec<u64> = rows.iter().map(|row| row[3].parse().unwrap()).collect();
    assert_eq!(rejected[0], rejected[4], "the run's own settings");
    assert_eq!((rejected[1], rejected[2]), (0, 0));
    assert!(rejected[3] > rejected[4] && rejected[5] == rows[0][2].parse::<u64>().unwrap());
    let output = command("what-if", &run, &["--combine", "median"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(text(&output.stderr).contains("--combine median"), "{}", text(&output.stderr));
    let set = "shield.rules[0].config.q_min=2.0";
    let set_rows = self::rows(&succeed("what-if", &run, &["--set", set]));
    assert_eq!(set_rows[1][..3], [set, "-", "-"]);
    assert_eq!((&set_rows[0][4], &set_rows[1][4]), (&rows[0][3], &rows[5][3]));
    for ignored in [
        &["--counterfactual", "--q-min", "5"][..],
        &["--calibration", "--set", set],
        &["--counterfactual", "--calibration"],
        &["--set", "shield.warm_up_steps=0"],
    ] {
        assert_eq!(command("what-if", &run, ignored).status.code(), Some(2), "{ignored:?}");
    }
    let nan = command("what-if", &run, &["--q-min", "5,nan"]);
    assert!(text(&nan.stderr).contains("error: --q-min NaN: "), "{}", text(&nan.stderr));
}

#[test]
fn a_rejection_is_explained() {
    let (_folder, run) = run(&gridworld(2_500, ""), &[]);
    let aborted = decisions(&run).into_iter().find(|row| row.verdict == "abort").unwrap();
    let explained = succeed("explain", &run, &["--step", &aborted.step.to_string()]);
    for part in ["ensemble-threshold", "below q_min 0.4", "nothing was tried", "abort (rejected)"] {
        assert!(explained.contains(part), "{part:?} is missing in: {explained}");
    }
    let members = explained.lines().find_map(|line| line.strip_prefix("  members ")).unwrap();
    let members: Vec<f32> = members.split_whitespace().map(|value| value.parse().unwrap()).collect();
    assert!(members.len() == 5 && members.iter().zip(&aborted.values).all(|(a, b)| (a - b).abs() < 1e-6));
    let counted = succeed("explain", &run, &[]);
    assert!(
        counted.contains(&format!("{} actions were rejected", summary(&run)["early_aborts"])),
        "{counted}"
    );
    let output = command("explain", &run, &["--step", "9999999"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(text(&output.stderr).contains("the nearest rejection is at step"), "{}", text(&output.stderr));
    let output = command("explain", Path::new("/nonexistent"), &[]);
    assert_eq!(output.status.code(), Some(2));
}

#[test]
fn a_projection_is_explained() {
    let ensemble = r#"(plugin: "ensemble-threshold", config: (q_min: 1.0, combine: Realist))"#;
    let rule = r#"(plugin: "linear-constraints", config: (constraints: [(a: [1.0], b: 0.1)]))"#;
    let (_folder, run) = run(&cart(600, "").replace(ensemble, rule), &["shield.projection=Qp()"]);
    let explained = succeed("explain", &run, &[]);
    for part in ["linear-constraints", "a program was solved, linearised once, distance", "executed   0.0"] {
        assert!(explained.contains(part), "{part:?} is missing in: {explained}");
    }
}

#[test]
fn false_and_missed_aborts_are_counted() {
    // Nothing is rejected: whatever was lost was allowed.
    let sampled = "record.states_every=5";
    let (_folder, lax) = run(&gridworld(2_500, ""), &[sampled, "shield.rules[0].config.q_min=-1.0"]);
    let table = succeed("what-if", &lax, &["--counterfactual"]);
    let counted = |table: &str| -> Vec<Vec<u64>> {
        rows(table).iter().map(|row| row[1..].iter().map(|cell| cell.parse().unwrap()).collect()).collect()
    };
    let [rejected, allowed] = &counted(&table)[..] else { panic!("{table}") };
    let sampled_rows = decisions(&lax).iter().filter(|row| !row.state.is_empty()).count() as u64;
    assert_eq!((rejected[0], allowed[0]), (0, sampled_rows));
    assert!(allowed[1] > 0 && allowed[2] > 0, "the pits of the gridworld hold what falls in: {table}");
    assert!(table.contains("single-step counterfactuals"));
    // Everything is rejected from some step on: of that, most could be undone.
    let sets = [sampled, "shield.rules[0].config.q_min=2.0", "shield.warm_up_steps=1500"];
    let (_folder, strict) = run(&gridworld(2_500, ""), &sets);
    let table = succeed("what-if", &strict, &["--counterfactual"]);
    let [rejected, allowed] = &counted(&table)[..] else { panic!("{table}") };
    assert!(rejected[0] > 0 && rejected[1] > 0 && allowed[0] == 0, "{table}");
    assert!(table.contains(&format!("{} false aborts", rejected[1])), "{table}");

    let (_folder, bare) = run(&gridworld(500, ""), &[]);
    let output = command("what-if", &bare, &["--counterfactual"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(text(&output.stderr).contains("states_every: 100"), "{}", text(&output.stderr));
    let (_folder, forgotten) = run(&gridworld(500, ""), &[sampled, "checkpoint=None"]);
    let output = command("what-if", &forgotten, &["--counterfactual"]);
    assert!(text(&output.stderr).contains("no checkpoint"), "{}", text(&output.stderr));
}

#[test]
fn calibration_compares_the_reset_values_of_every_attempt_with_its_success() {
    let (_folder, run) = run(&gridworld(2_500, ""), &[]);
    let episodes = summary(&run)["reset_episodes"].as_u64().unwrap();
    let rows = rows(&succeed("what-if", &run, &["--calibration"]));
    let counted: u64 = rows.iter().map(|row| row[2].parse::<u64>().unwrap()).sum();
    assert_eq!((rows.len(), counted), (10, episodes));
    let lows: Vec<f64> = rows.iter().map(|row| row[0].parse().unwrap()).collect();
    assert!(lows.is_sorted() && lows[0] < lows[9]);
}
