//! The program goes on with runs for which it lacks file descriptors, or with which other programs go on too.

use std::process::{Command, Output, Stdio};

use shield_tests::shield;

use super::{
    left_alone::{assert_same, listing, short},
    *,
};

/// Runs of several seeds that crashed, in a folder with `x.ron`.
fn unfinished_runs(seeds: u64) -> TempDir {
    let home = tempfile::tempdir().unwrap();
    fs::write(home.path().join("x.ron"), short()).unwrap();
    let variants = ExperimentFile::read(home.path().join("x.ron")).unwrap().variants(&[], None).unwrap();
    for seed in 0..seeds {
        let run = Run::new(&home.path().join("runs"), variants[0].clone(), seed);
        let stop = AtomicBool::new(false);
        let saboteur = Saboteur::new(Sabotage::Crash(55), &stop);
        run.begin(registry(), None, false).unwrap().run(saboteur, &stop).unwrap_err();
        fs::write(run.folder.path().join("notes.txt"), "mine").unwrap();
    }
    home
}

/// The first of them, uninterrupted.
fn finished_run() -> (TempDir, PathBuf) {
    let home = tempfile::tempdir().unwrap();
    fs::write(home.path().join("x.ron"), short()).unwrap();
    let output = shield().current_dir(home.path()).args(["run", "x.ron", "--seeds", "0"]).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let run = run_of(&home, 0);
    (home, run)
}

fn run_of(home: &TempDir, seed: u64) -> PathBuf {
    home.path().join(format!("runs/small/default/seed-{seed}"))
}

/// `shield resume runs`, with so many file descriptors.
fn resume_with(home: &TempDir, descriptors: u32) -> Output {
    let shield = shield();
    let mut command = Command::new("sh");
    command.current_dir(home.path()).args(["-c", r#"ulimit -n "$0" && exec "$@""#, &descriptors.to_string()]);
    command.arg(shield.get_program()).args(["resume", "runs"]);
    let variables = shield.get_envs().filter_map(|(name, value)| Some((name, value?)));
    command.envs(variables).output().unwrap()
}

#[test]
fn a_run_without_enough_file_descriptors_is_left_alone() {
    let home = unfinished_runs(1);
    let run = run_of(&home, 0);
    let before = listing(&run);
    let mut failures = 0;
    for descriptors in 4..60 {
        let output = resume_with(&home, descriptors);
        let message = String::from_utf8_lossy(&output.stderr);
        if output.status.success() {
            assert!(failures > 5, "{failures} failures");
            assert_eq!(fs::read_to_string(run.join("notes.txt")).unwrap(), "mine");
            return;
        }
        // Once it goes on, it may fail as every run may.
        if !message.contains("goes on after") {
            failures += 1;
            assert_same(&before, &listing(&run), &format!("{descriptors} descriptors: {message}"));
        }
    }
    panic!("it never went on");
}

#[test]
fn twenty_runs_with_few_file_descriptors_keep_their_files_and_go_on_later() {
    let home = unfinished_runs(20);
    let mut failures = 0;
    for descriptors in [8, 10, 12, 14, 18, 22, 26, 30] {
        failures += u32::from(!resume_with(&home, descriptors).status.success());
        for run in (0..20).map(|seed| run_of(&home, seed)) {
            assert_eq!(fs::read_to_string(run.join("notes.txt")).unwrap(), "mine");
            for name in ["config.ron", "plugins.json", "metrics.csv", "checkpoint/latest.bin"] {
                assert!(run.join(name).is_file(), "{descriptors} descriptors: {name} of {}", run.display());
            }
        }
    }
    assert!(failures > 1, "{failures} failures");
    let output = shield().current_dir(home.path()).args(["resume", "runs"]).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let (_calm, calm) = finished_run();
    let run = run_of(&home, 0);
    fs::remove_file(run.join("notes.txt")).unwrap();
    assert!(run_files(&run) == run_files(&calm), "it differs from an uninterrupted run");
}

#[test]
fn four_resumes_at_once_over_damaged_checkpoints_all_fail_and_change_nothing() {
    let home = unfinished_runs(1);
    let run = run_of(&home, 0);
    for file in ["latest.bin", "previous.bin"] {
        damage(&run.join("checkpoint").join(file));
    }
    let before = listing(&run);
    for command in [&["resume", "runs"][..], &["run", "x.ron", "--seeds", "0"]] {
        let children: Vec<_> = (0..4)
            .map(|_| {
                let mut child = shield();
                child.current_dir(home.path()).args(command).stdout(Stdio::piped()).stderr(Stdio::piped());
                child.spawn().unwrap()
            })
            .collect();
        for child in children {
            let output = child.wait_with_output().unwrap();
            let message = String::from_utf8_lossy(&output.stderr);
            assert_eq!(output.status.code(), Some(1), "{message}");
            assert!(
                message.contains("another process") || message.contains("no checkpoint of it can be used"),
                "{message}"
            );
        }
        assert_same(&before, &listing(&run), "four at once");
    }
}
