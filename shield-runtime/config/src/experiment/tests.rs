//! Whole experiments: what is accepted, what is refused and where, and the way back from a variant to the file.

use std::path::PathBuf;

use shield_api::{Position, notation::position_at};

use super::*;

/// The example of the architecture, plus comments and the long forms.
const EXAMPLE: &str = r#"// An experiment.
Experiment(
    name: "cliff-cheetah",
    steps: 1_000_000,
    seeds: [0, 1, 2, 3, 4],
    mode: Shielded,                       // or StatusQuo, ForwardOnly
    environment: (plugin: "mujoco/cliff-cheetah", config: (horizon: 500)),
    forward: Learner(plugin: "ddpg", config: (critics: 20)),        // or Policy(plugin: "onnx")
    reset: (plugin: "ddpg", config: /* before */ (critics: 20) /* after */),
    shield: (
        rules: [(plugin: "ensemble-threshold", config: (q_min: 10.0, combine: Pessimistic))],
        projection: Some(Qp(margin: 0.5, max_iterations: 3)),
        reset_attempts: 1,
        warm_up_steps: 1_000,
    ),
    reset_task: None,                     // or Some(plugin: "near-start", config: (…))
    experience: (capacity: 1_000_000, batch: 64, updates_per_step: 1),
    evaluation: Some(every: 10_000, episodes: 10),
    threads: 2,
    variants: {"shielded": [], "status-quo": [("mode", StatusQuo)], "q_min-5": [("shield.rules[0].config.q_min", 5.0)]},
)
"#;

/// The smallest experiment, on one line; `@` stands for further fields.
const SMALL: &str = r#"(name: "x", steps: 10, seeds: [0], mode: ForwardOnly, environment: (plugin: "e"), forward: Policy(plugin: "p")@)"#;

fn file(text: &str) -> ExperimentFile {
    ExperimentFile::from_text("x.ron", text)
}

fn small(more: &str) -> ExperimentFile {
    file(&SMALL.replace('@', more))
}

fn sets(assignments: &[&str]) -> Vec<Override> {
    assignments.iter().map(|assignment| Override::parse(assignment).unwrap()).collect()
}

fn only(file: &ExperimentFile, assignments: &[&str]) -> Variant {
    let mut variants = file.variants(&sets(assignments), None).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(variants.len(), 1);
    variants.remove(0)
}

fn config(choice: &PluginChoice) -> &str {
    choice.config.get_ron()
}

#[test]
fn the_example_experiment_is_accepted() {
    let variants = file(EXAMPLE).variants(&[], None).unwrap();
    let names: Vec<&str> = variants.iter().map(|variant| variant.name.as_str()).collect();
    assert_eq!(names, ["shielded", "status-quo", "q_min-5"]);
    let experiment = &variants[0].experiment;
    assert_eq!((experiment.steps, experiment.seeds.len(), experiment.threads), (1_000_000, 5, 2));
    assert_eq!(config(experiment.reset.as_ref().unwrap().choice()), "(critics: 20)");
    assert!(experiment.reset_task.is_none() && experiment.variants.is_empty());
    assert_eq!(experiment.evaluation.as_ref().unwrap().every, 10_000);
    assert_eq!(variants[1].experiment.mode, Mode::StatusQuo);
    assert_eq!(config(experiment.rules().next().unwrap()), "(q_min: 10.0, combine: Pessimistic)");
    assert_eq!(config(variants[2].experiment.rules().next().unwrap()), "(q_min: 5.0, combine: Pessimistic)");
}

