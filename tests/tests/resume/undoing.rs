//! Runs with a success critic: its attempts, its rule and what it has learned continue exactly.

use std::collections::BTreeMap;

use shield_tests::{cart, gridworld, with_shield};

use super::{Sabotage, Trial, same};

/// The gridworld with a memory that forgets, tables for undo probabilities, and a rule that rejects often at the start too.
fn undoing_grid() -> String {
    let learned = r#"rules: [(plugin: "undo-probability", config: (initial_threshold: 0.9, relative: false, adapt: false))],
        success_critic: (plugin: "tabular-success"), on_abort: Penalise(0.5), shield_exploration: true,"#;
    with_shield(&gridworld(1_500, "checkpoint: (every: 400),"), learned)
        .replace("batch: 16", "batch: 16, capacity: 150, bootstrap_probability: 0.7, cost_weight: 0.1")
}

/// How many rows of a table hold all of these.
fn rows_with(files: &BTreeMap<String, Vec<u8>>, table: &str, parts: &[&str]) -> usize {
    let rows = String::from_utf8_lossy(&files[table]);
    rows.lines().filter(|row| parts.iter().all(|part| row.contains(part))).count()
}

#[test]
fn a_success_critic_and_its_attempts_continue_exactly_within_an_attempt_and_between_aborts() {
    let expected = Trial::uninterrupted(&undoing_grid());
    for (table, parts) in [
        ("metrics.csv", ["reset,", "reset_set"]),
        // With nothing to undo.
        ("metrics.csv", ["forward,0,", "abort"]),
        ("learning.csv", ["success/success_loss", ""]),
    ] {
        let count = rows_with(&expected, table, &parts);
        assert!(count > 10, "only {count} of {parts:?}");
    }
    let (stop, crash, rejection) = (Sabotage::Stop, Sabotage::Crash, Sabotage::StopAtRejection);
    let within = steps_within_attempts(&expected);
    let mut sabotages: Vec<_> = within.iter().rev().step_by(3).take(5).map(|step| stop(*step)).collect();
    let attempts = sabotages.len();
    sabotages.extend([1, 2, 3, 5, 8, 40, 70].map(rejection));
    sabotages.extend([stop(1), stop(64), stop(400), stop(403), stop(1_499), crash(401), crash(1_111)]);
    let mut interrupted = [0, 0];
    for sabotage in sabotages {
        let run = Trial::new(&undoing_grid(), &[]);
        run.go(sabotage);
        let row = run.last_row();
        interrupted[0] += usize::from(row.contains(",forward,0,") && row.contains("interrupted"));
        interrupted[1] += usize::from(row.contains(",reset,") && !row.contains(",reset,0,"));
        run.go(Sabotage::None);
        same(&expected, &run, &format!("{sabotage:?}"));
    }
    assert!(attempts > 2 && interrupted[0] > 0 && interrupted[1] >= attempts, "{attempts}: {interrupted:?}");
}

/// Steps after which an attempt is under way.
fn steps_within_attempts(files: &BTreeMap<String, Vec<u8>>) -> Vec<u64> {
    let table = String::from_utf8_lossy(&files["metrics.csv"]);
    let rows = table.lines().map(|row| row.split(',').collect::<Vec<_>>());
    rows.filter(|row| row[2] == "reset" && row[3] != "1")
        .map(|row| row[0].parse::<u64>().unwrap() - 1)
        .collect()
}

#[test]
fn networks_for_undo_probabilities_and_projections_by_them_continue_exactly() {
    let learned = r#"rules: [(plugin: "undo-probability", config: (initial_threshold: 1.0))],
        success_critic: (plugin: "success-critic"), projection: Qp(margin: 0.001), shield_exploration: true,"#;
    let experiment = with_shield(&cart(900, "checkpoint: (every: 250),"), learned)
        .replace("capacity: 10_000", "capacity: 400");
    let expected = Trial::uninterrupted(&experiment);
    let projections = rows_with(&expected, "interventions.csv", &["project"]);
    assert!(projections > 10, "only {projections} projections");
    let attempts = rows_with(&expected, "metrics.csv", &["reset,"]);
    assert!(attempts > 3, "only {attempts} attempts");
    for sabotage in
        [Sabotage::Stop(120), Sabotage::Stop(700), Sabotage::Crash(640), Sabotage::StopAtRejection(9)]
    {
        let run = Trial::new(&experiment, &[]);
        run.go(sabotage);
        run.go(Sabotage::None);
        same(&expected, &run, &format!("{sabotage:?}"));
    }
}
