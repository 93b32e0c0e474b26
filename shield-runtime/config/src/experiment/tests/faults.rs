//! What is refused, with the place of the fault in the file.

use super::*;

/// `text` holds a `@` where the fault is.
fn check(text: &str, message: &str) {
    let before = &text[..text.find('@').expect("a mark")];
    let line = before.matches('\n').count() + 1;
    let column = before.chars().rev().take_while(|character| *character != '\n').count() + 1;
    let error = file(&text.replacen('@', "", 1)).variants(&[], None).unwrap_err();
    assert_eq!(error.to_string(), format!("x.ron:{line}:{column}: {message}"), "{text}");
}

/// The same inside the small experiment.
fn check_field(field: &str, message: &str) {
    let text = SMALL.replacen('@', &format!(",\n    // a comment, ä\n    {field}"), 1);
    check(&text, message);
}

#[test]
fn faults_of_syntax_and_type_are_refused_with_their_place() {
    check("Experiment(\n  name: \"x\",\n  @", "the text ends, but the `(` of line 1 is not closed");
    check("(\n  name: \"x\" @steps: 5)", "`,` or `)` should stand here, not `steps`");
    check(
        "@(steps: 5, seeds: [], environment: (plugin: \"e\"), forward: Policy(plugin: \"p\"))",
        "the field `name` is missing",
    );
    check(
        "@Experimnt(name: \"x\")",
        "expected `Experiment(…)`, found `Experimnt`; did you mean `Experiment`?",
    );
    check_field("reset: @(config: ()),", "the field `plugin` is missing");
    check_field(
        "shield: (@rulse: []),",
        "there is no field `rulse`, only `rules`, `success_critic`, `projection`, `deadline_us`, `reset_attempts`, `reset_test`, `between_attempts`, `stop_on_reset`, `attempt_length`, `warm_up_steps`, `shield_exploration`, `on_abort` and `fallback_action`; did you mean `rules`?",
    );
    check_field("threads: 1, @threads: 2", "`threads` is given twice");
    check_field("threads: @-1", "expected a whole number of at least 0, found -1");
    check_field("threads: @\"two\"", "expected a whole number of at least 0, found \"two\"");
    check_field("hard_reset_cost: @\"dear\"", "expected a number, found \"dear\"");
    check_field(
        "experience: (updates: @Bth)",
        "there is no variant `Bth`, only `Active` and `Both`; did you mean `Both`?",
    );
    check_field("shield: (reset_attempts: @Unlimted)", "expected a number of attempts or `Unlimited`");
    check_field("shield: (reset_attempts: @-1, rules: [])", "expected a number of attempts or `Unlimited`");
    check_field("shield: (stop_on_reset: @1)", "expected true or false, found 1");
    check_field("reset: (plugin: @ddpg)", "expected a text, found ddpg; a text needs quotes");
    check_field(
        "reset: (plugin: @tabular-q)",
        "`tabular-q` is neither a number nor a name; a text needs quotes",
    );
    check_field("evaluation: (every: 1, start: @above)", "expected a text, found above; a text needs quotes");
    check_field(
        "evaluation: Some(every: 500, @episods: 1)",
        "there is no field `episods`, only `every`, `episodes`, `agent`, `start`, `shielded` and `solved_at`; did you mean `episodes`?",
    );
    for (field, name) in [("projection", "Qp"), ("on_abort", "Penalise")] {
        let message = format!("`{name}` needs a value in brackets: `{name}(…)`");
        check_field(&format!("shield: ({field}: @{name}, warm_up_steps: 1)"), &message);
    }
    check_field("experience: (updates: @Both(5))", "`Both` stands alone, without brackets");
    check_field(
        "experience: (updates: @\"Both\")",
        "expected `Active` or `Both`, found \"Both\"; leave the quotes out",
    );
    check_field("variants: @[]", "expected a map `{…}`, found a list `[…]`");
    check_field("variants: {\"a\": [@\"mode\"]}", "expected 2 values in brackets `(…)`, found \"mode\"");
    check_field("variants: {\"a\": [(\"mode\", StatusQuo, @1)]}", "expected 2 values, found 3");
    check_field("reset: @Some", "`Some` needs a value in brackets: `Some(…)`");
    check_field("shield: (rules: [@[]])", "expected `Rule`, `Soft`, `All` or `Any`, found a list `[…]`");
    check_field("@environment: (1)", "`environment` is given twice");
}