#[test]
fn short_and_long_forms_mean_the_same() {
    let check = |field: &str, forms: &[&str]| {
        let read = |form: &&str| {
            let resolved = only(&small(&format!(", {field}: {form}")), &[]).resolved_ron(0, &|_| Vec::new());
            assert!(resolved.contains(&format!("{field}: ")), "{resolved}");
            resolved
        };
        let all: Vec<String> = forms.iter().map(read).collect();
        assert!(all.iter().all(|resolved| *resolved == all[0]), "{all:#?}");
    };
    check(
        "reset",
        &[
            r#"(plugin: "r")"#,
            r#"Some(plugin: "r")"#,
            r#"Some((plugin: "r"))"#,
            r#"(plugin: "r", config: ())"#,
        ],
    );
    check("evaluation", &["(every: 5)", "Some(every: 5)", "Some((every: 5, start: None))"]);
    check("shield", &["()", "(fallback_action: None, stop_on_reset: true)"]);
    check(
        "reset_task",
        &[
            r#"Some(plugin: "n", config: (at: Some(x: 1, y: Some(1, 2))))"#,
            r#"(plugin: "n", config: (at: Some((x: 1, y: Some((1, 2))))))"#,
        ],
    );
    let long = SMALL
        .replace("Policy(plugin: \"p\")@", "Policy(/* x */ (plugin: \"p\", config: (a: Some(b: 1)),), )");
    let long = only(&file(&format!("#![enable(implicit_some)]\n{long}")), &[]);
    assert_eq!(config(long.experiment.forward.choice()), "(a: Some((b: 1)))");
    let unlimited = only(&small(", shield: (reset_attempts: Unlimited)"), &[]);
    assert_eq!(unlimited.experiment.shield.reset_attempts, ResetAttempts::Never(Unlimited::Unlimited));
    for start in ["\"above\"", "Some(\"above\")"] {
        let assignments = [&format!("mode=ResetOnly(start: {start})"), r#"reset=(plugin: "r")"#];
        let insert = only(&small(""), &assignments.map(|text| text as &str));
        assert_eq!(insert.experiment.mode, Mode::ResetOnly { start: Some("above".into()) });
    }
}

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
        "there is no field `rulse`, only `rules`, `success_critic`, `projection`, `deadline_us`, `reset_attempts`, `reset_test`, `between_attempts`, `stop_on_reset`, `warm_up_steps`, `shield_exploration`, `on_abort` and `fallback_action`; did you mean `rules`?",
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
        "experience: (failure_share: 0.75, success_share: @0.5)",
        "with `failure_share` it makes 1.25; a batch has no more than 1",
    );
    check_field(
        "record: (decisions: 0, states_every: @5)",
        "states are kept with decisions, of which `decisions: 0` keeps none",
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
        "variant `a`, override `stepz`: there is no field `stepz`, only `name`, `steps`, `seeds`, `mode`, `environment`, `forward`, `reset`, `shield`, `reset_task`, `experience`, `evaluation`, `checkpoint`, `record`, `hard_reset_cost`, `threads`, `pins` and `variants`; did you mean `steps`?",
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

#[test]
fn composed_rules_are_read_as_they_are_written() {
    let rules = r#"shield: (rules: [
        (plugin: "a", config: (x: 1)),
        Any([All([(plugin: "b"), Rule(plugin: "c")]), (plugin: "d", config: (y: 2))]),
        Soft(priority: 2.0, rule: (plugin: "e", config: (z: 3))),
    ])"#;
    let text = SMALL.replace('@', &format!(", {rules}"));
    let variant = only(&file(&text), &["shield.rules[1][1].config.y=5", "shield.rules[2].rule.config.z=6"]);
    let plugins: Vec<&str> = variant.experiment.rules().map(|choice| choice.plugin.as_str()).collect();
    assert_eq!(plugins, ["a", "b", "c", "d", "e"]);
    let configs: Vec<&str> = variant.experiment.rules().map(config).collect();
    assert_eq!(configs, ["(x: 1)", "()", "()", "(y: 5)", "(z: 6)"]);
    let paths: Vec<String> = variant.experiment.plugins().into_iter().map(|(path, _, _)| path).collect();
    assert_eq!(
        paths[2..].join(" "),
        "shield.rules[0] shield.rules[1][0][0] shield.rules[1][0][1] shield.rules[1][1] shield.rules[2].rule"
    );
    let place = text.find("\"b\"").unwrap();
    let Position { line, column } = position_at(&text, place);
    assert_eq!(
        variant.locate("shield.rules[1][0][0].plugin", None).to_string(),
        format!("x.ron:{line}:{column}")
    );
    let resolved = variant.resolved_ron(0, &|_| Vec::new());
    let again = only(&file(&resolved), &[]);
    assert_eq!(again.resolved_ron(0, &|_| Vec::new()), resolved);
    assert!(!resolved.contains("Rule("), "{resolved}");
}

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
        "--set shield.rulse=[]: override `shield.rulse`: there is no field `rulse`, only `rules`, `success_critic`, `projection`, `deadline_us`, `reset_attempts`, `reset_test`, `between_attempts`, `stop_on_reset`, `warm_up_steps`, `shield_exploration`, `on_abort` and `fallback_action`; did you mean `rules`?",
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

