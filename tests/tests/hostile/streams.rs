//! Standard output and standard error that cannot be written.

use std::{
    fs::{self, File},
    io,
    path::Path,
    process::{Command, ExitStatus, Stdio},
};

use serde_json::Value;
use shield_tests::{gridworld, shield};

use crate::{first_run, limits_ffi::without_stream, ran};

/// How a stream is broken.
#[derive(Debug, Clone, Copy)]
enum Broken {
    /// No byte has room.
    Full,
    /// The reader is gone.
    Unread,
    /// The descriptor is closed.
    Closed,
}

const EVERY: [Broken; 3] = [Broken::Full, Broken::Unread, Broken::Closed];

impl Broken {
    fn stream(self) -> Stdio {
        match self {
            Self::Full => File::create("/dev/full").unwrap().into(),
            Self::Unread => io::pipe().unwrap().1.into(),
            Self::Closed => Stdio::null(),
        }
    }

    fn output(self, command: &mut Command) -> &mut Command {
        command.stdout(self.stream());
        if matches!(self, Self::Closed) { without_stream(command, 1) } else { command }
    }

    fn error(self, command: &mut Command) -> &mut Command {
        command.stderr(self.stream());
        if matches!(self, Self::Closed) { without_stream(command, 2) } else { command }
    }
}

fn shield_in(folder: &Path, arguments: &[&str]) -> Command {
    let mut command = shield();
    command.current_dir(folder).args(arguments);
    command
}

/// Both streams are broken in the same way.
fn mute(folder: &Path, broken: Broken, arguments: &[&str]) -> ExitStatus {
    let mut command = shield_in(folder, arguments);
    broken.output(&mut command);
    broken.error(&mut command).status().unwrap()
}

fn is_complete(folder: &Path) -> bool {
    let summary = fs::read(first_run(folder).join("summary.json"));
    summary.is_ok_and(|text| serde_json::from_slice::<Value>(&text).unwrap()["complete"] == true)
}

#[test]
fn a_run_that_nobody_can_be_told_of_succeeds() {
    for broken in EVERY {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("x.ron"), gridworld(300, "")).unwrap();
        // The third says that the runs are kept.
        for arguments in [&["--seeds", "0"][..], &["--record", "none.json"], &["--seeds", "0"]] {
            let status = mute(folder.path(), broken, &[&["run", "x.ron"], arguments].concat());
            assert_eq!(status.code(), Some(0), "{broken:?} {arguments:?}");
            assert!(is_complete(folder.path()), "{broken:?} {arguments:?}");
        }
    }
}

#[test]
fn a_stopped_run_goes_on_although_nobody_can_be_told() {
    for broken in EVERY {
        let folder = ran(&gridworld(600, "checkpoint: (every: 200),"), &["--seeds", "0"]);
        fs::remove_file(first_run(folder.path()).join("summary.json")).unwrap();
        let status = mute(folder.path(), broken, &["resume", "runs"]);
        assert!(status.success() && is_complete(folder.path()), "{broken:?}");
    }
}

#[test]
fn files_are_written_although_nobody_can_be_told_where() {
    let folder = ran(&gridworld(600, ""), &["--seeds", "0"]);
    for broken in EVERY {
        for (arguments, file) in [
            (&["report", "runs/small", "--record", "kept.json", "--out", "x.html"][..], "x.html"),
            (&["report", "runs/small", "--svg", "svg", "--out", "x.html"], "svg/return.svg"),
            (&["render", "x.ron", "--out", "x.png", "--steps", "3"], "x.png"),
        ] {
            let status = mute(folder.path(), broken, arguments);
            assert!(status.success(), "{broken:?} {arguments:?}");
            assert!(fs::remove_file(folder.path().join(file)).is_ok(), "{broken:?} {arguments:?}");
        }
    }
}

#[test]
fn a_refusal_keeps_its_exit_code_where_nobody_reads_why() {
    let folder = tempfile::tempdir().unwrap();
    for broken in EVERY {
        for (arguments, code) in [
            (&["run", "none.ron"][..], 2),
            (&["report", "none"], 2),
            (&["walk"], 2),
            (&["worker"], 1),
            (&["--help"], 0),
            (&["--version"], 0),
        ] {
            let status = mute(folder.path(), broken, arguments);
            assert_eq!(status.code(), Some(code), "{broken:?} {arguments:?}");
        }
    }
}

#[test]
fn a_result_that_cannot_be_written_is_an_error() {
    let folder = ran(&gridworld(600, ""), &["--seeds", "0"]);
    for arguments in [
        &["eval", "runs", "--episodes", "1", "--json"][..],
        &["eval", "runs", "--episodes", "1"],
        &["explain", "runs/small/default/seed-0"],
        &["what-if", "runs/small/default/seed-0", "--q-min", "0.1"],
        &["plugin", "list"],
        &["plugin", "info", "gridworld"],
        &["env", "bench", "gridworld", "--steps", "10", "--rounds", "1"],
    ] {
        let mut command = shield_in(folder.path(), arguments);
        let output = Broken::Full.output(&mut command).stderr(Stdio::piped()).output().unwrap();
        let message = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{arguments:?}: {message}");
        let expected = "error: the result cannot be written to standard output: No space left on device";
        assert!(message.starts_with(expected), "{arguments:?}: {message}");
        // A broken pipe is ignored.
        let mut command = shield_in(folder.path(), arguments);
        let output = Broken::Unread.output(&mut command).stderr(Stdio::piped()).output().unwrap();
        assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    }
}
