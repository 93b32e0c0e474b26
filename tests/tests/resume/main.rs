//! A run that was stopped or killed and then continued is the run that was never stopped, byte for byte.
#![allow(clippy::unwrap_used, reason = "tests")]

#[cfg(unix)]
mod left_alone;
#[cfg(unix)]
mod programs;
mod run_folder;
mod undoing;

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    sync::{
        OnceLock,
        atomic::{AtomicBool, Ordering},
    },
};

use shield_runtime::{
    events::{Counters, EvaluationEvent, Intervention},
    experiment::{ExperimentFile, Override},
    observer::{Observer, Scene, Step},
    plugin::{Registry, SearchPath},
    run::{Launch, Run, Standing},
};
use shield_tests::{cart, driven_home, gridworld, plugins_folder, run_files};
use tempfile::TempDir;

fn registry() -> &'static Registry {
    static REGISTRY: OnceLock<Registry> = OnceLock::new();
    REGISTRY.get_or_init(|| Registry::scan(&SearchPath::new([plugins_folder()])))
}

/// A run in a folder of its own.
struct Trial {
    run: Run,
    _home: TempDir,
}

impl Trial {
    fn new(experiment: &str, sets: &[&str]) -> Self {
        let home = tempfile::tempdir().unwrap();
        let sets: Vec<Override> = sets.iter().map(|set| Override::parse(set).unwrap()).collect();
        let variants = ExperimentFile::from_text("x.ron", experiment).variants(&sets, None).unwrap();
        Self { run: Run::new(home.path(), variants[0].clone(), 0), _home: home }
    }

    fn path(&self) -> &Path {
        self.run.folder.path()
    }

    fn standing(&self) -> anyhow::Result<Standing> {
        self.run.standing(registry())
    }

    fn begin(&self, overwrite: bool) -> anyhow::Result<Launch> {
        self.run.begin(registry(), None, overwrite)
    }

    fn proceed(&self) -> anyhow::Result<Launch> {
        self.run.proceed(registry())
    }

    /// Begins or goes on, until the saboteur says otherwise. Returns the steps that were made before.
    fn go(&self, sabotage: Sabotage) -> u64 {
        let launch = match self.standing().unwrap() {
            Standing::Missing => self.begin(false),
            _ => self.proceed(),
        };
        let launch = launch.unwrap();
        let before = launch.steps_before();
        let stop = AtomicBool::new(false);
        let ran = launch.run(Saboteur::new(sabotage, &stop), &stop);
        assert_eq!(ran.is_err(), matches!(sabotage, Sabotage::Crash(_) | Sabotage::CrashInEvaluation(_)));
        before
    }

    fn uninterrupted(experiment: &str) -> BTreeMap<String, Vec<u8>> {
        let run = Self::new(experiment, &[]);
        run.go(Sabotage::None);
        run.files()
    }

    fn files(&self) -> BTreeMap<String, Vec<u8>> {
        run_files(self.path())
    }

    fn checkpoint(&self, name: &str) -> PathBuf {
        self.path().join("checkpoint").join(name)
    }

    fn last_row(&self) -> String {
        fs::read_to_string(self.path().join("metrics.csv")).unwrap().lines().last().unwrap().to_owned()
    }
}

#[derive(Debug, Clone, Copy)]
enum Sabotage {
    None,
    /// Ctrl-C after so many steps.
    Stop(u64),
    /// Ctrl-C at so many rejected actions, between two steps perhaps.
    StopAtRejection(u64),
    /// The end of everything after so many steps: what was written since the last checkpoint stays behind.
    Crash(u64),
    /// The same within the evaluation at that step.
    CrashInEvaluation(u64),
}

struct Saboteur<'a> {
    sabotage: Sabotage,
    rejections: u64,
    stop: &'a AtomicBool,
}

impl<'a> Saboteur<'a> {
    fn new(sabotage: Sabotage, stop: &'a AtomicBool) -> Self {
        Self { sabotage, rejections: 0, stop }
    }
}

