//! A run that cannot go on stays as it is, with everything that the user keeps in its folder.

use std::{os::unix::fs::symlink, thread, time::Duration};

use shield_runtime::checkpoint::LockedCheckpoints;

use super::*;

/// What a user may keep in the folder of a run.
const OWN: [&str; 5] =
    ["notes.txt", "config.partial", "pictures/a.png", "decisions/zz-notes.txt", "checkpoint/mine.rows"];

/// A run with checkpoints after 40 and 20 steps and rows beyond them, and with the user's own files.
fn unfinished(sabotage: Sabotage) -> Trial {
    let run = Trial::new(&short(), &[]);
    run.go(sabotage);
    for name in OWN {
        let path = run.path().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, name).unwrap();
    }
    run
}

pub fn short() -> String {
    gridworld(60, "checkpoint: (every: 20), record: (decisions: 1),").replace("every: 500", "every: 30")
}

/// Everything in a folder: for each path the bytes of a file, or where a link leads to.
pub fn listing(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_symlink() {
            found.insert(path.clone(), fs::read_link(&path).unwrap().as_os_str().as_encoded_bytes().to_vec());
        } else if path.is_dir() {
            found.extend(listing(&path));
            found.insert(path, Vec::new());
        } else {
            found.insert(path.clone(), fs::read(&path).unwrap());
        }
    }
    found
}

/// Says which paths differ, not their bytes.
pub fn assert_same(before: &BTreeMap<PathBuf, Vec<u8>>, after: &BTreeMap<PathBuf, Vec<u8>>, why: &str) {
    let missing: Vec<_> = before.iter().filter(|(path, bytes)| after.get(*path) != Some(bytes)).collect();
    let missing: Vec<&PathBuf> = missing.into_iter().map(|(path, _)| path).collect();
    let added: Vec<&PathBuf> = after.keys().filter(|path| !before.contains_key(*path)).collect();
    assert!(missing.is_empty() && added.is_empty(), "{why}: {missing:?} changed, {added:?} came");
}

fn both(run: &Trial, spoil: impl Fn(&Path)) {
    ["latest.bin", "previous.bin"].iter().for_each(|file| spoil(&run.checkpoint(file)));
}

fn cut_in_half(path: &Path) {
    let bytes = fs::read(path).unwrap();
    fs::write(path, &bytes[..bytes.len() / 2]).unwrap();
}

/// Alters the first bytes of every saved Q-table, by which the learner knows its states. The checksum is right.
fn make_the_learner_refuse(path: &Path) {
    let mut bytes = fs::read(path).unwrap();
    let magic = b"shield/tabular-q/";
    let places: Vec<usize> =
        (0..bytes.len() - magic.len()).filter(|at| bytes[*at..].starts_with(magic)).collect();
    assert!(!places.is_empty(), "the checkpoint has no table");
    places.into_iter().for_each(|at| bytes[at] = b'X');
    seal(path, bytes);
}

/// Writes a checkpoint with the checksum of its body.
fn seal(path: &Path, mut bytes: Vec<u8>) {
    let checksum = crc32fast::hash(&bytes[24..]);
    bytes[20..24].copy_from_slice(&checksum.to_le_bytes());
    fs::write(path, bytes).unwrap();
}

fn put_a_folder(path: &Path) {
    fs::remove_file(path).unwrap();
    fs::create_dir(path).unwrap();
}

fn segment(run: &Trial) -> PathBuf {
    run.checkpoint("experience-000000000000.rows")
}

