//! `--peers`: our models and speed against Gymnasium's and the DeepMind control suite's, and Gymnasium's environments behind our shield;
//! our learners against torch and Stable-Baselines3.

use std::fs;
use std::path::Path;
use std::process::{Command, ExitCode};

use anyhow::Context;

use crate::{cargo, python, stages, torch};

/// Exports our models and free motions, measures our speed, and lets a Python program compare.
///
/// # Errors
/// Something could not be built, installed or started. A difference is not an error but an exit code.
pub fn test(root: &Path) -> anyhow::Result<ExitCode> {
    let folder = root.join("tests/peers");
    let python = python::environment(root, "peers", &folder.join("requirements.txt"))?;
    let target = cargo::target_folder()?;
    let exported = target.join("peers");
    fs::create_dir_all(&exported).with_context(|| format!("cannot create {}", exported.display()))?;
    // Of the whole workspace, here and below: for one package, Cargo would choose other features and build every dependency once more.
    let test = ["test", "--quiet", "--workspace", "--lib", "peers"];
    stages::run_some(cargo::command(root).args(test).env("SHIELD_PEERS_FOLDER", &exported))?;
    let features = ["--features", "gymnasium/python-tests,shield-tests/python-tests"];
    for selected in [["--lib", "with_gymnasium"], ["--test=command_line", "every_example_in_python"]] {
        let mut test = cargo::command(root);
        test.args(["test", "--quiet", "--workspace"]).args(features).args(selected);
        stages::run_some(test.env("SHIELD_PEERS_PYTHON", &python))?;
    }
    let build = ["build", "--release", "--package", "shield-cli", "--package", "mujoco-robots"];
    cargo::run(cargo::command(root).args(build))?;
    let status = Command::new(&python)
        .arg(folder.join("environments.py"))
        .arg(&exported)
        .arg(target.join("release/shield"))
        .status()
        .with_context(|| format!("{} could not be started", python.display()))?;
    Ok(if status.success() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// Measures our learners and torch in turn.
///
/// # Errors
/// Something could not be built, installed or started.
pub fn bench(root: &Path) -> anyhow::Result<()> {
    let python = torch::python(root, "torch", &root.join("tests/peers/torch.txt"))?;
    // `shield` and what it loads, side by side, for the steps per second.
    cargo::run(
        cargo::command(root)
            .args(["build", "--release", "--package", "shield-cli", "--package", "ddpg"])
            .args(["--package", "td3", "--package", "mujoco-robots"]),
    )?;
    let bench = ["bench", "--package", "shield-tests", "--bench", "peers"];
    cargo::run(cargo::command(root).args(bench).env("SHIELD_PEERS_PYTHON", python))
}
