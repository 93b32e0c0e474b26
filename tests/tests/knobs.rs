//! No dead knobs: every field of an experiment changes what a run writes.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::{collections::BTreeMap, fs};

use shield_tests::{cart, gridworld, shield, with_shield};

/// What a run writes, the configuration and the wall-clock figures apart.
fn results(experiment: &str, set: Option<&str>) -> BTreeMap<String, String> {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("x.ron"), experiment).unwrap();
    let mut command = shield();
    command.current_dir(folder.path()).args(["run", "x.ron", "--seeds", "0"]);
    if let Some(set) = set {
        command.args(["--set", set]);
    }
    let output = command.output().unwrap();
    assert!(output.status.success(), "{set:?}: {}", String::from_utf8_lossy(&output.stderr));
    let name = if experiment.contains("\"cart\"") { "cart" } else { "small" };
    let run = folder.path().join(format!("runs/{name}/default/seed-0"));
    let mut results = BTreeMap::new();
    for file in ["metrics.csv", "interventions.csv", "evaluations.csv", "learning.csv"] {
        results.insert(file.to_string(), fs::read_to_string(run.join(file)).unwrap());
    }
    let summary = fs::read_to_string(run.join("summary.json")).unwrap();
    let timeless = summary.lines().take_while(|line| !line.contains("\"wall_seconds\""));
    results.insert("summary.json".into(), timeless.collect::<Vec<_>>().join("\n"));
    results
}

fn all_change(experiment: &str, sets: &[&str]) {
    let usual = results(experiment, None);
    assert!(usual == results(experiment, None), "two runs of one experiment differ");
    for set in sets {
        assert!(usual != results(experiment, Some(set)), "{set} changes nothing");
    }
}

#[test]
fn every_field_of_an_experiment_changes_a_run_in_the_gridworld() {
    let fields = [
        "steps=2400",
        "mode=StatusQuo",
        "mode=ForwardOnly",
        "mode=ResetOnly()",
        "environment.config.horizon=Some(9)",
        "environment.config.map=\"two-goals\"",
        "shield.rules[0].config.q_min=0.6",
        "shield.rules[0].config.combine=Pessimistic",
        "shield.projection=Best",
        "shield.rules[0]=Any([(plugin: \"deadline-latch\"), (plugin: \"ensemble-threshold\", config: (q_min: 0.4))])",
        "shield.rules[0]=All([(plugin: \"deadline-latch\"), (plugin: \"ensemble-threshold\", config: (q_min: 0.4))])",
        "shield.reset_attempts=2",
        "shield.reset_attempts=Unlimited",
        "shield.reset_test=FinalState",
        "shield.stop_on_reset=false",
        "shield.attempt_length=Steps(7)",
        "shield.attempt_length=Adaptive",
        "shield.warm_up_steps=1000",
        "shield.shield_exploration=true",
        "shield.on_abort=Truncate",
        "shield.on_abort=Penalise(0.5)",
        "experience.cost_weight=0.5",
        "experience.capacity=100",
        "experience.batch=8",
        "experience.updates_per_step=2",
        "experience.reset_updates_per_step=2",
        "experience.update_every=3",
        "experience.updates=Active",
        "experience.bootstrap_probability=0.5",
        "experience.on_reset_success=Bootstrap",
        "experience.on_reset_failure=Bootstrap",
        "evaluation.every=300",
        "evaluation.episodes=2",
        "evaluation.agent=Reset",
        "hard_reset_cost=2.5",
        "reset_task=Some(plugin: \"near-start\", config: (radius: 0.1))",
        "reset_task=Some(plugin: \"calibrated-start\")",
    ];
    // A reset test by the final state differs from one by any visited state only where the episode goes on.
    let experiment =
        gridworld(2_500, "").replace("warm_up_steps: 0,", "warm_up_steps: 0, stop_on_reset: true,");
    all_change(
        &experiment,
        &fields.iter().copied().filter(|field| !field.contains("FinalState")).collect::<Vec<_>>(),
    );
    all_change(
        &experiment.replace("stop_on_reset: true", "stop_on_reset: false"),
        &["shield.reset_test=FinalState"],
    );
    let aborting = experiment.replace("warm_up_steps: 0,", "warm_up_steps: 0, on_abort: Truncate,");
    all_change(&aborting, &["experience.abort_lifetime=Some(20)"]);
    let task = r#"reset_task: (plugin: "calibrated-start"), shield: ("#;
    all_change(&experiment.replace("shield: (", task), &["calibration_resets=20"]);
    let patient = experiment.replace("stop_on_reset: true", "reset_attempts: 3");
    all_change(&patient, &["shield.between_attempts=Reset"]);
}

