//! Whole experiments: what is accepted, what is refused and where, and the way back from a variant to the file.

mod faults;
mod overrides;
mod places;
mod resolved;

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
fn an_unreadable_file_is_refused_by_name() {
    let error = ExperimentFile::read("no/such.ron").unwrap_err();
    assert!(error.to_string().starts_with("no/such.ron: the file cannot be read: "), "{error}");
}
