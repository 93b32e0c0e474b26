//! What loading costs: a scan of a folder with 20 libraries, and calls through the wrappers against the same call of a Rust type.

#[path = "../tests/loader/fixtures.rs"]
#[allow(dead_code, clippy::unwrap_used)] // The tests use the rest.
mod fixtures;

use std::{fs, hint::black_box, time::Duration};

use criterion::{Criterion, criterion_group, criterion_main};
use shield_api::{
    AbortRule, ActMode, Checkpoint, Environment, Learner, Phase, Policy, Reason, Result, RuleContext, Setup,
    metrics::Metrics,
};
use shield_runtime::plugin::{
    Registry, SearchPath, Selection, host,
    isolated::{Isolation, OnFailure},
};

use fixtures::{optimised_fixture, setup};

fn scanning(criterion: &mut Criterion) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    for index in 0..20 {
        let copy = folder.path().join(format!("{index}.so"));
        // Of different lengths, else the registry would take them for copies of one library.
        let mut library = fs::read(optimised_fixture("every-kind")).expect("a library");
        library.extend(vec![0; index]);
        fs::write(copy, library).expect("a copy");
    }
    let search_path = SearchPath::new([folder.path()]);
    criterion.bench_function("scan of 20 libraries", |bencher| bencher.iter(|| Registry::scan(&search_path)));
}

/// The plugin `fixture/follower` as a Rust type.
struct Follower;

impl Checkpoint for Follower {}

impl Policy for Follower {
    fn act(&mut self, observation: &[f32], action: &mut [f32]) -> Result<()> {
        action[0] = observation[0];
        Ok(())
    }
}

/// Each call ends in `is_ok`, as a caller's does: a whole `Result`, kept from the optimiser, is copied in other pieces than it was written in,
/// and the processor's wait for that, some 6 ns, would hide what is measured.
fn calls(criterion: &mut Criterion) {
    let registry = Registry::default();
    let path = optimised_fixture("every-kind");
    let choice = |id: &str| Selection::new(id).at(&path);
    let (mut observation, mut action, mut values) = ([0.5; 2], [0.5], [0.0; 2]);

    let loaded = registry.policy(&choice("fixture/follower"), "", &setup()).expect("a policy");
    let policies: [(&str, Box<dyn Policy>); 2] = [("Rust", Box::new(Follower)), ("loaded", Box::new(loaded))];
    for (name, mut policy) in policies {
        criterion.bench_function(&format!("policy.act, {name}"), |bencher| {
            bencher.iter(|| policy.act(black_box(&observation), black_box(&mut action)).is_ok());
        });
    }
    let mut agent = registry.learner(&choice("fixture/agent"), "", &setup()).expect("a learner");
    criterion.bench_function("learner.act, loaded", |bencher| {
        bencher.iter(|| agent.act(black_box(&observation), ActMode::Greedy, black_box(&mut action)).is_ok());
    });
    criterion.bench_function("learner.q_values of 2 members, loaded", |bencher| {
        bencher.iter(|| {
            agent.q_values(black_box(&observation), black_box(&action), black_box(&mut values)).is_ok()
        });
    });
    let world = Setup::new(0, 1, host());
    let mut cells = registry.environment(&choice("fixture/cells"), "", &world).expect("an environment");
    criterion.bench_function("environment.step of 3 values, loaded", |bencher| {
        let mut observation = [0.0; 3];
        bencher.iter(|| cells.step(black_box(&[0.0]), black_box(&mut observation)).is_ok());
    });
    // The program in which it is isolated.
    shield_tests::shield();
    let patient = Duration::from_secs(60);
    let isolation = Isolation { on_failure: OnFailure::Error, start_timeout: patient, step_timeout: patient };
    let cells = registry.isolated_environment(&choice("fixture/cells"), "", &world, isolation);
    let mut cells = cells.expect("an environment");
    criterion.bench_function("environment.step of 3 values, isolated", |bencher| {
        let mut observation = [0.0; 3];
        bencher.iter(|| cells.step(black_box(&[0.0]), black_box(&mut observation)).is_ok());
    });
    let mut line = registry.environment(&choice("fixture/line"), "", &world).expect("an environment");
    criterion.bench_function("environment.step with one metric, loaded", |bencher| {
        Metrics::default().collect(|| {
            bencher.iter(|| line.step(black_box(&[0.0]), black_box(&mut observation)).is_ok());
        });
    });
}

fn rule(criterion: &mut Criterion) {
    let folder = std::env::current_exe().expect("a path");
    let registry = Registry::scan(&SearchPath::new(folder.parent()));
    let choice = Selection::new("ensemble-threshold");
    let rule = registry.abort_rule(&choice, "", &setup()).expect("the paper's rule");
    let mut room = [0; 256];
    for (name, value) in [("allow", 20.0), ("reject", 5.0)] {
        let values = [value; 20];
        let context = RuleContext {
            step: 0,
            observation: &[0.0; 2],
            proposed: &[0.0],
            previous: None,
            values: &values,
            greedy_values: &[],
            forward_values: &[],
            discount: 0.99,
            phase: Phase::Forward,
            ..RuleContext::default()
        };
        criterion.bench_function(&format!("ensemble-threshold, 20 members, {name}"), |bencher| {
            bencher.iter(|| rule.evaluate(black_box(&context), &mut Reason::new(&mut room)).is_ok());
        });
    }
}

criterion_group!(benches, scanning, calls, rule);
criterion_main!(benches);
