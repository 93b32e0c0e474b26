//! What is refused: with exit code 2, the place of the fault, and before anything is written.

use shield_tests::{gridworld, shield, text};

use super::run;

/// The experiment is refused with exit code 2 and a message that contains `expected`; nothing is written.
fn refused(experiment: &str, arguments: &[&str], expected: &[&str]) {
    let (output, folder) = run(experiment, arguments);
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{message}");
    for part in expected {
        assert!(message.contains(part), "{part:?} is missing in: {message}");
    }
    assert!(!folder.path().join("runs").exists(), "a refused start left a folder: {message}");
}

#[test]
fn wrong_input_is_refused_with_its_place() {
    let good = gridworld(100, "");
    refused(
        &good.replace("warm_up_steps", "warm_up_step"),
        &[],
        &["x.ron:10:", "warm_up_step", "warm_up_steps"],
    );
    let misspelt = good.replace("combine: Optimistic", "combne: Optimistic");
    refused(&misspelt, &[], &["x.ron:9:", "combne", "did you mean `combine`?"]);
    for set in ["shield.rules[0].config.q_min=NaN", "reset.config.members=0"] {
        refused(&good, &["--set", set], &[&format!("error: --set {set}: ")]);
    }
    refused(&good, &["--set", "shield.ruls[0].config.q_min=3"], &["`ruls`", "did you mean `rules`?"]);
    refused(&good, &["--jobs", "0"], &["--jobs"]);
    refused(&good.replace("q_min: 0.4", "q_min: \"high\""), &[], &["x.ron:9:"]);
    refused(&good.replace("\"tabular-q\"", "\"tabular\""), &[], &["x.ron:6:", "tabular-q"]);
    let nested = good
        .replace("rules: [(", "rules: [Any([(plugin: \"deadline-latch\", config: (stps: 3)), (")
        .replace("Optimistic))]", "Optimistic))])]");
    refused(&nested, &[], &["x.ron:9:", "stps"]);
    refused(
        &good.replace("reset: (plugin: \"tabular-q\")", "reset: (plugin: \"gridworld\")"),
        &[],
        &["x.ron:7:", "environment"],
    );
    refused(&good.replace("steps: 100", "steps: 0"), &[], &["x.ron:3:", "at least one step"]);
    refused(
        &good.replace("evaluation: Some(", "evaluation: Some(start: Some(\"roof\"), "),
        &[],
        &["x.ron:13:", "roof"],
    );
    refused(&good, &["--set", "shield.warm_up_step=3"], &["--set shield.warm_up_step=3"]);
    refused(&good, &["--variants", "q"], &["default"]);
    refused("Experiment(", &[], &["x.ron:1:"]);
    refused(&gridworld(100, "mode: ResetOnly(strat: None),"), &[], &["x.ron:14:", "strat"]);
    refused(&good, &["--set", "experience.capacity=1152921504606846976"], &["no memory", "capacity"]);
    let discrete = good.replace("warm_up_steps", "projection: Qp(), warm_up_steps");
    refused(&discrete, &[], &["x.ron:10:", "actions are discrete", "`Best` and `Replace` work here"]);
    let override_of_b = r#"variants: {"a": [], "b": [("shield.rules[0].config.q_min", "x")]},"#;
    refused(&gridworld(100, override_of_b), &[], &["x.ron:14:", "b"]);
}

#[test]
fn a_text_of_any_depth_or_length_is_refused_with_its_place() {
    let good = gridworld(100, "");
    let deep = |levels: usize| format!("{}1{}", "[".repeat(levels), "]".repeat(levels));
    let too_deep = "more than 128 brackets";
    for levels in [200, 3_901, 10_073] {
        let rules = good.replace("rules: [(", &format!("rules: [{}(", "All([".repeat(levels)));
        refused(&rules, &[], &["x.ron:9:", too_deep]);
        let options = good.replace("q_min: 0.4", &format!("q_min: {}0.4", "Some(".repeat(levels)));
        refused(&options, &[], &["x.ron:9:", too_deep]);
        refused(&deep(levels), &[], &["x.ron:1:129: ", too_deep]);
    }
    refused(&good, &["--set", &format!("reset.config={}", deep(200))], &["--set reset.config=", too_deep]);
    let nested = format!("environment.config{}=1", ".x".repeat(127));
    refused(&good, &["--set", &nested], &["--set environment.config.x", "more than 128 parts"]);
    let long = format!("{good}//{}", "x".repeat(5 << 20));
    refused(&long, &[], &["x.ron:16:", "at most 4194304 are read"]);
    let twice = good.replace("steps: 100,", "steps: 100,\n    steps: 200,");
    refused(&twice, &[], &["x.ron:4:5: `steps` is given twice"]);
}

#[test]
fn a_refused_setting_of_a_plugin_is_named_with_its_place() {
    let good = gridworld(100, "");
    let with = |config: &str| good.replace("config: (q_min: 0.4, combine: Optimistic)", config);
    for (config, place, message) in [
        ("config: (\n combine: Optimistic,\n q_min: NaN)", "x.ron:11:9: ", "q_min is NaN"),
        ("config: (q_min: 0.4,\n combine: Quantile(2.0))", "x.ron:10:11: ", "the quantile is 2"),
        ("config: (\n q_min: 0.4, schedule: Linear)", "x.ron:10:24: ", "a schedule needs final_q_min"),
        ("config: (\n\n final_q_min: Some(0.4))", "x.ron:11:15: ", "have no effect"),
        ("config: (\n q_mim: 0.4)", "x.ron:10:2: ", "did you mean `q_min`?"),
        ("config: (\n combine: KOfN(-1))", "x.ron:10:16: ", "a whole number of at least 0, found -1"),
    ] {
        refused(&with(config), &[], &[place, message]);
    }
}

#[test]
fn a_missing_file_and_a_missing_argument_are_input_errors() {
    let output = shield().args(["run", "/nonexistent/x.ron"]).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(text(&output.stderr).contains("/nonexistent/x.ron"));
    assert_eq!(shield().arg("run").output().unwrap().status.code(), Some(2));
    assert_eq!(shield().arg("walk").output().unwrap().status.code(), Some(2));
}
