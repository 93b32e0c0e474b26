//! What variants and the command line change in an experiment.

use super::*;

#[test]
fn overrides_of_the_command_line_come_last_and_errors_name_them() {
    let example = file(EXAMPLE);
    let variants = example.variants(&sets(&["shield.rules[0].config.q_min=7", "steps=5"]), None).unwrap();
    assert!(variants.iter().all(|variant| variant.experiment.steps == 5));
    assert_eq!(config(variants[2].experiment.rules().next().unwrap()), "(q_min: 7, combine: Pessimistic)");
    let check = |assignment: &str, message: &str| {
        let wrong = Override::parse(assignment).and_then(|set| small("").variants(&[set], None));
        assert_eq!(wrong.unwrap_err().to_string(), message);
    };
    check("steps=0", "--set steps=0: override `steps`: a run needs at least one step");
    check("steps", "--set steps: there is no `=`; write `--set path=value`, for example `--set steps=5000`");
    check(
        "steps=5, seeds: [1]",
        "--set steps=5, seeds: [1]: the value is not RON: `,` follows the value, where the text should end; a text needs quotes, for the shell as well: --set 'name=\"x\"'",
    );
    check("name=y", "--set name=y: override `name`: expected a text, found y; a text needs quotes");
    check(
        "shield.rulse=[]",
        "--set shield.rulse=[]: override `shield.rulse`: there is no field `rulse`, only `rules`, `success_critic`, `projection`, `deadline_us`, `reset_attempts`, `reset_test`, `between_attempts`, `stop_on_reset`, `attempt_length`, `warm_up_steps`, `shield_exploration`, `on_abort` and `fallback_action`; did you mean `rules`?",
    );
    let steps = Override::new("steps", "0", "--steps 0").unwrap();
    let error = small("").variants(&[steps], None).unwrap_err();
    assert_eq!(error.to_string(), "--steps 0: override `steps`: a run needs at least one step");
}

#[test]
fn overrides_add_absent_fields() {
    let variant = only(
        &small(""),
        &[
            "evaluation.every=5 // trailing",
            "evaluation.episodes=3",
            "shield.warm_up_steps=7",
            r#"forward.config.layers=[1, 2]"#,
            "forward.config.layers[1]=3",
            r#"reset.plugin="r""#,
            "environment.config.at=Some(x: 1)",
        ],
    );
    let experiment = &variant.experiment;
    let evaluation = experiment.evaluation.as_ref().unwrap();
    assert_eq!((evaluation.every, evaluation.episodes), (5, 3));
    assert_eq!(experiment.shield.warm_up_steps, 7);
    assert_eq!(config(experiment.forward.choice()), "(layers: [1, 3])");
    assert_eq!(config(&experiment.environment), "(at: Some((x: 1)))");
    assert_eq!(experiment.reset.as_ref().unwrap().choice().plugin, "r");
    let replaced = only(&small(", evaluation: None"), &["evaluation.every=5"]);
    assert_eq!(replaced.experiment.evaluation.unwrap().every, 5);
}

#[test]
fn a_required_field_may_be_given_by_every_variant_instead() {
    let text = r#"(name: "x", steps: 1, seeds: [0], mode: StatusQuo, forward: Learner(plugin: "f"),
        variants: {"a": [("environment", (plugin: "a"))], "b": [("environment.plugin", "b")]})"#;
    let variants = file(text).variants(&[], None).unwrap();
    let plugins: Vec<&str> = variants.iter().map(|variant| &*variant.experiment.environment.plugin).collect();
    assert_eq!(plugins, ["a", "b"]);
}