#[test]
fn invalid_values_are_refused_with_their_place() {
    let small = |from: &str, to: &str| SMALL.replace('@', "").replacen(from, to, 1);
    check(
        &small("\"x\"", "@\"a/b\""),
        "\"a/b\" cannot name a folder: it must not be empty, contain any of / \\ : * ? \" < > |, begin or end with a space, or end with a dot",
    );
    for name in ["", "..", " a", "a.", "a\\\\b", "a\\n"] {
        assert!(file(&small("\"x\"", &format!("{name:?}"))).variants(&[], None).is_err(), "{name:?}");
    }
    check(&small("10", "@0"), "a run needs at least one step");
    check(&small("[0]", "@[]"), "at least one seed is needed");
    check(&small("[0]", "[0, 1, @0]"), "the seed 0 is given twice");
    check(&small("\"e\"", "@\"\""), "the id of a plugin is empty");
    check(&small("ForwardOnly", "@Shielded"), "`Shielded` needs a reset agent: `reset: (plugin: …)`");
    check(&small("ForwardOnly", "@ResetOnly()"), "`ResetOnly` needs a reset agent: `reset: (plugin: …)`");
    check_field("threads: @0", "a run needs at least one thread");
    check_field(
        "hard_reset_cost: @-1.0",
        "the cost of a hard reset is -1; it must be finite and not negative",
    );
    check_field(
        "hard_reset_cost: @NaN",
        "the cost of a hard reset is NaN; it must be finite and not negative",
    );
    check_field(
        "shield: (reset_attempts: @0)",
        "a hard reset can follow 1 failed attempt or more, not 0; `Unlimited` means never",
    );
    check_field("shield: (fallback_action: Some([0.0, @inf]))", "an action cannot be inf");
    check_field("shield: (deadline_us: @0)", "every decision takes longer than 0 µs");
    check_field(
        "shield: (projection: Some(Qp(margin: @-0.5)))",
        "the margin is -0.5; it must be finite and not negative",
    );
    check_field(
        "shield: (projection: Some(Qp(max_iterations: @0)))",
        "a projection linearises the rules at least once",
    );
    for share in ["0.0", "-1.0", "inf", "NaN"] {
        check_field(
            &format!("shield: (projection: Some(Qp(trust_region: @{share})))"),
            "the share of half a dimension's range must be finite and above 0",
        );
    }
    check_field(
        "shield: (projection: Some(Qp(weights: Some([1.0, @0.0]))))",
        "the weight 0 is not finite and above 0",
    );
    for penalty in ["0.0", "-1.0", "inf", "NaN"] {
        let message = format!("the penalty {} is not finite and above 0", penalty.parse::<f32>().unwrap());
        check_field(&format!("shield: (on_abort: @Penalise({penalty}))"), &message);
    }
    check_field(
        "shield: (on_abort: @Truncate)",
        "a finished policy learns from nothing: it takes `forward: Learner(…)`, or `Nothing` here",
    );
    check_field("shield: (rules: [@Any([])])", "`All` and `Any` need at least one rule");
    check_field(
        "shield: (rules: [All([(plugin: \"r\"), @Any([])])])",
        "`All` and `Any` need at least one rule",
    );
    check_field("shield: (rules: [Any([(plugin: @\"\")])])", "the id of a plugin is empty");
    check_field(
        "shield: (rules: [Soft(priority: @0.0, rule: (plugin: \"r\"))])",
        "the priority 0 is not finite and above 0",
    );
    check_field(
        "shield: (rules: [(@plugn: \"r\")])",
        "there is no field `plugn`, only `plugin`, `path`, `config`, `isolate` and `worker`; did you mean `plugin`?",
    );
    check_field(
        "shield: (rules: [@Ayn([(plugin: \"r\")])])",
        "there is no variant `Ayn`, only `Rule`, `Soft`, `All` and `Any`; did you mean `Any`?",
    );
    check_field(
        "shield: (projection: @Best)",
        "a finished policy values no action: `Best` takes `forward: Learner(…)`; `Replace` works here",
    );
    check_field("experience: (cost_weight: @-1.0)", "the weight -1 is not finite and at least 0");
    check_field("experience: (cost_weight: @NaN)", "the weight NaN is not finite and at least 0");
    check_field("experience: (failure_share: @-0.1)", "-0.1 is not a share between 0 and 1");
    check_field("experience: (success_share: @NaN)", "NaN is not a share between 0 and 1");
    for half_life in ["0", "-1", "NaN"] {
        let field = format!("experience: (outcome_half_life: @{half_life})");
        let message = format!("the half-life {half_life} is not above 0; `inf`: outcomes do not fade");
        check_field(&field, &message);
    }
    check_field(
        "experience: (abort_lifetime: @0)",
        "an abort that teaches for no transition is not stored at all: leave `on_abort` out",
    );
    check_field(
        "experience: (failure_share: 0.75, success_share: @0.5)",
        "with `failure_share` it makes 1.25; a batch has no more than 1",
    );
    check_field(
        "record: (decisions: 0, states_every: @5)",
        "states are kept with decisions, of which `decisions: 0` keeps none",
    );
    check_field(
        "experience: (update_every: @0)",
        "every n-th step needs an n of at least 1; `updates_per_step: 0` learns nothing",
    );
    check_field("experience: (batch: @0)", "a batch needs at least one transition");
    check_field("experience: (batch: @65, capacity: 64)", "a batch of 65 does not fit into a capacity of 64");
    for probability in ["0", "1.5", "-1", "NaN"] {
        let field = format!("experience: (bootstrap_probability: @{probability})");
        let message = format!("{probability} is not a probability above 0 and up to 1");
        check_field(&field, &message);
    }
    check_field(
        "reset: (plugin: \"r\", isolate: @true)",
        "only environments and policies can run in a process of their own",
    );
    for value in ["0.0", "-1.0", "inf", "NaN"] {
        let (before, after) = ("\"e\", isolate: true, worker: (step_timeout_s: @", ")");
        let told = value.parse::<f64>().unwrap();
        check(
            &small("\"e\"", &format!("{before}{value}{after}")),
            &format!("a time limit is finite and above 0, not {told}"),
        );
        let text = small("\"p\"", &format!("\"p\", isolate: true, worker: (start_timeout_s: @{value})"));
        check(&text, &format!("a time limit is finite and above 0, not {told}"));
    }
    check(
        &small("\"e\"", "\"e\", worker: @(on_failure: Restart)"),
        "without `isolate: true` there is no worker process",
    );
    check_field("evaluation: Some(every: @0)", "evaluations need at least one step between them");
    check_field("evaluation: (every: 1, episodes: @0)", "an evaluation needs at least one episode");
    check_field("evaluation: (every: 1, solved_at: @2)", "2 is not a share above 0 and up to 1");
    check_field(
        "evaluation: (every: 1, agent: @Reset)",
        "the mode ForwardOnly has no reset agent to evaluate",
    );
    check(
        &EXAMPLE.replace(
            "rules: [(plugin: \"ensemble-threshold\", config: (q_min: 10.0, combine: Pessimistic))]",
            "rules: @[]",
        ),
        "variant `shielded`: `Shielded` without any rule would never abort: give at least one in `shield: (rules: […])`, or another mode",
    );
}