#[test]
fn variants_are_chosen_by_name() {
    let names = ["q_min-5".to_owned(), "shielded".to_owned()];
    let chosen = file(EXAMPLE).variants(&[], Some(&names)).unwrap();
    assert_eq!(chosen.iter().map(|variant| &*variant.name).collect::<Vec<_>>(), ["shielded", "q_min-5"]);
    let unknown = file(EXAMPLE).variants(&[], Some(&["shield".to_owned()])).unwrap_err();
    assert_eq!(
        unknown.to_string(),
        "x.ron: there is no variant `shield`; there are: shielded, status-quo, q_min-5; did you mean `shielded`?"
    );
    let default = small("").variants(&[], Some(&["default".to_owned()])).unwrap();
    assert_eq!(default[0].name, "default");
    assert!(small("").variants(&[], Some(&["other".to_owned()])).is_err());
}

#[test]
fn a_fault_that_a_plugin_reports_is_located_in_the_users_file() {
    let text = SMALL.replace(
        '@',
        r#", reset: (plugin: "r", config: // first
    (
        a: 1,
        b: Some(c: 2, d: 3),
        e: 4,
    )), variants: {"v": [("reset.config.e", 50), ("reset.config.g", 6)]}"#,
    );
    let mut sets = sets(&["reset.config.h=8"]);
    sets.push(Override::new("reset.config.a", "10", "--a 10").unwrap());
    let variant = file(&text).variants(&sets, None).unwrap().remove(0);
    let config = config(variant.experiment.reset.as_ref().unwrap().choice()).to_owned();
    let place_of = |needle: &str| {
        let offset = config.find(needle).unwrap();
        let position = position_at(&config, offset);
        variant.locate("reset.config", Some(position)).to_string()
    };
    let in_file = |needle: &str| {
        let Position { line, column } = position_at(&text, text.find(needle).unwrap());
        format!("x.ron:{line}:{column}")
    };
    assert_eq!(place_of("b: Some"), in_file("b: Some"));
    assert_eq!(place_of("d: 3"), in_file("d: 3"));
    assert_eq!(place_of("50"), in_file("50"));
    assert_eq!(place_of("g: 6"), in_file("\"reset.config.g\""));
    assert_eq!(place_of("6"), in_file("6)]"));
    assert_eq!(place_of("10"), "--a 10");
    assert_eq!(place_of("h: 8"), "--set reset.config.h=8");
    assert_eq!(variant.locate("reset.config", None).to_string(), in_file("(\n        a: 1"));
    assert_eq!(
        variant.locate("reset.config", Some(Position { line: 1, column: 1 })).to_string(),
        in_file("(\n        a: 1")
    );
    assert_eq!(
        variant.locate("environment.config", Some(Position { line: 1, column: 2 })).to_string(),
        in_file("(plugin: \"e\")")
    );
    assert_eq!(variant.locate("shield.rules[0]", None).to_string(), "x.ron:1:1");
    let error = variant.error_at("reset.config", Some(Position { line: 9, column: 9 }), "odd");
    assert_eq!(error.to_string(), format!("{}: variant `v`: odd", in_file(")), variants")));
    assert_eq!(variant.file(), PathBuf::from("x.ron"));
    let place_in = |field: &str| variant.locate(&format!("reset.config.{field}"), None).to_string();
    assert_eq!(place_in("b"), in_file("Some(c: 2"));
    assert_eq!(place_in("b.d"), in_file("3),\n"));
    assert_eq!(place_in("e"), in_file("50"));
    assert_eq!(place_in("h"), "--set reset.config.h=8");
}

