//! A reset policy in the place of a reset agent that learns: through experiments and drop-ins, with the plugins of this repository.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::{
    fs,
    path::{Path, PathBuf},
    process::Output,
};

use serde_json::Value;
use shield_api::{Error, Space, Spaces};
use shield_runtime::{
    controller::Controller,
    decision::Decision,
    drop_in::DropIn,
    experiment::{DropInFile, InputError, Override},
    plugin::{Registry, SearchPath},
};
use shield_tests::{driven_home, plugins_folder, run_files, shield, way_home};
use tempfile::TempDir;

fn call(folder: &Path, arguments: &[&str]) -> Output {
    shield().current_dir(folder).args(arguments).output().unwrap()
}

fn said(output: &Output) -> String {
    format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr))
}

fn succeed(folder: &Path, arguments: &[&str]) -> String {
    let output = call(folder, arguments);
    assert!(output.status.success(), "{arguments:?}: {}", said(&output));
    said(&output)
}

const RUN: &str = "runs/cart/default/seed-0";

fn ran(experiment: &str, arguments: &[&str]) -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("x.ron"), experiment).unwrap();
    succeed(folder.path(), &[&["run", "x.ron"], arguments].concat());
    let run = folder.path().join(RUN);
    (folder, run)
}

#[test]
fn a_run_with_a_reset_policy_is_written_read_and_evaluated_like_any_other() {
    let (folder, run) = ran(&driven_home(1_500, ""), &[]);
    let json = |name: &str| -> Value { serde_json::from_slice(&fs::read(run.join(name)).unwrap()).unwrap() };
    let plugins = json("plugins.json");
    assert_eq!((&plugins["reset"]["id"], &plugins["reset"]["kind"]), (&"onnx".into(), &"policy".into()));
    assert!(plugins["shield.success_critic"].is_object(), "{plugins}");
    let summary = json("summary.json");
    assert_eq!((&summary["complete"], &summary["steps"]), (&true.into(), &1_500.into()));
    assert!(summary["reset_episodes"].as_u64().unwrap() > 5, "{summary}");
    // Attempts succeed, and none of them has a value.
    let mut metrics = csv::Reader::from_path(run.join("metrics.csv")).unwrap();
    let columns = metrics.headers().unwrap().clone();
    let column = |name: &str| columns.iter().position(|column| column == name).unwrap();
    let (phase, has_reset, value) = (column("phase"), column("has_reset"), column("reset_value"));
    let rows: Vec<_> = metrics.records().map(Result::unwrap).collect();
    let attempts = || rows.iter().filter(|row| &row[phase] == "reset");
    assert!(attempts().all(|row| row[value].is_empty()) && attempts().any(|row| &row[has_reset] == "1"));
    let learning = fs::read_to_string(run.join("learning.csv")).unwrap();
    assert!(learning.contains("success/success_loss") && !learning.contains("reset/"), "{learning}");

    let interventions = fs::read_to_string(run.join("interventions.csv")).unwrap();
    let first = interventions.lines().nth(1).unwrap().split(',').next().unwrap();
    for arguments in [
        &["eval", RUN, "--episodes", "1", "--agent", "reset"][..],
        &["eval", RUN, "--episodes", "1", "--shielded"],
        &["explain", RUN, "--step", first],
        &["report", "runs/cart", "--out", "page.html"],
        &["render", RUN, "--out", "film.gif", "--steps", "3"],
        &["plugin", "lock", "x.ron"],
    ] {
        succeed(folder.path(), arguments);
    }
    assert!(fs::read_to_string(folder.path().join("x.ron")).unwrap().contains("\"onnx\": \""));
    let exported = succeed(folder.path(), &["export", RUN]);
    assert!(exported.contains("forward.onnx") && !exported.contains("export/reset"), "{exported}");
}

#[test]
fn a_run_with_a_reset_policy_repeats_also_in_a_process_of_its_own() {
    let (_first, run) = ran(&driven_home(1_000, ""), &[]);
    let whole = run_files(&run);
    let resolved = fs::read_to_string(run.join("config.ron")).unwrap();
    assert!(resolved.contains("reset: Policy("), "{resolved}");
    let (_again, run) = ran(&resolved, &[]);
    assert!(run_files(&run) == whole);

    let (_isolated, run) = ran(&driven_home(1_000, ""), &["--set", "reset.isolate=true"]);
    let isolated = run_files(&run);
    for (name, bytes) in whole.iter().filter(|(name, _)| *name != "config.ron") {
        assert!(isolated[name] == *bytes, "{name} differs");
    }
}

#[test]
fn a_rule_that_needs_reset_values_is_refused_at_its_place_with_the_remedy() {
    let rule = r#"Any([(plugin: "linear-constraints", config: (max_change: Some([1.0]))), (plugin: "ensemble-threshold")])"#;
    let experiment = driven_home(100, "").replace(r#"(plugin: "undo-probability")"#, rule);
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("x.ron"), experiment).unwrap();
    let output = call(folder.path(), &["run", "x.ron"]);
    assert_eq!(output.status.code(), Some(2));
    for part in ["x.ron:9:", "`shield.rules[0][1]` (`ensemble-threshold`)", "`undo-probability`"] {
        assert!(said(&output).contains(part), "{part:?} is missing in: {}", said(&output));
    }
    assert!(!folder.path().join("runs").exists());
}

