//! Attempts to get back to the start: what a run records, sums up, explains, reports and replays of them.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::{
    fs,
    path::{Path, PathBuf},
};

use serde_json::Value;
use shield_runtime::{
    events::AttemptOutcome,
    plugin::{Kind, Registry, SearchPath, Selection},
    reliability::{Forecast, Reliability},
    run::{DecisionRow, RecordedAttempt, read_attempts, read_decisions},
};
use shield_tests::{gridworld, plugins_folder, shield};
use tempfile::TempDir;

/// The small gridworld with a success critic, and a rule that accepts a risk.
fn judged(steps: u64, rule: &str, extra: &str) -> String {
    gridworld(steps, extra)
        .replace("(plugin: \"ensemble-threshold\", config: (q_min: 0.4, combine: Optimistic))", rule)
        .replace("warm_up_steps", "success_critic: Some((plugin: \"tabular-success\")), warm_up_steps")
}

const RULE: &str = r#"(plugin: "undo-probability", config: (accepted_risk: 0.1))"#;

/// Runs seed 0 of `experiment`; returns what was printed, too.
fn run(experiment: &str, sets: &[&str]) -> (TempDir, PathBuf, String) {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("x.ron"), experiment).unwrap();
    let mut command = shield();
    command.current_dir(folder.path()).args(["run", "x.ron", "--seeds", "0", "--out", "runs"]);
    for set in sets {
        command.args(["--set", set]);
    }
    let output = command.output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    let run = folder.path().join("runs/small/default/seed-0");
    (folder, run, said)
}

fn call(name: &str, run: &Path, arguments: &[&str]) -> (Option<i32>, String) {
    let output = shield().arg(name).arg(run).args(arguments).output().unwrap();
    let said = if output.status.success() { output.stdout } else { output.stderr };
    (output.status.code(), String::from_utf8_lossy(&said).into_owned())
}

fn succeed(name: &str, run: &Path, arguments: &[&str]) -> String {
    let (code, said) = call(name, run, arguments);
    assert_eq!(code, Some(0), "{arguments:?}: {said}");
    said
}