impl Observer for Saboteur<'_> {
    fn on_step(&mut self, step: &Step<'_>, _: &mut Scene<'_>) -> anyhow::Result<()> {
        let counters = step.counters;
        match self.sabotage {
            Sabotage::Stop(step) if counters.steps == step => self.stop.store(true, Ordering::Relaxed),
            Sabotage::Crash(step) => anyhow::ensure!(counters.steps != step, "crash"),
            _ => {}
        }
        Ok(())
    }

    fn on_intervention(&mut self, _: &Intervention<'_>, _: &mut Scene<'_>) -> anyhow::Result<()> {
        self.rejections += 1;
        if let Sabotage::StopAtRejection(number) = self.sabotage {
            self.stop.fetch_or(self.rejections == number, Ordering::Relaxed);
        }
        Ok(())
    }

    fn on_evaluation(&mut self, evaluation: &EvaluationEvent, _: &Counters) -> anyhow::Result<()> {
        if let Sabotage::CrashInEvaluation(step) = self.sabotage {
            anyhow::ensure!(evaluation.step != step, "crash");
        }
        Ok(())
    }
}

fn same(expected: &BTreeMap<String, Vec<u8>>, run: &Trial, why: &str) {
    let files = run.files();
    assert_eq!(expected.keys().collect::<Vec<_>>(), files.keys().collect::<Vec<_>>(), "{why}");
    for (name, bytes) in expected {
        assert!(*bytes == files[name], "{why}: {name} differs from that of an uninterrupted run");
    }
}

