//! What 1.x promises: a library that was built with 1.0.0 loads and runs, and its source builds, with every later version.
//!
//! `tests/fixtures/kept/1.0.0` holds the library, its source and how it was built. Nothing there is ever changed: similar libraries lie in
//! users' folders.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::{
    env, fs,
    path::{Path, PathBuf},
    process::Command,
};

use shield_api::{metrics::Metrics, *};
use shield_runtime::plugin::{Registry, Selection, host};
use shield_tests::{run_files, shield, succeed, workspace};

fn kept() -> PathBuf {
    workspace().join("tests/fixtures/kept/1.0.0")
}

fn choice(id: &str, library: &Path) -> Selection {
    Selection::new(id).at(library)
}

/// One-hot, of six.
fn cell(index: usize) -> [f32; 6] {
    std::array::from_fn(|at| if at == index { 1.0 } else { 0.0 })
}

/// Every table and extension of an environment does what the source says.
fn corridor_walks(library: &Path) {
    let corridor =
        Registry::default().environment(&choice("kept/corridor", library), "", &Setup::new(0, 1, host()));
    let mut corridor = corridor.unwrap();
    let spec = corridor.spec();
    assert_eq!(spec.spaces.observation, Space::Discrete { n: 6 });
    assert_eq!(spec.spaces.action, Space::Discrete { n: 2 });
    assert_eq!((spec.episode_length, spec.brings_reset_reward), (20, true));

    let mut observation = [f32::NAN; 6];
    corridor.reset(1, &mut observation).unwrap();
    assert_eq!(observation, cell(1));
    let metrics = Metrics::default();
    let outcome = metrics.collect(|| corridor.step(&[0.0], &mut observation)).unwrap();
    let home = StepOutcome { reset_reward: 1.0, in_reset_set: true, ..StepOutcome::default() };
    assert_eq!((observation, outcome), (cell(0), home));
    let mut figures = Vec::new();
    metrics.drain(&mut |name, mean| figures.push((name.to_owned(), mean)));
    assert_eq!(figures, [("position".to_owned(), 0.0)]);

    assert_eq!(corridor.starts(), ["middle"]);
    corridor.reset_to("middle", 0, &mut observation).unwrap();
    assert!(corridor.step(&[1.0], &mut observation).unwrap().success);
    let mut state = Vec::new();
    corridor.save(&mut state).unwrap();
    for _ in 0..2 {
        let outcome = corridor.step(&[1.0], &mut observation).unwrap();
        assert_eq!((observation, outcome.irreversible, outcome.forward_reward), (cell(5), true, 1.0));
        assert_eq!(corridor.reset_kind(), Ok(1));
        corridor.load(&state).unwrap();
    }
    let kinds: Vec<_> = corridor.reset_kinds().into_iter().map(|kind| (kind.name, kind.cost)).collect();
    assert_eq!(kinds, [("walk".to_owned(), 1.0), ("lift".to_owned(), 5.0)]);
    assert_eq!(corridor.frame_size(), [6, 1]);
    let mut pixels = [9; 18];
    corridor.render(&mut Frame::new(6, 1, &mut pixels).unwrap()).unwrap();
    assert_eq!(pixels.map(|byte| byte / 255), std::array::from_fn(|at| u8::from(at / 3 == 4)));

    let error = corridor.step(&[0.5], &mut observation).unwrap_err();
    assert_eq!(error.kind(), ErrorKind::InvalidArgument);
    assert_eq!(corridor.load(&[1]).unwrap_err().message(), "kept/corridor: a state has 8 bytes");
}

