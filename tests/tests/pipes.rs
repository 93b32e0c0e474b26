//! A named pipe in the place of a file that the program reads: opening one can wait for ever.
#![cfg(unix)]
#![allow(clippy::unwrap_used, reason = "tests")]

use std::{
    fs,
    path::Path,
    process::{Command, Output, Stdio},
    sync::mpsc::channel,
    thread,
    time::Duration,
};

use shield_tests::{cart, gridworld, named_pipe, plugins_folder, shield, text};

/// Far longer than any command here takes.
const PATIENCE: Duration = Duration::from_secs(120);

/// What `shield` says in `folder`; panics if it does not end.
fn ends(command: &mut Command, folder: &Path) -> Output {
    let command =
        command.current_dir(folder).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    let child = command.spawn().unwrap();
    let process = child.id();
    let (sender, output) = channel();
    thread::spawn(move || sender.send(child.wait_with_output().unwrap()));
    output.recv_timeout(PATIENCE).unwrap_or_else(|_| {
        assert!(Command::new("kill").args(["-KILL", &process.to_string()]).status().unwrap().success());
        panic!("it waits for the pipe: {command:?}");
    })
}

/// The command is refused for the pipe, which it names.
fn refused(folder: &Path, arguments: &[&str], pipe: &str) {
    let output = ends(shield().args(arguments), folder);
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{arguments:?}: {message}");
    for part in [pipe, "it is a named pipe; name a regular file"] {
        assert!(message.contains(part), "{arguments:?}: {part:?} is missing in: {message}");
    }
}

#[test]
fn an_experiment_a_record_a_plugin_or_a_network_that_is_a_named_pipe_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    named_pipe(&at("pipe.ron"));
    refused(folder.path(), &["run", "pipe.ron"], "pipe.ron");

    named_pipe(&at("record.json"));
    refused(folder.path(), &["report", "runs", "--record", "record.json"], "record.json");

    named_pipe(&at("libpipe.so"));
    let experiment = gridworld(100, "").replace("\"gridworld\"", "\"gridworld\", path: \"libpipe.so\"");
    fs::write(at("plugin.ron"), experiment).unwrap();
    refused(folder.path(), &["run", "plugin.ron"], "libpipe.so");

    named_pipe(&at("policy.onnx"));
    let experiment = cart(100, "");
    let forward = experiment.lines().find(|line| line.contains("forward:")).unwrap();
    let network = "forward: Policy(plugin: \"onnx\", config: (path: \"policy.onnx\")),";
    fs::write(at("network.ron"), experiment.replace(forward, network)).unwrap();
    refused(folder.path(), &["run", "network.ron"], "policy.onnx");
}

#[test]
fn a_named_pipe_among_the_plugins_is_listed_with_its_reason() {
    let folder = tempfile::tempdir().unwrap();
    named_pipe(&folder.path().join("libpipe.so"));
    let path = std::env::join_paths([folder.path(), &plugins_folder()]).unwrap();
    let output = ends(shield().env("SHIELD_PLUGIN_PATH", path).args(["plugin", "list"]), folder.path());
    let listed = text(&output.stdout) + &text(&output.stderr);
    assert!(output.status.success() && listed.contains("named pipe"), "{listed}");
}

#[test]
fn a_checkpoint_that_is_a_named_pipe_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let run = "runs/small/default/seed-0";
    fs::write(folder.path().join("x.ron"), gridworld(300, "")).unwrap();
    let output = ends(shield().args(["run", "x.ron", "--seeds", "0"]), folder.path());
    assert!(output.status.success(), "{}", text(&output.stderr));
    let checkpoint = folder.path().join(run).join("checkpoint/latest.bin");
    fs::remove_file(&checkpoint).unwrap();
    named_pipe(&checkpoint);
    refused(folder.path(), &["eval", run], "latest.bin");
}