/// The gridworld with a memory that forgets, masks, and a rule and a reset task with states of their own.
fn grid() -> String {
    gridworld(
        1_500,
        r#"checkpoint: (every: 400), reset_task: (plugin: "near-start", config: (radius: 0.1)),"#,
    )
    .replace("batch: 16", "batch: 16, capacity: 150, bootstrap_probability: 0.7, cost_weight: 0.1")
    .replace("warm_up_steps", "on_abort: Penalise(0.5), warm_up_steps")
    .replace("rules: [", r#"rules: [(plugin: "deadline-latch", config: (steps: 3)), "#)
}

#[test]
fn a_stopped_run_continues_exactly() {
    let expected = Trial::uninterrupted(&grid());
    let mut phases = [0, 0];
    for step in [1, 2, 199, 399, 400, 401, 403, 500, 777, 1_000, 1_203, 1_499] {
        let run = Trial::new(&grid(), &[]);
        run.go(Sabotage::Stop(step));
        let row = run.last_row();
        assert!(row.contains("interrupted"), "{row}");
        phases[usize::from(row.contains("reset,"))] += 1;
        assert_eq!(run.go(Sabotage::None), step);
        same(&expected, &run, &format!("stopped after {step} steps"));
    }
    assert!(phases.iter().all(|count| *count > 0), "only one kind of episode was interrupted: {phases:?}");
}

#[test]
fn attempts_and_the_risk_are_counted_on_exactly() {
    let rule = r#"rules: [(plugin: "undo-probability"), "#;
    let critic = r#"success_critic: Some((plugin: "tabular-success")), warm_up_steps"#;
    let experiment = grid().replace("rules: [", rule).replace("warm_up_steps", critic);
    let expected = Trial::uninterrupted(&experiment);
    let summary = String::from_utf8_lossy(&expected["summary.json"]);
    assert!(
        summary.contains("\"accepted_risk\":0.2") && !summary.contains("\"brier_score\":null"),
        "{summary}"
    );
    for sabotage in [Sabotage::Stop(777), Sabotage::Crash(1_111)] {
        let run = Trial::new(&experiment, &[]);
        run.go(sabotage);
        run.go(Sabotage::None);
        same(&expected, &run, &format!("{sabotage:?}"));
    }
}

#[test]
fn a_crashed_run_continues_exactly_from_its_last_checkpoint() {
    let expected = Trial::uninterrupted(&grid());
    let crash = Sabotage::Crash;
    for (sabotage, last) in [
        (crash(1), 0),
        (crash(399), 0),
        (crash(400), 0),
        (crash(401), 400),
        (crash(1_111), 800),
        (Sabotage::CrashInEvaluation(500), 400),
        (Sabotage::CrashInEvaluation(1_500), 1_200),
    ] {
        let run = Trial::new(&grid(), &[]);
        run.go(sabotage);
        assert_eq!(run.go(Sabotage::None), last, "{sabotage:?}");
        same(&expected, &run, &format!("{sabotage:?}"));
    }
}

#[test]
fn a_run_that_stops_and_crashes_many_times_continues_exactly() {
    let expected = Trial::uninterrupted(&grid());
    let run = Trial::new(&grid(), &[]);
    for step in (30..1_500).step_by(70) {
        run.go(if step % 3 == 0 { Sabotage::Crash(step) } else { Sabotage::Stop(step) });
    }
    run.go(Sabotage::None);
    same(&expected, &run, "after many ends");
}

#[test]
fn networks_robots_and_projections_continue_exactly() {
    let rules = r#"rules: [(plugin: "linear-constraints", config: (constraints: [(a: [1.0], b: 0.1)])), "#;
    let experiment = cart(700, "checkpoint: (every: 250),")
        .replace("rules: [", rules)
        .replace("warm_up_steps", "projection: Qp(margin: 0.01), shield_exploration: true, warm_up_steps")
        .replace("episodes: 2", "episodes: 1, shielded: true");
    let expected = Trial::uninterrupted(&experiment);
    let projections = String::from_utf8_lossy(&expected["interventions.csv"]).matches("project").count();
    assert!(projections > 10, "only {projections} projections");
    for sabotage in [Sabotage::Stop(120), Sabotage::Stop(333), Sabotage::Crash(640)] {
        let run = Trial::new(&experiment, &[]);
        run.go(sabotage);
        run.go(Sabotage::None);
        same(&expected, &run, &format!("{sabotage:?}"));
    }
}

#[test]
fn a_shield_that_adapts_continues_exactly_and_so_do_its_evaluations() {
    let learned =
        r#"(plugin: "undo-probability", config: (accepted_risk: 0.05)), (plugin: "deadline-latch")"#;
    let experiment = cart(1_200, "checkpoint: (every: 250),")
        .replace(r#"(plugin: "ensemble-threshold", config: (q_min: 1.0, combine: Realist))"#, learned)
        .replace("warm_up_steps", r#"success_critic: (plugin: "success-critic"), warm_up_steps"#)
        .replace("every: 500", "every: 200");
    let expected = Trial::uninterrupted(&experiment);
    for sabotage in [Sabotage::Stop(333), Sabotage::Crash(640), Sabotage::CrashInEvaluation(1_000)] {
        let run = Trial::new(&experiment, &[]);
        run.go(sabotage);
        run.go(Sabotage::None);
        same(&expected, &run, &format!("{sabotage:?}"));
    }
}

#[test]
fn every_mode_continues_exactly() {
    for mode in ["StatusQuo", "ForwardOnly", "ResetOnly()"] {
        let experiment = gridworld(600, &format!("mode: {mode}, checkpoint: (every: 100),"));
        let expected = Trial::uninterrupted(&experiment);
        for sabotage in [Sabotage::Stop(333), Sabotage::Crash(250)] {
            let run = Trial::new(&experiment, &[]);
            run.go(sabotage);
            run.go(Sabotage::None);
            same(&expected, &run, &format!("{mode}, {sabotage:?}"));
        }
    }
}

#[test]
fn a_task_that_calibrates_itself_continues_exactly() {
    let experiment = cart(
        500,
        r#"checkpoint: (every: 150), calibration_resets: 5,
         reset_task: (plugin: "calibrated-start", config: (experience: 300)),"#,
    )
    .replace("warm_up_steps", "attempt_length: Adaptive, warm_up_steps");
    let expected = Trial::uninterrupted(&experiment);
    let learned = String::from_utf8_lossy(&expected["learning.csv"]);
    assert!(learned.contains("experience_inside") && learned.contains("attempt_length"));
    for sabotage in [Sabotage::Stop(70), Sabotage::Crash(250), Sabotage::Stop(299), Sabotage::Crash(470)] {
        let run = Trial::new(&experiment, &[]);
        run.go(sabotage);
        run.go(Sabotage::None);
        same(&expected, &run, &format!("{sabotage:?}"));
    }
}

#[test]
fn a_reset_policy_and_its_critic_continue_exactly() {
    let experiment = driven_home(700, "checkpoint: (every: 150),");
    let expected = Trial::uninterrupted(&experiment);
    assert!(String::from_utf8_lossy(&expected["learning.csv"]).contains("success/success_loss"));
    for sabotage in [Sabotage::Stop(70), Sabotage::Crash(250), Sabotage::Stop(401), Sabotage::Crash(640)] {
        let run = Trial::new(&experiment, &[]);
        run.go(sabotage);
        run.go(Sabotage::None);
        same(&expected, &run, &format!("{sabotage:?}"));
    }
}

fn damage(path: &Path) {
    let mut bytes = fs::read(path).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(path, bytes).unwrap();
}