/// And of a rule.
fn floor_judges(library: &Path) {
    struct Collected(Vec<(Vec<f32>, f32)>);
    impl Rows for Collected {
        fn push(&mut self, coefficients: &[f32], bound: f32) -> Result<()> {
            self.0.push((coefficients.to_vec(), bound));
            Ok(())
        }
    }
    let spaces = Spaces { observation: Space::unbounded(1), action: Space::uniform(2, -1.0, 1.0) };
    let setup = Setup::with_spaces(0, 1, host(), spaces);
    let floor = choice("kept/floor", library);
    let mut rule = Registry::default().abort_rule(&floor, "(least: 2.0)", &setup).unwrap();
    assert_eq!(rule.needs(), Needs { values: true, ..Needs::default() });
    let context = |values| RuleContext {
        observation: &[0.0],
        proposed: &[1.0, 0.5],
        values,
        discount: 0.9,
        ..RuleContext::default()
    };
    let mut room = [0; 64];
    let mut reason = Reason::new(&mut room);
    let allowed = rule.evaluate(&context(&[2.0, 3.0]), &mut reason).unwrap();
    assert_eq!((allowed.verdict, allowed.score, reason.len()), (Verdict::Allow, 2.0, 0));
    let rejected = rule.evaluate(&context(&[1.5, 3.0]), &mut reason).unwrap();
    assert_eq!((rejected.verdict, rejected.score), (Verdict::Reject, 1.5));
    let length = reason.len();
    assert_eq!(&room[..length], b"1.5 is below 2");

    let mut rows = Collected(Vec::new());
    rule.linearise(&context(&[1.5]), &[1.0, 2.0], &mut rows).unwrap();
    assert_eq!(rows.0, [(vec![-1.0, -2.0], 1.5 - 2.0 - 2.0)]);

    rule.observe(&ObservedDecision { step: 0, aborted: true, action: &[0.0, 0.0] }).unwrap();
    let mut state = Vec::new();
    rule.save(&mut state).unwrap();
    assert_eq!(state, 1_u64.to_le_bytes());
    rule.load(&state).unwrap();

    let error = Registry::default().abort_rule(&floor, "(lest: 2.0)", &setup).unwrap_err();
    let (message, position) = error.config_fault().unwrap();
    assert!(message.contains("lest") && position.is_some(), "{message}");
}

/// Both at work in the command: shielded, with a checkpoint, the rule rejecting at times.
fn it_runs(library: &Path, folder: &Path) {
    let library = library.display();
    let experiment = format!(
        r#"Experiment(
    name: "kept",
    steps: 1_000,
    seeds: [0],
    environment: (plugin: "kept/corridor", path: "{library}"),
    forward: Learner(plugin: "tabular-q"),
    reset: (plugin: "tabular-q"),
    shield: (rules: [(plugin: "kept/floor", path: "{library}", config: (least: 0.3))], warm_up_steps: 300),
    experience: (batch: 16, updates: Both),
)"#
    );
    fs::write(folder.join("kept.ron"), experiment).unwrap();
    let output = shield().current_dir(folder).args(["run", "kept.ron"]).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let files = run_files(&folder.join("runs/kept/default/seed-0"));
    let interventions = String::from_utf8_lossy(&files["interventions.csv"]).into_owned();
    assert!(interventions.contains("is below 0.3"), "the rule rejected nothing");
}

fn check(library: &Path) {
    corridor_walks(library);
    floor_judges(library);
    let folder = tempfile::tempdir().unwrap();
    it_runs(library, folder.path());
}

#[test]
// The library that is kept is one for Linux on x86-64.
#[cfg(all(target_os = "linux", target_arch = "x86_64"))]
fn a_library_built_with_1_0_0_loads_and_runs() {
    check(&kept().join("libkept.so"));
}

/// As somebody without our repository builds it: the packaged shield-api alone, a workspace and a lock file of their own. Only the folder of
/// compiled dependencies is shared with the other fixtures, for the sake of time.
#[test]
fn source_written_for_1_0_0_builds_with_the_packaged_interface_alone() {
    let folder = tempfile::tempdir().unwrap();
    let package = folder.path().join("package");
    let cargo = || Command::new(env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    succeed(
        cargo()
            .current_dir(workspace())
            .args(["package", "--quiet", "--package", "shield-api", "--no-verify", "--allow-dirty"])
            .arg("--target-dir")
            .arg(&package),
    );
    let name = format!("shield-api-{}", env!("CARGO_PKG_VERSION"));
    let archive = package.join("package").join(format!("{name}.crate"));
    succeed(Command::new("tar").arg("-xzf").arg(archive).arg("-C").arg(folder.path()));
    fs::rename(folder.path().join(name), folder.path().join("shield-api")).unwrap();

    let source = folder.path().join("source");
    fs::create_dir_all(source.join("src")).unwrap();
    for file in ["Cargo.toml", "Cargo.lock", "src/lib.rs"] {
        fs::copy(kept().join("source").join(file), source.join(file)).unwrap();
    }
    let target = Path::new(env!("CARGO_TARGET_TMPDIR")).with_file_name("fixtures");
    succeed(cargo().current_dir(&source).args(["build", "--quiet"]).env("CARGO_TARGET_DIR", &target));
    let library = format!("{}kept{}", env::consts::DLL_PREFIX, env::consts::DLL_SUFFIX);
    check(&target.join("debug").join(library));
}
