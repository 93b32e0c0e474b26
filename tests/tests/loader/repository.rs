//! The plugins of this repository, found by their ids.

use shield_api::{metrics::Metrics, *};
use shield_runtime::plugin::{Kind, PluginError, Registry, SearchPath, Selection, host};
use shield_tests::plugins_folder;

use crate::fixtures::setup;

fn registry() -> Registry {
    Registry::scan(&SearchPath::new([plugins_folder()]))
}

/// The metrics that were reported, by their names.
fn drained(metrics: &Metrics) -> Vec<(String, f64)> {
    let mut figures = Vec::new();
    metrics.drain(&mut |name, mean| figures.push((name.to_string(), mean)));
    figures
}

#[test]
fn the_plugins_of_this_repository_are_found_and_work() {
    let registry = registry();
    let rule = registry.abort_rule(&Selection::new("ensemble-threshold"), "(q_min: 1.0)", &setup()).unwrap();
    assert!(rule.needs().values);
    let mut task =
        registry.reset_task(&Selection::new("near-start"), "(target: Some([1.0, 0.0]))", &setup()).unwrap();
    let signal = task.evaluate(&[0.0, 0.0], &[0.0], &[1.0, 0.0]).unwrap();
    assert_eq!(signal, ResetSignal { reward: 1.0, in_reset_set: true });
    for (id, config) in [
        ("uncertainty", ""),
        ("advantage", "(combine: KOfN(2))"),
        ("linear-constraints", "(max_change: Some([0.5]))"),
        ("deadline-latch", ""),
        ("undo-probability", "(accepted_risk: 0.1)"),
    ] {
        registry.abort_rule(&Selection::new(id), config, &setup()).unwrap_or_else(|error| panic!("{error}"));
    }
}

#[test]
fn the_calibrated_task_reports_how_much_lies_in_its_reset_set() {
    let registry = registry();
    let mut task = registry.reset_task(&Selection::new("calibrated-start"), "", &setup()).unwrap();
    let metrics = Metrics::default();
    metrics.collect(|| {
        // The first dimension varies among the starts, the second in the experience.
        (0..20u8).for_each(|index| task.observe_start(&[f32::from(index), 0.0]).unwrap());
        for index in 0..64u8 {
            task.evaluate(&[0.0, 0.0], &[0.0], &[10.0, f32::from(index)]).unwrap();
        }
    });
    let figures = drained(&metrics);
    let names: Vec<&str> = figures.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(names, ["radius", "dimensions", "starts_inside", "experience_inside"]);
    assert!(figures.iter().all(|(_, mean)| (0.0..=2.0).contains(mean)), "{figures:?}");
}

#[test]
fn the_rule_of_undo_probabilities_reports_its_threshold_and_the_realised_risk() {
    let registry = registry();
    let mut rule = registry.abort_rule(&Selection::new("undo-probability"), "", &setup()).unwrap();
    let mut figures = || {
        let metrics = Metrics::default();
        let decision = ObservedDecision { step: 1, aborted: false, action: &[0.0] };
        metrics.collect(|| rule.observe(&decision)).unwrap();
        rule.observe_attempt(&ObservedAttempt { step: 2, succeeded: false }).unwrap();
        drained(&metrics)
    };
    let [before, after] = [figures(), figures()];
    let expected = [("threshold", 0.84), ("realised_risk", 1.0), ("accepted_risk", 0.2)];
    let is_near =
        |found: &(String, f64), (name, value): (&str, f64)| found.0 == name && (found.1 - value).abs() < 1e-6;
    assert!(is_near(&before[0], ("threshold", 0.8)) && before.len() == 2, "{before:?}");
    assert!(
        after.len() == 3 && after.iter().zip(expected).all(|(found, of)| is_near(found, of)),
        "{after:?}"
    );
}

#[test]
fn the_success_critics_report_loss_probability_and_target() {
    let registry = registry();
    let spaces = Spaces { observation: Space::Discrete { n: 2 }, action: Space::Discrete { n: 2 } };
    for id in ["success-critic", "tabular-success"] {
        let setup = Setup::with_spaces(0, 1, host(), spaces.clone());
        let mut critic = registry.success_critic(&Selection::new(id), "(members: 2)", &setup).unwrap();
        let batch = AttemptBatch {
            size: 1,
            observations: &[1.0, 0.0],
            actions: &[0.0],
            next_observations: &[0.0, 1.0],
            next_actions: &[1.0],
            successes: &[1.0],
            continuations: &[0.0],
            outcomes: &[1.0],
            outcome_weights: &[1.0],
            masks: &[1.0; 2],
        };
        let metrics = Metrics::default();
        metrics.collect(|| critic.update(&batch)).unwrap();
        let figures = drained(&metrics);
        let names: Vec<&str> = figures.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(names, ["success_loss", "probability", "target"], "{id}");
        assert!(figures[0].1 > 0.0 && (figures[1].1 - 0.88).abs() < 0.01, "{id}: {figures:?}");
        assert_eq!(figures[2].1, 1.0, "{id}");
        let mut probabilities = [0.0; 2];
        critic.probabilities(&[1.0, 0.0], &[0.0], &mut probabilities).unwrap();
        assert!(probabilities.iter().all(|value| *value > 0.88), "{id}: {probabilities:?}");
    }
}

/// The manifest's defaults are text; `config.ron` is written from them.
#[test]
fn every_plugin_reads_the_defaults_of_its_manifest() {
    let registry = registry();
    assert!(registry.entries().len() >= 10, "{:?}", registry.skipped());
    for entry in registry.entries() {
        let manifest = &entry.manifest;
        let fields = manifest.fields.iter().map(|field| format!("{}: {}", field.name, field.default));
        let config = format!("({})", fields.collect::<Vec<_>>().join(", "));
        let selection = Selection::new(&manifest.id);
        let observation = Space::Discrete { n: 4 };
        let spaces = [Space::uniform(2, -1.0, 1.0), Space::Discrete { n: 3 }]
            .map(|action| Spaces { observation: observation.clone(), action });
        let made: Vec<Result<(), PluginError>> = spaces
            .into_iter()
            .map(|spaces| {
                let setup = Setup::with_spaces(0, 1, host(), spaces);
                match entry.kind {
                    Kind::Environment => {
                        registry.environment(&selection, &config, &Setup::new(0, 1, host())).map(drop)
                    }
                    Kind::Learner => registry.learner(&selection, &config, &setup).map(drop),
                    Kind::Policy => registry.policy(&selection, &config, &setup).map(drop),
                    Kind::AbortRule => registry.abort_rule(&selection, &config, &setup).map(drop),
                    Kind::ResetTask => registry.reset_task(&selection, &config, &setup).map(drop),
                    Kind::SuccessCritic => registry.success_critic(&selection, &config, &setup).map(drop),
                }
            })
            .collect();
        // A plugin may want more than its defaults, but must be able to read them: what it may refuse is an empty text, as of a path.
        let can_read = |made: &Result<(), PluginError>| match made {
            Err(PluginError::Config { position: Some(place), .. }) => {
                config[place.column as usize - 1..].starts_with("\"\"")
            }
            _ => true,
        };
        assert!(made.iter().all(can_read), "{} cannot read its own defaults {config}: {made:?}", manifest.id);
    }
}
