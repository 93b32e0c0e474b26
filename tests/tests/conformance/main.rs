//! One suite over every environment that the loader finds: a new one is checked by being built.

#![cfg(all(target_os = "linux", target_env = "gnu"))]
#![allow(clippy::unwrap_used, reason = "tests")]

#[path = "../hot_path/malloc_ffi.rs"]
mod malloc_ffi;

use std::collections::BTreeMap;

use malloc_ffi::allocations;
use shield_api::{Environment, Setup};
use shield_runtime::{
    environment_check::{CHECKS, Subject, Verdict},
    plugin::{Kind, Registry, SearchPath, Selection, host},
};
use shield_tests::plugins_folder;

/// What is not told of an environment, and why that is right.
type Skips = BTreeMap<&'static str, String>;

/// Runs every check; panics with all that fail.
fn check(registry: &Registry, id: &str, config: &str) -> Skips {
    let make = || -> Result<Box<dyn Environment>, String> {
        let made = registry.environment(&Selection::new(id), config, &Setup::new(0, 1, host()));
        Ok(Box::new(made.map_err(|error| error.to_string())?))
    };
    let count = |body: &mut dyn FnMut()| allocations(body);
    let deterministic = registry.find(id, Kind::Environment).unwrap().manifest.deterministic;
    let subject =
        Subject { make: &make, is_deterministic: deterministic, seed: 1, allocations: Some(&count) };
    let (mut failures, mut skips) = (Vec::new(), Skips::new());
    for check in CHECKS {
        match (check.run)(&subject) {
            Ok(Verdict::Passed(_)) => {}
            Ok(Verdict::Skipped(reason)) => drop(skips.insert(check.name, reason)),
            Err(what) => failures.push(format!("{}: {what}", check.name)),
        }
    }
    assert!(failures.is_empty(), "{id} {config}:\n  {}", failures.join("\n  "));
    skips
}

#[test]
fn every_environment_passes_every_check() {
    let registry = Registry::scan(&SearchPath::new([plugins_folder()]));
    // Gymnasium is what the user's Python holds; its plugin has tests of its own for that.
    let of_kind = registry
        .entries()
        .iter()
        .filter(|entry| entry.kind == Kind::Environment && entry.manifest.id != "gymnasium");
    let mut subjects: Vec<(&str, &str)> = of_kind.map(|entry| (entry.manifest.id.as_str(), "")).collect();
    assert!(subjects.len() >= 10, "only {subjects:?} were found");
    subjects.extend([
        ("gridworld", "(map: \"two-goals\")"),
        ("gridworld", "(map: \"frozen-lake-8x8\")"),
        ("mujoco/peg-insertion", "(sparse: true)"),
        ("mujoco/cliff-walker", "(published_reward: true, cliff_length: 2.0)"),
        ("mujoco/pusher", "(published_reward: true, reset_distance: 0.1)"),
    ]);
    for (id, config) in subjects {
        let mut skips = check(&registry, id, config);
        // A machine without OpenGL runs everything else; the message must say what is missing.
        if let Some(reason) = skips.remove("picture") {
            assert!(reason.contains("cannot draw off-screen"), "{id}: {reason}");
        }
        assert!(skips.is_empty(), "{id} was not checked: {skips:?}");
    }
}
