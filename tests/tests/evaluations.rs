//! Evaluations of an agent with its shield and without, from the run to its report.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::{fs, path::Path};

use serde_json::Value;
use shield_tests::{cart, gridworld, run_files, shield, workspace};
use tempfile::TempDir;

/// A folder in which the experiment ran, with these arguments.
fn ran(experiment: &str, arguments: &[&str]) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("x.ron"), experiment).unwrap();
    succeed(folder.path(), &[&["run", "x.ron", "--seeds", "0"], arguments].concat());
    folder
}

/// What the command prints.
fn succeed(folder: &Path, arguments: &[&str]) -> String {
    let output = shield().current_dir(folder).args(arguments).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// Only here does the greedy agent do what the shield rejects.
fn rejecting() -> String {
    cart(600, "").replace("q_min: 1.0", "q_min: 1e6").replace("episodes: 2", "episodes: 5")
}

fn column(run: &Path, name: &str) -> Vec<String> {
    let mut table = csv::Reader::from_path(run.join("evaluations.csv")).unwrap();
    let at = table.headers().unwrap().iter().position(|heading| heading == name).unwrap();
    table.records().map(|row| row.unwrap()[at].to_owned()).collect()
}

fn summary(run: &Path) -> Value {
    serde_json::from_slice(&fs::read(run.join("summary.json")).unwrap()).unwrap()
}

const COLUMNS: [&str; 4] = ["mean_return", "success_rate", "irreversible_entries", "steps"];
const RUN: &str = "runs/cart/default/seed-0";

#[test]
fn a_second_evaluation_without_the_shield_leaves_the_training_alone() {
    let latched = gridworld(2_000, "")
        .replace("rules: [", r#"rules: [(plugin: "deadline-latch"), "#)
        .replace("episodes: 1", "episodes: 5");
    // Its threshold and its critic learn from what happens; careful enough that it rejects greedy actions, too.
    let adapting = cart(1_500, "").replace("episodes: 2", "episodes: 5").replace(
        r#"(plugin: "ensemble-threshold", config: (q_min: 1.0, combine: Realist))],"#,
        r#"(plugin: "undo-probability", config: (accepted_risk: 0.05))], success_critic: (plugin: "success-critic"),"#,
    );
    assert!(adapting.contains("undo-probability"));
    for (experiment, run) in [(rejecting(), RUN), (latched, "runs/small/default/seed-0"), (adapting, RUN)] {
        let [both, bare] = ["true", "false"].map(|shielded| {
            let folder = ran(&experiment, &["--set", &format!("evaluation.shielded={shielded}")]);
            let run = folder.path().join(run);
            (run_files(&run), COLUMNS.map(|name| column(&run, name)), folder)
        });
        let differing = both.0.iter().filter(|(name, bytes)| bare.0[*name] != **bytes).map(|(name, _)| name);
        let differing: Vec<&str> =
            differing.map(String::as_str).filter(|name| !name.contains("tfevents")).collect();
        assert_eq!(differing, ["config.ron", "evaluations.csv", "summary.json"]);
        let without = COLUMNS.map(|name| column(&both.2.path().join(run), &format!("{name}_without_shield")));
        assert_eq!(without, bare.1, "the second evaluation is the only one of a run that makes no other");
        assert_ne!(both.1, bare.1, "the shield does nothing");
        let missing = column(&bare.2.path().join(run), "mean_return_without_shield");
        assert!(missing.iter().all(String::is_empty), "{missing:?}");
    }
}

#[test]
fn the_figures_with_the_shield_come_first_in_every_file() {
    let folder = ran(&rejecting(), &[]);
    let run = folder.path().join(RUN);
    let summary = summary(&run);
    let last = |name: &str| column(&run, name).last().unwrap().parse::<f64>().unwrap();
    for (key, name) in [("final_return", "mean_return"), ("success_rate", "success_rate")] {
        assert_eq!(summary[key], last(name), "{key}");
        let without = format!("{key}_without_shield");
        assert_eq!(summary[&without], last(&format!("{name}_without_shield")), "{without}");
    }
    assert_ne!(summary["final_return"], summary["final_return_without_shield"]);
    assert!(
        summary["best_return_without_shield"].as_f64() >= summary["final_return_without_shield"].as_f64()
    );
    let files = run_files(&run);
    let (_, events) = files.iter().find(|(name, _)| name.contains("tfevents")).unwrap();
    let events = String::from_utf8_lossy(events);
    let [first, second] = ["evaluation/mean_return", "evaluation/mean_return_without_shield"]
        .map(|tag| events.find(tag).unwrap());
    assert!(first < second);

    let evaluated: Value =
        serde_json::from_str(&succeed(folder.path(), &["eval", "runs", "--episodes", "5", "--json"]))
            .unwrap();
    for name in ["mean_return", "irreversible_entries", "mean_return_without_shield", "steps_without_shield"]
    {
        assert_eq!(evaluated[0][name].as_f64().unwrap(), last(name), "{name}");
    }
    let table = succeed(folder.path(), &["eval", "runs", "--episodes", "5"]);
    let place = |name: &str| table.find(&format!("{:.2}", last(name))).unwrap();
    assert!(place("mean_return") < place("mean_return_without_shield"), "{table}");
}

#[test]
fn a_run_without_a_shield_is_evaluated_once() {
    for mode in ["StatusQuo", "ResetOnly()"] {
        let folder = ran(&cart(600, ""), &["--set", &format!("mode={mode}")]);
        let run = folder.path().join(RUN);
        let (summary, files) = (summary(&run), run_files(&run));
        assert!(summary["final_return"].is_number() && summary["final_return_without_shield"].is_null());
        assert!(column(&run, "steps_without_shield").iter().all(String::is_empty));
        let (_, events) = files.iter().find(|(name, _)| name.contains("tfevents")).unwrap();
        assert!(!String::from_utf8_lossy(events).contains("without_shield"), "{mode}");
    }
}

#[test]
fn the_report_shows_both_and_keeps_them_in_its_record() {
    let variants = r#"variants: {"shielded": [], "status-quo": [("mode", StatusQuo)]},"#;
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("x.ron"), gridworld(2_000, variants)).unwrap();
    let table = succeed(folder.path(), &["run", "x.ron"]);
    assert!(table.contains("the shield") && table.contains("never"), "{table}");
    succeed(folder.path(), &["report", "runs/small", "--record", "kept.json"]);
    let page = fs::read_to_string(folder.path().join("runs/small/report.html")).unwrap();
    for part in [
        "<th>final return</th><th>without the shield</th><th>best return</th>",
        "id=\"return-without-shield\"",
        "id=\"final-return-without-shield\"",
        "with the smallest and the largest below",
    ] {
        assert!(page.contains(part), "{part} is missing");
    }
    assert!(!page.contains("without its shield only"));
    let record: Value = serde_json::from_slice(&fs::read(folder.path().join("kept.json")).unwrap()).unwrap();
    let evaluations = |variant: usize| &record["variants"][variant]["runs"][0]["evaluations"];
    assert_eq!(evaluations(0)["mean_return_without_shield"].as_array().unwrap().len(), 4);
    assert!(evaluations(1).get("mean_return_without_shield").is_none());
}

/// What version 1.0 wrote of a run that was evaluated without its shield.
fn as_in_1_0(run: &Path) {
    let path = run.join("summary.json");
    let mut summary = summary(run);
    summary.as_object_mut().unwrap().retain(|key, _| !key.ends_with("_without_shield") && key != "solved");
    fs::write(path, summary.to_string()).unwrap();
    let path = run.join("evaluations.csv");
    let table = fs::read_to_string(&path).unwrap();
    let rows = table.lines().map(|row| row.split(',').take(7).collect::<Vec<_>>().join(",") + "\n");
    fs::write(&path, rows.collect::<String>()).unwrap();
}

#[test]
fn runs_and_records_of_version_1_0_are_still_reported() {
    let folder = ran(&gridworld(1_000, ""), &["--set", "evaluation.shielded=false"]);
    as_in_1_0(&folder.path().join("runs/small/default/seed-0"));
    succeed(folder.path(), &["report", "runs/small"]);
    let page = fs::read_to_string(folder.path().join("runs/small/report.html")).unwrap();
    assert!(
        page.contains("<td>never</td>") && page.contains("default was evaluated without its shield only")
    );
    assert!(!page.contains("<th>without the shield</th>") && !page.contains("id=\"return-without-shield\""));

    let record = workspace().join("examples/paper/records/cart-small.json");
    let out = folder.path().join("cart.html");
    succeed(folder.path(), &["report", record.to_str().unwrap(), "--out", out.to_str().unwrap()]);
    let page = fs::read_to_string(out).unwrap();
    assert!(page.contains("shielded was evaluated without its shield only"));
    assert!(!page.contains("status-quo was evaluated without"));
}
