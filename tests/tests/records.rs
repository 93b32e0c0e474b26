//! The record of a drop-in, and the commands that explain and replay it.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::{
    fs,
    path::{Path, PathBuf},
    process::Output,
    sync::OnceLock,
};

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use shield_api::{Environment, Setup};
use shield_runtime::{
    cycle::HardResetDue,
    drop_in::DropIn,
    drop_in_files,
    experiment::DropInFile,
    plugin::{Registry, SearchPath, Selection, host},
    record::{Record, RecordSettings, is_record},
    run::{DecisionRow, read_decisions},
    world::{Stepped, World},
};
use shield_tests::{plugins_folder, shield, text};

const UNDOING: &str =
    r#"rules: [(plugin: "undo-probability", config: (relative: false, initial_threshold: 0.9))],"#;
/// Rules of which one has a memory of its own, and a reset agent whose exploration they judge.
const SEVERAL: &str = r#"rules: [(plugin: "undo-probability"), (plugin: "deadline-latch", config: (steps: 60)),
    (plugin: "linear-constraints", config: (max_change: Some([1.2])))], shield_exploration: true,"#;
const PROJECTING: &str = r#"rules: [(plugin: "linear-constraints", config: (constraints: [(a: [1.0], b: 0.3)]))], projection: Some(Qp()),"#;

fn registry() -> &'static Registry {
    static REGISTRY: OnceLock<Registry> = OnceLock::new();
    REGISTRY.get_or_init(|| Registry::scan(&SearchPath::new([plugins_folder()])))
}

/// What a caller does with an aborted action.
#[derive(Clone, Copy)]
enum OnAbort {
    /// Executes what stands in for it.
    Executes,
    /// Executes nothing, and decides anew.
    Waits,
}

/// A cart, a shield whose decisions are recorded, and a policy that acts at random.
struct Cart {
    shield: DropIn,
    record: Record,
    world: World,
    policy: Pcg64,
}

impl Cart {
    fn new(shield: &str, folder: &Path, settings: RecordSettings) -> Self {
        let setup = Setup::new(0, 1, host());
        let environment = registry().environment(&Selection::new("mujoco/cliff-cart"), "", &setup).unwrap();
        let text = format!(
            r#"DropIn(
                reset: (plugin: "ddpg", config: (critics: 2, actor_hidden: [16], critic_hidden: [16])),
                shield: ({shield} warm_up_steps: 0),
                experience: (batch: 16, updates: Both, capacity: 5000),
                episode_length: 40,
            )"#
        );
        let file = DropInFile::from_text("x.ron", text.as_str(), &[]).unwrap();
        let spaces = environment.spec().spaces;
        let mut shield = file.open(registry(), Some(spaces)).unwrap();
        let record = Record::begin(&mut shield, &file, registry(), folder, settings).unwrap();
        let world = World::new(Box::new(environment), None).unwrap();
        Self { shield, record, world, policy: Pcg64::seed_from_u64(0) }
    }

    fn place(&mut self, seed: u64) {
        self.world.hard_reset(None, seed).unwrap();
        self.shield.hard_reset_done(self.world.observation()).unwrap();
    }

    /// So many decisions and, now and then, a step that ends in the middle of nowhere or a reset without need.
    fn drive(&mut self, decisions: u64, on_abort: OnAbort) {
        for number in 0..decisions {
            let mut action = [self.policy.random_range(-1.0..=1.0)];
            let decision = self.shield.filter(self.world.observation(), &mut action).unwrap();
            if decision.abort().is_some() && matches!(on_abort, OnAbort::Waits) {
                continue;
            }
            let Stepped::Made(outcome) = self.world.step(&action).unwrap() else {
                panic!("nothing is isolated")
            };
            self.shield.observe_outcome(self.world.next_observation(), &outcome).unwrap();
            self.world.advance();
            match number % 250 {
                100 => self.shield.require_hard_reset(HardResetDue::Lost),
                200 => drop(self.shield.begin_reset()),
                _ => {}
            }
            if self.shield.needs_hard_reset() {
                self.place(number);
            }
        }
    }

    fn rejections(&self) -> u64 {
        self.shield.counters().early_aborts + self.shield.counters().projections
    }
}