#[test]
fn faults_of_variants_name_the_variant_and_the_override() {
    check_field("variants: {\"a\": [], @\"a\": []}", "`a` is given twice");
    check_field(
        "variants: {@\"a/b\": []}",
        "\"a/b\" cannot name a folder: it must not be empty, contain any of / \\ : * ? \" < > |, begin or end with a space, or end with a dot",
    );
    check_field(
        "variants: {\"a\": [(\"steps\", @0)]}",
        "variant `a`, override `steps`: a run needs at least one step",
    );
    check_field(
        "variants: {\"a\": [(@\"stepz\", 5)]}",
        "variant `a`, override `stepz`: there is no field `stepz`, only `name`, `steps`, `seeds`, `mode`, `environment`, `forward`, `reset`, `shield`, `reset_task`, `calibration_resets`, `experience`, `evaluation`, `checkpoint`, `record`, `hard_reset_cost`, `threads`, `pins` and `variants`; did you mean `steps`?",
    );
    check_field(
        "variants: {\"a\": [(\"shield\", (\n stop_on_reset: @5))]}",
        "variant `a`, override `shield`: expected true or false, found 5",
    );
    check_field(
        "variants: {\"a\": [(@\"seeds[3]\", 5)]}",
        "variant `a`, override `seeds[3]`: there is no element [3]: the list has 1",
    );
    check_field(
        "variants: {\"a\": [(@\"steps.x\", 5)]}",
        "variant `a`, override `steps.x`: there is no place for `x`: the value there has no fields",
    );
    check_field(
        "variants: {\"a\": [(@\"variants\", {})]}",
        "variant `a`, override `variants`: `variants` cannot be overridden",
    );
    check_field(
        "variants: {\"a\": [(@\"a..b\", 1)]}",
        "variant `a`, override `a..b`: `a..b` is not a path; it should look like `shield.rules[0].config.q_min`",
    );
}