#[test]
fn a_named_start_and_a_shielded_evaluation_change_a_run_of_the_cart() {
    // A threshold that rejects greedy actions too, else a shielded evaluation has nothing to do.
    all_change(&cart(600, "").replace("q_min: 1.0", "q_min: 1e6"), &["evaluation.shielded=false"]);
    all_change(&cart(600, ""), &["environment.config.fall_cost=3.0"]);
    all_change(&cart(600, ""), &["evaluation.start=Some(\"goal\")", "mode=ResetOnly(start: Some(\"goal\"))"]);
}

#[test]
fn every_field_of_the_decision_ladder_changes_a_run_of_the_cart() {
    // Half of the actions of an untrained agent push too far to the right for this rule.
    let rule = r#"(plugin: "linear-constraints", config: (constraints: [(a: [1.0], b: 0.1)]))"#;
    let ensemble = r#"(plugin: "ensemble-threshold", config: (q_min: 1.0, combine: Realist))"#;
    let experiment = cart(600, "").replace(ensemble, rule);
    let ladder = ["shield.projection=Qp()", "shield.projection=Replace", "shield.deadline_us=1000000"];
    all_change(&experiment, &ladder);
    let fields = [
        "shield.projection=Qp(margin: 0.05)",
        "shield.projection=Qp(trust_region: 0.2)",
        "shield.projection=Qp(weights: [4.0])",
    ];
    let projected = experiment.replace("warm_up_steps", "projection: Qp(), warm_up_steps");
    all_change(&projected, &fields);
    // The margin is given up in part: the more, the lower the priority.
    let careful = projected.replace("Qp()", "Qp(margin: 0.3)");
    let soft = careful.replace(rule, &format!("Soft(priority: 1.0, rule: {rule})"));
    all_change(&soft, &["shield.rules[0].priority=100.0"]);
}

#[test]
fn every_field_that_concerns_undo_probabilities_changes_a_run_of_the_gridworld() {
    let rule = r#"rules: [(plugin: "undo-probability", config: (initial_threshold: 0.9))],
        success_critic: (plugin: "tabular-success", config: (members: 3)),"#;
    let experiment = with_shield(&gridworld(2_000, ""), rule)
        .replace("every: 500", "every: 2000")
        .replace("batch: 16", "batch: 16, bootstrap_probability: 0.7");
    let fields = [
        "shield.rules[0].config.accepted_risk=Some(0.4)",
        "shield.rules[0].config.hard_resets_per_1000=Some(2.0)",
        "shield.rules[0].config.combine=Optimistic",
        "shield.rules[0].config.adapt=false",
        "shield.rules[0].config.adaptation_rate=0.2",
        "shield.rules[0].config.initial_threshold=0.5",
        "shield.rules[0].config.relative=false",
        "shield.success_critic=Some(plugin: \"success-critic\")",
        "shield.success_critic.config.members=2",
        "shield.success_critic.config.discount=0.9",
        "shield.success_critic.config.outcome_weight=0.1",
        "shield.success_critic.config.initial_probability=0.5",
        "shield.success_critic.config.least_step=0.5",
        "experience.failure_share=0.0",
        "experience.success_share=0.5",
        "experience.outcome_half_life=1.0",
        "experience.bootstrap_probability=0.5",
    ];
    // Tables that all learn the same have nothing to be combined.
    all_change(&experiment, &fields);
}

#[test]
fn every_field_of_the_success_critic_changes_a_run_of_the_cart() {
    // Neither a rule nor a critic is named: the usual ones are there.
    let usual = with_shield(&cart(600, ""), "").replace("every: 500", "every: 600");
    assert!(!usual.contains("rules"));
    let named = r#"rules: [(plugin: "undo-probability")], success_critic: Some(plugin: "success-critic"),"#;
    let named = with_shield(&cart(600, ""), named).replace("every: 500", "every: 600");
    assert!(results(&usual, None) == results(&named, None));
    let fields = [
        "shield.success_critic.config.members=2",
        "shield.success_critic.config.hidden=[8]",
        "shield.success_critic.config.learning_rate=0.01",
        "shield.success_critic.config.discount=0.9",
        "shield.success_critic.config.outcome_weight=0.1",
        "shield.success_critic.config.tau=0.5",
        "shield.success_critic.config.initial_probability=0.5",
        "shield.success_critic.config.normalise_observations=false",
    ];
    all_change(&named, &fields);
    all_change(
        &usual,
        &[
            "shield.rules=[(plugin: \"deadline-latch\")]",
            "shield.success_critic=Some(plugin: \"success-critic\", config: (members: 2))",
        ],
    );
}

#[test]
fn the_number_of_threads_changes_nothing() {
    let experiment = gridworld(1_000, "");
    assert!(results(&experiment, None) == results(&experiment, Some("threads=2")));
}