/// A cart that drove, and its record.
fn recorded(shield: &str, on_abort: OnAbort) -> (tempfile::TempDir, PathBuf, Cart) {
    let folder = tempfile::tempdir().unwrap();
    let record = folder.path().join("record");
    let mut cart = Cart::new(shield, &record, RecordSettings::default());
    cart.place(0);
    cart.drive(2_500, on_abort);
    cart.record.flush();
    assert_eq!(cart.record.take_trouble(), None);
    (folder, record, cart)
}

fn command(name: &str, record: &Path, arguments: &[&str]) -> Output {
    shield().arg(name).arg(record).args(arguments).output().unwrap()
}

fn succeed(name: &str, record: &Path, arguments: &[&str]) -> String {
    let output = command(name, record, arguments);
    assert!(output.status.success(), "{name} {arguments:?}: {}", text(&output.stderr));
    text(&output.stdout)
}

fn refused(name: &str, record: &Path, arguments: &[&str]) -> String {
    let output = command(name, record, arguments);
    assert!(!output.status.success(), "{name} {arguments:?}: {}", text(&output.stdout));
    text(&output.stderr)
}

fn decisions(record: &Path) -> Vec<DecisionRow> {
    let mut rows = Vec::new();
    read_decisions(record, |row| {
        rows.push(row);
        Ok(true)
    })
    .unwrap();
    rows
}

/// Of the first row of a table of `what-if`, under this heading.
fn cell(table: &str, heading: &str) -> u64 {
    let cells = |line: &str| -> Vec<String> {
        line.trim_matches('│').split('┆').map(|cell| cell.trim().to_owned()).collect()
    };
    let mut lines = table.lines().filter(|line| line.starts_with('│')).map(cells);
    let index = lines.next().unwrap().iter().position(|cell| cell == heading).unwrap();
    lines.next().unwrap()[index].parse().unwrap()
}

#[test]
fn every_decision_of_a_drop_in_is_recorded_with_every_members_value() {
    let (_folder, record, cart) = recorded(SEVERAL, OnAbort::Executes);
    let (rows, counters) = (decisions(&record), *cart.shield.counters());
    let count = |phase: &str, verdict: &str| {
        rows.iter().filter(|row| (row.phase.as_str(), row.verdict.as_str()) == (phase, verdict)).count()
            as u64
    };
    assert_eq!(count("forward", "abort"), counters.early_aborts);
    assert_eq!(count("reset", "replace"), counters.exploration_replaced);
    assert_eq!(count("forward", "allow"), counters.forward_steps, "one decision a step");
    assert!(counters.early_aborts > 0 && counters.exploration_replaced > 0 && counters.reset_episodes > 5);
    for row in rows.iter().filter(|row| row.phase == "forward") {
        assert_eq!(row.observation.len(), cart.shield.spaces().observation_len());
        assert_eq!((row.proposed.len(), row.scores.len()), (1, 3));
        let members = [&row.probabilities, &row.greedy_probabilities, &row.start_probabilities];
        assert!(members.iter().all(|members| members.iter().all(|member| member.is_finite())), "{row:?}");
        assert!(!members[0].is_empty() && row.executed[0].is_nan() == (row.verdict == "abort"), "{row:?}");
    }
    let plugins: serde_json::Value =
        serde_json::from_slice(&fs::read(record.join("plugins.json")).unwrap()).unwrap();
    assert_eq!(plugins["shield.rules[0]"]["id"], "undo-probability");
    assert_eq!(plugins["reset"]["sha256"].as_str().unwrap().len(), 64);
    let config = fs::read_to_string(record.join("config.ron")).unwrap();
    assert!(config.contains("accepted_risk") && config.contains("Box(low:"), "{config}");
    let file = DropInFile::read(record.join("config.ron"), &[]).unwrap();
    assert!(file.open(registry(), None).is_ok(), "it makes the same shield again");
}

#[test]
fn a_replay_of_a_record_rejects_what_the_drop_in_rejected() {
    for rules in [UNDOING, SEVERAL, PROJECTING] {
        for on_abort in [OnAbort::Executes, OnAbort::Waits] {
            let (_folder, record, cart) = recorded(rules, on_abort);
            assert_ne!(cart.rejections(), 0, "{rules}");
            let table = succeed("what-if", &record, &[]);
            let figures =
                ["rejected", "newly allowed", "newly rejected"].map(|heading| cell(&table, heading));
            assert_eq!(figures, [cart.rejections(), 0, 0], "{rules}\n{table}");
        }
    }
}

