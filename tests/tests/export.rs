//! `shield export`: what a learner writes, others can read.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::{fs, path::Path};

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use shield_api::{ActMode, Host, Policy, Setup};
use shield_runtime::{
    plugin::{Registry, SearchPath, Selection},
    run::{RunFolder, restore},
};
use shield_tests::{call, cart, gridworld, plugins_folder};

fn done(folder: &Path, arguments: &[&str]) {
    let output = call(folder, arguments);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// After a short run with these settings, what the onnx plugin plays is what both agents do.
fn check(sets: &[&str]) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    fs::write(path.join("x.ron"), cart(1_500, "")).unwrap();
    let sets: Vec<&str> = sets.iter().flat_map(|set| ["--set", set]).collect();
    done(path, &[&["run", "x.ron"], &sets[..]].concat());
    done(path, &["export", "runs/cart/default/seed-0", "--out", "out"]);

    let registry = Registry::scan(&SearchPath::new([plugins_folder()]));
    let run = RunFolder::at(path.join("runs/cart/default/seed-0"));
    let mut parts = restore(&registry, &run, &[]).unwrap().parts;
    let spaces = parts.world.spec().spaces.clone();
    let mut rng = Pcg64::seed_from_u64(1);
    let forward = parts.agents.forward.as_mut().and_then(|agent| agent.learner()).unwrap();
    let reset = parts.agents.reset.as_mut().map(|agent| agent.learner()).unwrap();
    for (name, learner) in [("forward", forward), ("reset", reset)] {
        let config = format!("(path: {:?})", path.join(format!("out/{name}.onnx")));
        let setup = Setup::with_spaces(0, 1, Host::silent(), spaces.clone());
        let mut policy = registry.policy(&Selection::new("onnx"), &config, &setup).unwrap();
        for _ in 0..100 {
            let observation: Vec<f32> =
                (0..spaces.observation_len()).map(|_| rng.random_range(-2.0..2.0)).collect();
            let (mut expected, mut found) = ([0.0], [0.0]);
            learner.act(&observation, ActMode::Greedy, &mut expected).unwrap();
            policy.act(&observation, &mut found).unwrap();
            assert!((expected[0] - found[0]).abs() < 1e-4, "{name}: {expected:?} against {found:?}");
        }
        let weights = fs::read(path.join(format!("out/{name}.safetensors"))).unwrap();
        let header = String::from_utf8_lossy(&weights[8..200]).into_owned();
        assert!(header.contains("\"dtype\":\"F32\""), "{header}");
    }
}

#[test]
fn an_exported_policy_acts_as_the_learner() {
    check(&[]);
}

#[test]
fn an_export_includes_normalisation_and_activations() {
    check(&[
        "forward.plugin=\"td3\"",
        "forward.config.activation=Relu",
        "forward.config.normalise_observations=true",
        "reset.config.normalise_observations=true",
    ]);
}

#[test]
fn an_export_of_a_stochastic_policy_is_its_mean() {
    check(&[
        "forward.plugin=\"sac\"",
        "reset.plugin=\"crossq\"",
        "forward.config.normalise_observations=true",
    ]);
}

#[test]
fn an_export_reports_what_a_learner_does_not_write() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("x.ron"), gridworld(200, "")).unwrap();
    done(folder.path(), &["run", "x.ron", "--seeds", "0", "--set", "forward.plugin=\"ddqn\""]);
    let output = call(folder.path(), &["export", "runs/small/default/seed-0"]);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{message}");
    for part in ["no forward.onnx: ddqn", "no reset.safetensors: tabular-q", "no reset.onnx"] {
        assert!(message.contains(part), "{message}");
    }
    let files: Vec<_> = fs::read_dir(folder.path().join("export")).unwrap().collect();
    assert_eq!(files.len(), 1, "forward.safetensors alone");
}

#[test]
fn an_export_of_a_learner_that_writes_nothing_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("x.ron"), gridworld(200, "")).unwrap();
    done(folder.path(), &["run", "x.ron", "--seeds", "0"]);
    let output = call(folder.path(), &["export", "runs/small/default/seed-0"]);
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{message}");
    assert!(
        message.contains("tabular-q") && message.contains("no learner that writes anything"),
        "{message}"
    );
    assert!(!folder.path().join("export").exists());
}