/// A plugin that was built with 1.0.0 reads one form of `Some(…)` in the whole text, not both beside one another.
#[test]
fn a_configuration_reaches_a_plugin_in_the_form_that_all_since_1_0_read() {
    #[derive(Debug, serde::Deserialize)]
    struct Settings {
        one: Option<Limits>,
        other: Option<Limits>,
        third: Option<(u8, u8)>,
    }
    #[derive(Debug, serde::Deserialize)]
    struct Limits {
        low: f32,
    }
    let config = r#"(one: Some(low: 1), other: Some((low: 2)), third: Some(3, 4))"#;
    let text = SMALL.replace('@', &format!(", reset: (plugin: \"r\", config: {config})"));
    let variant = only(&file(&text), &["reset.config.one=Some(low: 5)"]);
    let reset = variant.experiment.reset.as_ref().unwrap().choice();
    let Settings { one, other, third } = ron::from_str(self::config(reset)).unwrap();
    assert_eq!((one.unwrap().low, other.unwrap().low, third), (5.0, 2.0, Some((3, 4))));
    assert!(
        only(&file(&text), &[])
            .resolved_ron(0, &|_| Vec::new())
            .contains("config: (one: Some((low: 1)), other: Some((low: 2)), third: Some((3, 4)))")
    );
}

#[test]
fn the_resolved_configuration_is_complete_and_can_be_run_again() {
    let fields = |id: &str| -> Vec<(String, String)> {
        let fields: &[(&str, &str)] = match id {
            "ddpg" => &[("critics", "20"), ("hidden", "[400, 300]"), ("gamma", "0.99"), ("bad", "vec![]")],
            _ => &[],
        };
        fields.iter().map(|(name, default)| ((*name).to_owned(), (*default).to_owned())).collect()
    };
    let variant = &file(EXAMPLE).variants(&sets(&["reset.config.critics=5"]), None).unwrap()[2];
    let resolved = variant.resolved_ron(3, &fields);
    assert_eq!(resolved, RESOLVED);
    let again = only(&file(&resolved), &[]);
    assert_eq!(again.experiment.seeds, [3]);
    assert_eq!(
        again.resolved_ron(3, &fields).lines().skip(1).collect::<Vec<_>>(),
        RESOLVED.lines().skip(1).collect::<Vec<_>>()
    );
}

const RESOLVED: &str = r#"// cliff-cheetah, variant q_min-5, seed 3
Experiment(
    name: "cliff-cheetah",
    steps: 1000000,
    seeds: [3],
    mode: Shielded,
    environment: (plugin: "mujoco/cliff-cheetah", path: None, config: (horizon: 500)),
    forward: Learner(
        plugin: "ddpg",
        path: None,
        config: (critics: 20, hidden: [400, 300], gamma: 0.99),
    ),
    reset: (plugin: "ddpg", path: None, config: (critics: 5, hidden: [400, 300], gamma: 0.99)),
    shield: (
        rules: [
            (
                plugin: "ensemble-threshold",
                path: None,
                config: (q_min: 5.0, combine: Pessimistic),
            ),
        ],
        success_critic: None,
        projection: Qp(margin: 0.5, max_iterations: 3, trust_region: None, weights: None),
        deadline_us: None,
        reset_attempts: 1,
        reset_test: AnyVisited,
        between_attempts: Forward,
        stop_on_reset: true,
        warm_up_steps: 1000,
        shield_exploration: false,
        on_abort: Nothing,
        fallback_action: None,
    ),
    reset_task: None,
    experience: (
        capacity: 1000000,
        batch: 64,
        updates_per_step: 1,
        updates: Active,
        bootstrap_probability: 1.0,
        on_reset_success: Bootstrap,
        on_reset_failure: Bootstrap,
        abort_lifetime: None,
        failure_share: 0.25,
        success_share: 0.125,
        outcome_half_life: 15.0,
        cost_weight: 0.0,
    ),
    evaluation: (
        every: 10000,
        episodes: 10,
        agent: Forward,
        start: None,
        shielded: true,
        solved_at: 1.0,
    ),
    checkpoint: (every: 10000),
    record: (decisions: 1, states_every: 0),
    hard_reset_cost: 1.0,
    threads: 2,
)
"#;

#[test]
fn an_unreadable_file_is_refused_by_name() {
    let error = ExperimentFile::read("no/such.ron").unwrap_err();
    assert!(error.to_string().starts_with("no/such.ron: the file cannot be read: "), "{error}");
}
