//! `shield env` and `shield render` as a user meets them, and that a camera changes nothing.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::{
    fs,
    path::PathBuf,
    process::{Output, Stdio},
    sync::atomic::AtomicBool,
    time::Duration,
};

use shield_runtime::{
    events::Counters,
    experiment::ExperimentFile,
    film::{FilmSettings, Filmer},
    joint_loop::{JointLoop, LoopParts},
    observer::Observer,
    plugin::{Registry, SearchPath},
    report::Picture,
    run::prepare,
};
use shield_tests::{gridworld, plugins_folder, shield, text};

fn run(arguments: &[&str]) -> Output {
    shield().args(arguments).output().unwrap()
}

struct Silent;

impl Observer for Silent {}

fn prepared(steps: u64) -> LoopParts {
    let registry = Registry::scan(&SearchPath::new([plugins_folder()]));
    let file = ExperimentFile::from_text("x.ron", gridworld(steps, ""));
    prepare(&registry, &file.variants(&[], None).unwrap()[0], 0).unwrap()
}

fn finish(parts: LoopParts, observer: &mut dyn Observer) -> Counters {
    let stop = AtomicBool::new(false);
    let mut joint = JointLoop::new(parts, observer, &stop);
    joint.run().unwrap();
    *joint.counters()
}

#[test]
fn filming_shows_every_step_and_changes_nothing() {
    const STEPS: u64 = 600;
    let unfilmed = finish(prepared(STEPS), &mut Silent);

    let parts = prepared(STEPS);
    let spaces = parts.world.spec().spaces.clone();
    let members = parts.agents.reset.as_ref().map_or(0, |agent| agent.info().members);
    let mut pictures: Vec<Picture> = Vec::new();
    let mut sink = |picture: &Picture| {
        pictures.push(picture.clone());
        Ok(())
    };
    let settings =
        FilmSettings { size: Some([60, 60]), from: 0, every: 1, q_min: Some(0.4), largest_value: 1.0 };
    let mut filmer = Filmer::new(spaces, members, settings, &mut sink);
    let filmed = finish(parts, &mut filmer);
    assert_eq!(filmed, unfilmed);
    assert!(filmed.early_aborts > 0, "nothing was aborted, so no mark was drawn");
    assert!(pictures.len() as u64 >= STEPS + filmed.early_aborts, "{} pictures", pictures.len());
    assert!(pictures.iter().any(|picture| *picture != pictures[0]), "every picture is the same");
}

#[test]
fn a_film_is_written_and_repeats_byte_for_byte() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("x.ron"), gridworld(1_000, "")).unwrap();
    let film = |out: &str, arguments: &[&str]| {
        let output = shield()
            .current_dir(folder.path())
            .args(["render", "x.ron", "--steps", "30", "--out", out])
            .args(arguments)
            .output()
            .unwrap();
        assert!(output.status.success(), "{}", text(&output.stderr));
        let names: Vec<_> = fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().path()).collect();
        let is_partial = |name: &PathBuf| name.extension().is_some_and(|extension| extension == "partial");
        assert!(!names.iter().any(is_partial), "{names:?}");
        fs::read(folder.path().join(out)).unwrap()
    };
    let first = film("a.gif", &["--train-steps", "100"]);
    assert!(first.starts_with(b"GIF89a") && first.len() > 3_000, "{} bytes", first.len());
    assert!(first == film("b.gif", &["--train-steps", "100"]), "the same film is another one");
    for policy in ["forward", "reset", "random"] {
        let other = film("c.gif", &["--train-steps", "100", "--policy", policy]);
        assert!(other.starts_with(b"GIF89a") && other != first, "{policy}");
    }
    let small = film("d.png", &["--size", "50x50"]);
    assert!(small.starts_with(b"\x89PNG") && small != film("e.png", &["--size", "90x50"]));
}

#[test]
#[cfg(target_os = "linux")]
fn a_film_that_is_interrupted_leaves_no_file() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("x.ron"), gridworld(1_000, "")).unwrap();
    let files = || fs::read_dir(folder.path()).unwrap().count();
    const FOREVER: &str = "100000000";
    for arguments in
        [&["--train-steps", FOREVER][..], &["--policy", "random", "--steps", FOREVER, "--every", FOREVER]]
    {
        let mut film = shield();
        film.current_dir(folder.path()).args(["render", "x.ron", "--out", "x.gif"]).args(arguments);
        let mut child = film.stderr(Stdio::null()).spawn().unwrap();
        while files() == 1 {
            assert!(child.try_wait().unwrap().is_none(), "it ended by itself");
            std::thread::sleep(Duration::from_millis(10));
        }
        // SAFETY: a signal to our own child.
        unsafe { libc::kill(i32::try_from(child.id()).unwrap(), libc::SIGINT) };
        assert_eq!(child.wait().unwrap().code(), Some(130));
        assert_eq!(files(), 1, "an unfinished film was left");
    }
}

#[test]
fn an_impossible_film_is_refused_with_the_reason() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.ron");
    fs::write(&path, gridworld(1_000, "")).unwrap();
    let path = path.to_str().unwrap();
    for (arguments, expected) in [
        (vec![path, "--out", "x.jpeg"], ".gif, .png or .mp4"),
        (vec![path, "--out", "/nonexistent/x.gif"], "does not exist"),
        (vec![path, "--out", "x.gif", "--size", "9x9"], "480x360"),
        (vec![path, "--out", "x.gif", "--variant", "none"], "none"),
    ] {
        let output = run(&[vec!["render"], arguments].concat());
        assert_eq!(output.status.code(), Some(2), "{}", text(&output.stderr));
        assert!(text(&output.stderr).contains(expected), "{expected}: {}", text(&output.stderr));
    }
}

#[test]
fn environments_are_listed_checked_and_measured() {
    let listed = text(&run(&["env", "list"]).stdout);
    assert!(listed.contains("gridworld") && listed.contains("mujoco/pusher") && !listed.contains("ddpg"));
    let checked = run(&["env", "check", "gridworld", "--config", "(map: \"two-goals\")"]);
    let table = text(&checked.stdout);
    assert!(checked.status.success(), "{table}");
    assert!(table.contains("pass") && table.contains("reset-set") && !table.contains("FAIL"), "{table}");
    assert!(text(&run(&["env", "bench", "gridworld", "--rounds", "1"]).stdout).contains("steps/s"));
    for (arguments, expected) in [
        (["env", "check", "gridwurld"], "gridwurld"),
        (["env", "check", "ddpg"], "ddpg"),
        (["env", "bench", "nothing"], "nothing"),
    ] {
        let output = run(&arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        assert!(text(&output.stderr).contains(expected));
    }
    let refused = run(&["env", "check", "gridworld", "--config", "(mup: 1)"]);
    assert!(refused.status.code() == Some(2) && text(&refused.stderr).contains("mup"));
}