const DROP_IN: &str = r#"DropIn(
    shield: (
        rules: [(plugin: "undo-probability", config: (accepted_risk: 0.1))],
        success_critic: Some(plugin: "success-critic", config: (members: 3, hidden: [32, 32])),
        warm_up_steps: 0,
    ),
    experience: (capacity: 20_000, batch: 32),
    episode_length: 40,
)"#;

fn registry() -> Registry {
    Registry::scan(&SearchPath::new([plugins_folder()]))
}

fn file(sets: &[String]) -> Result<DropInFile, InputError> {
    let sets: Vec<_> = sets.iter().map(|set| Override::parse(set).unwrap()).collect();
    DropInFile::from_text("x.ron", DROP_IN, &sets)
}

fn line() -> Spaces {
    Spaces { observation: Space::unbounded(1), action: Space::uniform(1, -1.0, 1.0) }
}

#[test]
fn a_drop_in_takes_a_policy_from_its_file_also_in_a_process_of_its_own() {
    // The program that the process runs.
    drop(shield());
    let spaces = Spaces { observation: Space::unbounded(6), action: Space::uniform(1, -1.0, 1.0) };
    for isolated in [false, true] {
        let sets = [format!("reset={}", way_home()), format!("reset.isolate={isolated}")];
        let mut drop_in = file(&sets).unwrap().open(&registry(), Some(spaces.clone())).unwrap();
        let at = |x: f32| [x, 0.0, 0.0, 0.0, 0.0, 0.0];
        let seen = |x: f32| Some(shield_api::ResetSignal { reward: -x, in_reset_set: x == 0.0 });
        drop_in.filter(&at(0.0), &mut [0.5]).unwrap();
        drop_in.observe(&at(0.5), seen(0.5), false).unwrap();
        assert!(drop_in.begin_reset());
        let mut action = [0.5];
        assert_eq!(drop_in.filter(&at(0.5), &mut action).unwrap(), Decision::Resetting);
        assert!((action[0] - (-3.0_f32).tanh()).abs() < 1e-4, "{action:?}");
    }
}

#[test]
fn there_is_one_reset_agent_from_the_file_or_from_the_program() {
    let controller = || Controller::from_fn(|_, _| Err(Error::failed("never asked")));
    let nobody = file(&[]).unwrap().open(&registry(), Some(line())).err().unwrap().to_string();
    assert!(nobody.starts_with("x.ron:1:") && nobody.contains("reset: Policy("), "{nobody}");
    let named = file(&[format!("reset={}", way_home())]).unwrap();
    let both = named.open_with(&registry(), Some(line()), controller()).err().unwrap().to_string();
    assert!(both.contains("leave `reset` out"), "{both}");
}

/// A line on which a way home of 0.05 a step leads back from below 0.6; beyond, a slope is stronger.
struct Slope {
    drop_in: DropIn,
    position: f32,
}

impl Slope {
    fn new() -> Self {
        let way_home = Controller::from_fn(|position, action| {
            action[0] = if position[0] > 0.0 { -0.5 } else { 0.5 };
            Ok(())
        });
        let drop_in = file(&[]).unwrap().open_with(&registry(), Some(line()), way_home).unwrap();
        Self { drop_in, position: 0.0 }
    }

    /// Goes right, unless it is aborted; returns whether it had to be carried home.
    fn step(&mut self) -> bool {
        let mut action = [0.6];
        self.drop_in.filter(&[self.position], &mut action).unwrap();
        self.position += 0.1 * action[0] + if self.position > 0.6 { 0.06 } else { 0.0 };
        let is_home = self.position.abs() < 0.1;
        let home = shield_api::ResetSignal { reward: f32::from(u8::from(is_home)), in_reset_set: is_home };
        self.drop_in.observe(&[self.position], Some(home), self.position >= 1.0).unwrap();
        let is_lost = self.drop_in.needs_hard_reset();
        if is_lost {
            self.position = 0.0;
            self.drop_in.hard_reset_done(&[0.0]).unwrap();
        }
        is_lost
    }

    /// The mean undo probability of going right from here.
    fn probability(&mut self, position: f32) -> f32 {
        let mut action = [0.6];
        self.drop_in.hard_reset_done(&[0.0]).unwrap();
        self.drop_in.filter(&[position], &mut action).unwrap();
        let probabilities = &self.drop_in.judgement().probabilities;
        probabilities.iter().sum::<f32>() / probabilities.len() as f32
    }
}

#[test]
fn the_critic_learns_from_where_a_controller_does_not_lead_home() {
    let mut slope = Slope::new();
    let (mut carried, mut attempts) = ([0.0, 0.0], [0.0, 0.0]);
    for half in 0..2 {
        let before = slope.drop_in.counters().reset_episodes;
        carried[half] = (0..3_000).map(|_| f64::from(u8::from(slope.step()))).sum();
        attempts[half] = (slope.drop_in.counters().reset_episodes - before) as f64;
    }
    assert!(carried[0] >= 1.0 && carried[1] <= carried[0], "{carried:?} of {attempts:?}");
    assert!(attempts[1] > 50.0 && carried[1] < 0.1 * attempts[1], "{carried:?} of {attempts:?}");
    let [near, far] = [0.2, 0.75].map(|position| slope.probability(position));
    assert!(near > 0.85 && far < 0.3, "P is {near} at 0.2 and {far} at 0.75");
}