fn summary(run: &Path) -> Value {
    serde_json::from_slice(&fs::read(run.join("summary.json")).unwrap()).unwrap()
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

/// The cells of the rows of a table.
fn rows(table: &str) -> Vec<Vec<String>> {
    let lines = table.lines().filter(|line| line.starts_with('│')).skip(1);
    lines.map(|line| line.trim_matches('│').split('┆').map(|cell| cell.trim().to_owned()).collect()).collect()
}

#[test]
fn the_summary_is_that_of_the_recorded_attempts() {
    let (_folder, run, said) = run(&judged(3_000, RULE, ""), &[]);
    let (attempts, summary) = (read_attempts(&run).unwrap(), summary(&run));
    let count = |outcome| attempts.iter().filter(|attempt| attempt.outcome == outcome).count() as u64;
    let (succeeded, failed) = (count(AttemptOutcome::Succeeded), count(AttemptOutcome::Failed));
    assert!(succeeded > 0 && failed > 0);
    assert_eq!(summary["reset_successes"], succeeded);
    assert_eq!(summary["failed_attempts"], failed);
    // Each failure costs a hard reset here.
    assert_eq!(summary["hard_resets"], failed);
    assert_eq!(summary["accepted_risk"], 0.1);
    let figure = |name: &str| summary[name].as_f64().unwrap();
    assert_eq!(figure("realised_risk"), failed as f64 / attempts.len() as f64);
    let reliability = |attempts: &[RecordedAttempt]| -> Reliability {
        let forecasts = attempts.iter().map(|attempt| {
            let estimate = f64::from(attempt.undo_probability.unwrap());
            Forecast::new(estimate, attempt.outcome == AttemptOutcome::Succeeded).unwrap()
        });
        forecasts.collect()
    };
    let (all, later) = (reliability(&attempts), reliability(&attempts[attempts.len() / 2..]));
    assert_eq!(Some(figure("brier_score")), all.brier_score());
    assert_eq!(Some(figure("calibration_error")), all.calibration_error());
    assert_eq!(Some(figure("calibration_error_last_half")), later.calibration_error());
    let table = said.split_once("accepted,").unwrap().1;
    assert!(table.contains("10.0") && table.contains("realised risk"), "{said}");
    let events = fs::read(run.join("tensorboard/events.out.tfevents.0.shield")).unwrap();
    for tag in ["counts/reset_successes", "risk/realised", "risk/accepted", "reset/undo_probability"] {
        assert!(events.windows(tag.len()).any(|bytes| bytes == tag.as_bytes()), "{tag} is missing");
    }
}

#[test]
fn a_run_without_a_success_critic_knows_its_realised_risk_alone() {
    let (_folder, old, said) = run(&gridworld(1_500, ""), &[]);
    let old = summary(&old);
    assert!(old["realised_risk"].as_f64().is_some() && !said.contains("accepted,"));
    for name in ["accepted_risk", "brier_score", "calibration_error"] {
        assert!(old[name].is_null(), "{name}");
    }
    let (_folder, usual, _) = run(&gridworld(500, ""), &["mode=StatusQuo"]);
    let usual = summary(&usual);
    assert_eq!((&usual["reset_successes"], &usual["failed_attempts"]), (&0.into(), &0.into()));
    assert!(usual["realised_risk"].is_null());
}

#[test]
fn a_budget_of_hard_resets_is_compared_as_a_share() {
    let rule = r#"(plugin: "undo-probability", config: (hard_resets_per_1000: 4.0))"#;
    let (_folder, run, _) = run(&judged(1_500, rule, ""), &[]);
    let (accepted, attempts) =
        (summary(&run)["accepted_risk"].as_f64().unwrap(), read_attempts(&run).unwrap());
    assert_eq!(accepted, 4.0 * 1.5 / attempts.len() as f64);
}

#[test]
fn the_usual_risk_is_that_of_the_rule() {
    let registry = Registry::scan(&SearchPath::new([plugins_folder()]));
    let manifest = registry.entry(&Selection::new("undo-probability"), Kind::AbortRule).unwrap().manifest;
    let field = manifest.fields.iter().find(|field| field.name == "accepted_risk").unwrap();
    let (_folder, run, _) = run(&judged(300, r#"(plugin: "undo-probability")"#, ""), &[]);
    let usual = summary(&run)["accepted_risk"].as_f64().unwrap();
    assert!(field.doc.contains(&format!("None: {usual}")), "{}", field.doc);
}

#[test]
fn decisions_keep_the_probabilities_where_a_rule_needs_them() {
    let (_folder, run, _) = run(&judged(1_500, RULE, ""), &[]);
    let rows = decisions(&run);
    assert!(rows.iter().any(|row| row.was_rejected()));
    for row in rows.iter().filter(|row| row.phase == "forward") {
        for members in [&row.probabilities, &row.greedy_probabilities, &row.start_probabilities] {
            assert!(members.len() == 5 && members.iter().all(|p| (0.0..=1.0).contains(p)), "{row:?}");
        }
        assert!(row.values.is_empty());
    }
    let (_folder, old, _) = self::run(&gridworld(300, ""), &[]);
    assert!(decisions(&old).iter().all(|row| row.probabilities.is_empty() && row.values.len() == 5));
}

#[test]
fn a_replay_of_the_recorded_risk_rejects_the_same_actions() {
    let budget = r#"(plugin: "undo-probability", config: (hard_resets_per_1000: 10.0))"#;
    let still = r#"(plugin: "undo-probability", config: (adapt: false, initial_threshold: 0.9))"#;
    for (rule, sets) in [
        (RULE, &["shield.reset_attempts=2"][..]),
        (budget, &[]),
        (still, &["shield.shield_exploration=true"]),
        (r#"(plugin: "undo-probability", config: (initial_threshold: 1.0, combine: Pessimistic))"#, &[]),
    ] {
        let (_folder, run, _) = run(&judged(3_000, rule, ""), sets);
        let aborts = summary(&run)["early_aborts"].to_string();
        assert_ne!(aborts, "0", "{rule}");
        let table = succeed("what-if", &run, &[]);
        let row = &rows(&table)[0];
        assert_eq!(
            (&row[3], &row[5], &row[6], &row[7]),
            (&aborts, &"0".into(), &"0".into(), &"0".into()),
            "{table}"
        );
    }
}

#[test]
fn less_accepted_risk_rejects_more_and_the_limits_of_the_replay_are_told() {
    let (_folder, run, _) = run(&judged(3_000, RULE, ""), &[]);
    let said = succeed("what-if", &run, &["--risk", "0.02,0.1,0.5"]);
    let rows = rows(&said);
    let column = |at: usize| rows.iter().map(|row| row[at].clone()).collect::<Vec<_>>();
    assert_eq!(column(0), ["as recorded (0.1)", "0.02", "0.1", "0.5"]);
    let rejected: Vec<u64> = column(3).iter().map(|cell| cell.parse().unwrap()).collect();
    let thresholds: Vec<f64> = column(8).iter().map(|cell| cell.parse().unwrap()).collect();
    assert_eq!((rejected[0], thresholds[0]), (rejected[2], thresholds[2]));
    assert!(rejected[1] > rejected[2] && rejected[2] > rejected[3], "{said}");
    assert!(thresholds[1] > thresholds[2] && thresholds[2] > thresholds[3], "{said}");
    let attempts = read_attempts(&run).unwrap().len();
    for part in
        [&format!("the {attempts} attempts of the run"), "cannot know the outcomes of attempts that were"]
    {
        assert!(said.contains(part), "{part} is missing in: {said}");
    }
    let combined = succeed("what-if", &run, &["--risk", "0.1", "--combine", "min,max"]);
    assert_eq!(self::rows(&combined)[1][..2], ["0.1", "min"]);
    for (arguments, reason) in [
        (&["--risk", "1.5"][..], "--risk 1.5"),
        (&["--risk", "nan"], "--risk NaN"),
        (&["--risk", "0.1", "--q-min", "5"], "cannot be used with"),
        (&["--q-min", "5"], "no rule \"ensemble-threshold\""),
        (&["--risk", "0.1", "--calibration"], "cannot be used with"),
    ] {
        let (code, said) = call("what-if", &run, arguments);
        assert!(code == Some(2) && said.contains(reason), "{arguments:?}: {said}");
    }
}

#[test]
fn a_replay_is_refused_without_the_probabilities_that_it_needs() {
    let (_folder, run, _) = run(&gridworld(500, ""), &[]);
    let (code, said) = call("what-if", &run, &["--risk", "0.1"]);
    assert!(code == Some(2) && said.contains("no rule \"undo-probability\""), "{said}");
    let rules = r#"shield.rules=[(plugin: "undo-probability")]"#;
    let config = fs::read_to_string(run.join("config.ron")).unwrap();
    fs::write(
        run.join("config.ron"),
        config.replace("success_critic: None", "success_critic: Some((plugin: \"tabular-success\"))"),
    )
    .unwrap();
    let (code, said) = call("what-if", &run, &["--set", rules]);
    assert!(code == Some(2) && said.contains("undo probabilities that no rule of the run needed"), "{said}");
}

#[test]
fn a_rejection_is_explained_by_probabilities_and_threshold() {
    let (_folder, run, _) = run(&judged(3_000, RULE, ""), &[]);
    let aborts: Vec<DecisionRow> = decisions(&run).into_iter().filter(|row| row.verdict == "abort").collect();
    let aborted = &aborts[aborts.len() / 2];
    let explained = succeed("explain", &run, &["--step", &aborted.step.to_string()]);
    let mean = |members: &[f32]| members.iter().map(|p| f64::from(*p)).sum::<f64>() / members.len() as f64;
    let figure = |label: &str| -> f64 {
        let line =
            explained.lines().find(|line| line.contains(label)).unwrap_or_else(|| panic!("{explained}"));
        let figures = line.split(|letter: char| !letter.is_ascii_digit() && letter != '.');
        figures.filter_map(|word| word.parse().ok()).next().unwrap()
    };
    let near = |one: f64, other: f64| (one - other).abs() < 1e-3;
    assert!(near(figure("the proposed action could be undone"), mean(&aborted.probabilities)), "{explained}");
    assert!(near(figure("own action, with"), mean(&aborted.greedy_probabilities)), "{explained}");
    assert!(
        near(figure("where the last reset ended, with"), mean(&aborted.start_probabilities)),
        "{explained}"
    );
    // The rule is as careful as its most careful member.
    let least = |members: &[f32]| f64::from(members.iter().copied().fold(f32::INFINITY, f32::min));
    let required =
        figure("of the probability where the last reset ended") * least(&aborted.start_probabilities);
    assert!(least(&aborted.probabilities) < required + 1e-3, "{explained}");
    assert!(explained.contains("such actions could be undone;"), "{explained}");
}

#[test]
fn the_report_shows_the_risk_and_a_reliability_diagram() {
    let (folder, run, _) = run(&judged(2_000, RULE, ""), &[]);
    let report = |arguments: &[&str]| {
        let output = shield().current_dir(folder.path()).arg("report").args(arguments).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    };
    report(&["runs/small", "--png", "png", "--record", "kept.json"]);
    let page = fs::read_to_string(folder.path().join("runs/small/report.html")).unwrap();
    for part in ["Attempts to get back to the start", "<th>accepted,\n%</th>", "id=\"reliability-default\""] {
        assert!(page.contains(part), "{part} is missing");
    }
    assert!(fs::read(folder.path().join("png/reliability-default.png")).unwrap().starts_with(b"\x89PNG"));
    report(&["kept.json", "--out", "again.html"]);
    assert_eq!(page, fs::read_to_string(folder.path().join("again.html")).unwrap());
    // Records and tables of 1.0.0 have neither attempts nor forecasts.
    let kept = fs::read(folder.path().join("kept.json")).unwrap();
    let mut record: Value = serde_json::from_slice(&kept).unwrap();
    let old = record["variants"][0]["runs"][0].as_object_mut().unwrap();
    old.remove("forecasts").unwrap();
    let names = ["reset_successes", "failed_attempts", "realised_risk", "accepted_risk", "brier_score"];
    let summary = old["summary"].as_object_mut().unwrap();
    names.iter().for_each(|name| drop(summary.remove(*name).unwrap()));
    fs::write(folder.path().join("old.json"), record.to_string()).unwrap();
    report(&["old.json", "--out", "old.html"]);
    let old = fs::read_to_string(folder.path().join("old.html")).unwrap();
    assert!(!old.contains("Attempts to get back") && !old.contains("reliability-default"));
    let calibration = succeed("what-if", &run, &["--calibration"]);
    assert!(calibration.contains("expected calibration error"), "{calibration}");
}