/// What is done to a run, and what the message must say.
type Kind = (&'static str, fn(&Trial), &'static [&'static str]);

const REMEDY: &str = "move the folder aside";

const KINDS: [Kind; 18] = [
    ("damaged", |run| both(run, damage), &["latest.bin is damaged", "previous.bin is damaged", REMEDY]),
    ("cut short", |run| both(run, cut_in_half), &["latest.bin is damaged", "its length is wrong", REMEDY]),
    (
        "texts",
        |run| both(run, |path| fs::write(path, "a text").unwrap()),
        &["latest.bin is not a checkpoint", REMEDY],
    ),
    (
        "refused states",
        |run| both(run, make_the_learner_refuse),
        &["latest.bin is refused: `forward`: tabular-q: not a state", "previous.bin is refused", REMEDY],
    ),
    (
        "another format",
        |run| {
            let mut bytes = fs::read(run.checkpoint("latest.bin")).unwrap();
            bytes[8] = 9;
            fs::write(run.checkpoint("latest.bin"), bytes).unwrap();
        },
        &["latest.bin has checkpoint format 9", "the version of shield that wrote it"],
    ),
    (
        "an unreadable checkpoint",
        |run| put_a_folder(&run.checkpoint("latest.bin")),
        &["latest.bin", "remove the cause"],
    ),
    (
        "a damaged checkpoint before an unreadable one",
        |run| {
            damage(&run.checkpoint("latest.bin"));
            put_a_folder(&run.checkpoint("previous.bin"));
        },
        &["latest.bin is damaged", "previous.bin: ", "remove the cause"],
    ),
    (
        "no checkpoints",
        |run| both(run, |path| fs::remove_file(path).unwrap()),
        &["no checkpoint to go on from", REMEDY],
    ),
    (
        "no folder of checkpoints",
        |run| fs::remove_dir_all(run.checkpoint("")).unwrap(),
        &["no checkpoint to go on from", REMEDY],
    ),
    ("no table", |run| remove(run, "metrics.csv"), &["metrics.csv", "put the file back"]),
    (
        "no events",
        |run| fs::remove_dir_all(run.path().join("tensorboard")).unwrap(),
        &["tensorboard", "put the file back"],
    ),
    (
        "no experience",
        |run| fs::remove_file(segment(run)).unwrap(),
        &["experience-000000000000.rows", "put the file back"],
    ),
    ("damaged experience", |run| damage_start(&segment(run)), &["experience", "is damaged", REMEDY]),
    (
        "a table that cannot be written",
        |run| put_a_folder(&run.path().join("timings.csv")),
        &["timings.csv", "Nothing was changed"],
    ),
    (
        "a linked lock",
        |run| {
            remove(run, "checkpoint/lock");
            symlink(run.path().join("notes.txt"), run.checkpoint("lock")).unwrap();
        },
        &["lock is not a regular file", "remove it"],
    ),
    ("a folder as lock", |run| put_a_folder(&run.checkpoint("lock")), &["lock is not a regular file"]),
    (
        "another plugin",
        |run| both(run, |path| replace(path, b"1.0.0", b"0.0.9")),
        &["was written with", "install the plugin"],
    ),
    (
        "another configuration",
        |run| both(run, |path| replace(path, b"batch: 16", b"batch: 17")),
        &["another configuration", "`experience.batch`"],
    ),
];

fn remove(run: &Trial, file: &str) {
    fs::remove_file(run.path().join(file)).unwrap();
}

fn damage_start(path: &Path) {
    let mut bytes = fs::read(path).unwrap();
    bytes[0] ^= 1;
    fs::write(path, bytes).unwrap();
}

/// Replaces a text of the same length; the checksum is right.
fn replace(path: &Path, old: &[u8], new: &[u8]) {
    let mut bytes = fs::read(path).unwrap();
    let places: Vec<usize> =
        (24..bytes.len() - old.len()).filter(|at| bytes[*at..].starts_with(old)).collect();
    assert!(!places.is_empty(), "{} is not there", String::from_utf8_lossy(old));
    places.into_iter().for_each(|at| bytes[at..at + new.len()].copy_from_slice(new));
    seal(path, bytes);
}

#[test]
fn two_hundred_failed_resumes_of_every_kind_change_nothing() {
    let rounds = 200_usize.div_ceil(KINDS.len());
    for (kind, spoil, parts) in KINDS {
        let run = unfinished(Sabotage::Crash(55));
        spoil(&run);
        let before = listing(run.path());
        for _ in 0..rounds {
            let message = loop {
                let error = run.proceed().err().unwrap_or_else(|| panic!("{kind}: it went on"));
                let message = format!("{error:#}");
                // A process that another test starts holds a copy of the lock until it executes its own program.
                if !message.contains("by another process") {
                    break message;
                }
                thread::sleep(Duration::from_millis(5));
            };
            assert!(parts.iter().all(|part| message.contains(part)), "{kind}: {message}");
        }
        assert_same(&before, &listing(run.path()), kind);
    }
}

#[test]
fn a_run_that_another_process_writes_is_left_alone() {
    let run = unfinished(Sabotage::Crash(55));
    let before = listing(run.path());
    let lock = LockedCheckpoints::of(run.path()).unwrap().unwrap();
    for failed in [run.proceed(), run.begin(true)] {
        let message = format!("{:#}", failed.err().unwrap());
        assert!(message.contains("another process"), "{message}");
    }
    drop(lock);
    assert_same(&before, &listing(run.path()), "a locked run");
}

#[test]
fn a_missing_part_of_the_decisions_stops_a_run_and_is_no_damage() {
    let run = unfinished(Sabotage::Stop(25));
    let decisions = fs::read_dir(run.path().join("decisions")).unwrap();
    let parts = decisions.map(|entry| entry.unwrap().path());
    let last = parts.filter(|path| path.extension().is_some_and(|end| end == "parquet")).max().unwrap();
    fs::remove_file(&last).unwrap();
    let before = listing(run.path());
    let message = format!("{:#}", run.proceed().err().unwrap());
    assert!(message.contains("part-") && message.contains("put the file back"), "{message}");
    assert_same(&before, &listing(run.path()), "a missing part");
}

#[test]
fn a_refused_state_is_passed_over_for_the_one_before_and_kept() {
    let expected = Trial::uninterrupted(&short());
    let run = unfinished(Sabotage::Crash(55));
    make_the_learner_refuse(&run.checkpoint("latest.bin"));
    let refused = fs::read(run.checkpoint("latest.bin")).unwrap();
    let launch = run.proceed().unwrap();
    assert_eq!(launch.steps_before(), 20);
    let warnings = launch.warnings().join("\n");
    for part in ["passed over", "latest.bin is refused: `forward`", "refused-1.bin"] {
        assert!(warnings.contains(part), "{warnings}");
    }
    drop(launch);
    assert_eq!(run.go(Sabotage::None), 20);
    assert_eq!(fs::read(run.checkpoint("refused-1.bin")).unwrap(), refused);
    for name in OWN {
        let path = run.path().join(name);
        assert_eq!(fs::read(&path).unwrap(), name.as_bytes());
        fs::remove_file(path).unwrap();
    }
    same(&expected, &run, "from the checkpoint before");
}

#[test]
fn a_folder_with_something_else_is_no_run_to_begin_in() {
    let run = Trial::new(&short(), &[]);
    fs::create_dir_all(run.path()).unwrap();
    fs::write(run.path().join("notes.txt"), "mine").unwrap();
    let before = listing(run.path());
    assert!(matches!(run.standing(), Ok(Standing::Foreign)));
    assert!(run.begin(false).is_err() && run.proceed().is_err());
    assert_same(&before, &listing(run.path()), "a folder with notes");
    run.begin(true).unwrap();
    assert!(!run.path().join("notes.txt").exists());
}
