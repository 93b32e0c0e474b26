//! Every experiment in `examples` starts.

use std::fs;

use shield_tests::{shield, text, workspace};

/// Starts the examples in Python, or those that are not, with further arguments. Paths in them count from the workspace.
fn start_examples(in_python: bool, arguments: &[&str]) {
    for entry in fs::read_dir(workspace().join("examples")).unwrap() {
        let path = entry.unwrap().path();
        let is_example = path.extension().is_some_and(|extension| extension == "ron");
        if !is_example || fs::read_to_string(&path).unwrap().contains("\"gymnasium\"") != in_python {
            continue;
        }
        let folder = tempfile::tempdir().unwrap();
        let mut command = shield();
        command
            .current_dir(workspace())
            .arg("run")
            .arg(&path)
            .args(arguments)
            .args(["--steps", "60", "--out"]);
        let output = command.arg(folder.path()).output().unwrap();
        assert!(output.status.success(), "{}: {}", path.display(), text(&output.stderr));
    }
}

#[test]
fn every_example_starts() {
    start_examples(false, &["--set", "evaluation.episodes=1"]);
}

#[cfg(feature = "python-tests")]
#[test]
fn every_example_in_python_starts() {
    let python =
        std::env::var("SHIELD_PEERS_PYTHON").expect("`cargo xtask test --peers` names the interpreter");
    start_examples(true, &["--set", &format!("environment.config.python={python:?}")]);
}