#[test]
fn another_risk_changes_what_a_drop_in_rejects() {
    let (_folder, record, _) = recorded(SEVERAL, OnAbort::Waits);
    let table = succeed("what-if", &record, &["--risk", "0.01,0.9"]);
    assert!(table.contains("as recorded (0.2)") && table.contains("The rule hears how the"), "{table}");
    let set = succeed("what-if", &record, &["--set", "shield.rules[2].config.max_change=Some([0.01])"]);
    assert!(set.contains("shield.rules[2]") && set.lines().count() > 5, "{set}");
    let unknown = refused("what-if", &record, &["--q-min", "1"]);
    assert!(unknown.contains(r#"no rule "ensemble-threshold""#), "{unknown}");
    // Nobody computed reset values here.
    let rule = r#"shield.rules[0]=(plugin: "ensemble-threshold")"#;
    let lacking = refused("what-if", &record, &["--set", rule]);
    assert!(lacking.contains("reset values that no rule of the run needed"), "{lacking}");
    let calibration = succeed("what-if", &record, &["--calibration"]);
    assert!(
        calibration.contains("undo probability from") && calibration.contains("Brier score"),
        "{calibration}"
    );
    let counterfactual = refused("what-if", &record, &["--counterfactual"]);
    assert!(counterfactual.contains("needs a run of `shield run`"), "{counterfactual}");
}

#[test]
fn a_rejection_of_a_drop_in_is_explained() {
    let (_folder, record, cart) = recorded(UNDOING, OnAbort::Waits);
    let all = decisions(&record);
    let aborted = all.iter().find(|row| row.verdict == "abort" && row.step > 0).unwrap();
    let explained = succeed("explain", &record, &["--step", &aborted.step.to_string()]);
    for part in [
        "undo-probability",
        "abort (rejected)",
        "could be undone with a probability of",
        "  threshold  a probability of",
    ] {
        assert!(explained.contains(part), "{part:?} is missing in: {explained}");
    }
    let counted = succeed("explain", &record, &[]);
    assert!(counted.contains(&format!("{} actions were rejected", cart.rejections())), "{counted}");
    let (_folder, record, _) = recorded(PROJECTING, OnAbort::Waits);
    let explained = succeed("explain", &record, &[]);
    for part in ["linear-constraints", "a program was solved, linearised once", "executed   0."] {
        assert!(explained.contains(part), "{part:?} is missing in: {explained}");
    }
}

#[test]
fn the_record_of_a_shield_that_goes_on_is_replayed_from_the_saved_state() {
    let (folder, _, mut before) = recorded(SEVERAL, OnAbort::Waits);
    let state = folder.path().join("state");
    drop_in_files::save(&mut before.shield, &state).unwrap();
    let again = folder.path().join("again");
    let mut cart = Cart::new(SEVERAL, &again, RecordSettings::default());
    drop_in_files::load(&mut cart.shield, &state).unwrap();
    let steps = cart.shield.counters().steps;
    cart.place(7);
    cart.drive(1_500, OnAbort::Waits);
    let rejections = cart.rejections() - before.rejections();
    // Both are gone: what waited is written.
    drop(cart);
    assert!(rejections > 0 && decisions(&again)[0].step == steps);
    let table = succeed("what-if", &again, &[]);
    let figures = ["rejected", "newly allowed", "newly rejected"].map(|heading| cell(&table, heading));
    assert_eq!(figures, [rejections, 0, 0], "{table}");
    // Without the states of the rules, others are rejected.
    fs::remove_file(again.join("rules.bin")).unwrap();
    let table = succeed("what-if", &again, &[]);
    assert_ne!(cell(&table, "newly allowed") + cell(&table, "newly rejected"), 0, "{table}");
}

#[test]
fn a_state_that_is_loaded_later_ends_the_record() {
    let (folder, record, mut cart) = recorded(UNDOING, OnAbort::Waits);
    let state = folder.path().join("state");
    drop_in_files::save(&mut cart.shield, &state).unwrap();
    let before = decisions(&record).len();
    cart.drive(100, OnAbort::Waits);
    drop_in_files::load(&mut cart.shield, &state).unwrap();
    assert!(cart.record.has_trouble());
    let trouble = cart.record.take_trouble().unwrap();
    assert!(trouble.contains("goes on from another state") && trouble.contains("record"), "{trouble}");
    let written = decisions(&record).len();
    assert!(written > before + 20, "what waited in memory is written: {before}, {written}");
    cart.place(0);
    cart.drive(100, OnAbort::Waits);
    cart.record.flush();
    assert_eq!(decisions(&record).len(), written);
    assert_eq!(cart.record.take_trouble(), None, "it is told once");
}

#[test]
fn a_record_ends_at_its_limit_and_may_leave_decisions_out() {
    let folder = tempfile::tempdir().unwrap();
    let record = folder.path().join("limited");
    let mut cart = Cart::new(UNDOING, &record, RecordSettings { decisions: 1, limit: 100 });
    cart.place(0);
    cart.drive(300, OnAbort::Waits);
    let trouble = cart.record.take_trouble().unwrap();
    assert!(trouble.contains("it has 100 decisions, which is its limit"), "{trouble}");
    assert_eq!(decisions(&record).len(), 100);
    succeed("what-if", &record, &[]);

    let record = folder.path().join("thin");
    let mut cart = Cart::new(UNDOING, &record, RecordSettings { decisions: 10, limit: 10_000 });
    cart.place(0);
    cart.drive(1_000, OnAbort::Waits);
    cart.record.flush();
    let rows = decisions(&record);
    assert!(rows.iter().all(|row| row.verdict == "abort" || row.step.is_multiple_of(10)));
    assert_eq!(rows.iter().filter(|row| row.verdict == "abort").count() as u64, cart.rejections());
    let replayed = succeed("what-if", &record, &[]);
    assert!(replayed.contains("only one in 10 was recorded"), "{replayed}");
}

#[test]
fn only_a_new_or_an_empty_folder_is_recorded_into() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::create_dir_all(at("empty")).unwrap();
    fs::create_dir_all(at("foreign")).unwrap();
    fs::write(at("foreign").join("thesis.txt"), "mine").unwrap();
    fs::write(at("file"), "mine").unwrap();
    drop(Cart::new(UNDOING, &at("empty"), RecordSettings::default()));
    assert!(is_record(&at("empty")));
    let file = DropInFile::read(at("empty").join("config.ron"), &[]).unwrap();
    let mut shield = file.open(registry(), None).unwrap();
    let mut begin = |folder: PathBuf, settings| {
        Record::begin(&mut shield, &file, registry(), &folder, settings)
            .map(drop)
            .map_err(|error| format!("{error:#}"))
    };
    for (name, why) in [
        ("empty", "already holds the record of a shield"),
        ("foreign", "is not empty"),
        ("file", "cannot be used for a record"),
    ] {
        let error = begin(at(name), RecordSettings::default()).unwrap_err();
        assert!(error.contains(why) && error.contains(name), "{error}");
    }
    assert_eq!(fs::read_dir(at("foreign")).unwrap().count(), 1);
    assert!(begin(at("none"), RecordSettings { decisions: 0, limit: 1 }).is_err() && !at("none").exists());
    assert!(begin(at("a/deep/one"), RecordSettings::default()).is_ok());
}

#[test]
fn a_record_that_cannot_be_written_ends_whole_and_the_shield_goes_on() {
    let (_folder, record, mut cart) = recorded(UNDOING, OnAbort::Waits);
    let rows = decisions(&record).len();
    // No more parts can be closed.
    let parts = record.join("decisions");
    fs::rename(&parts, record.join("aside")).unwrap();
    fs::write(&parts, "in the way").unwrap();
    cart.drive(100, OnAbort::Waits);
    cart.record.flush();
    let trouble = cart.record.take_trouble().unwrap();
    assert!(trouble.contains("cannot be written") && trouble.contains("decides as before"), "{trouble}");
    fs::remove_file(&parts).unwrap();
    fs::rename(record.join("aside"), &parts).unwrap();
    cart.drive(100, OnAbort::Waits);
    drop(cart);
    assert_eq!(decisions(&record).len(), rows);
    succeed("explain", &record, &[]);
    succeed("what-if", &record, &[]);
}

#[test]
fn other_commands_say_that_a_record_is_no_run() {
    let (_folder, record, _) = recorded(UNDOING, OnAbort::Waits);
    for name in ["eval", "export", "doctor", "resume", "report"] {
        let said = refused(name, &record, &[]);
        assert!(said.contains("not a run; `shield explain` and `shield what-if` read it"), "{name}: {said}");
    }
}
