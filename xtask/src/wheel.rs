//! `--python`: the wheel of the Python package as a user installs it, and its tests.

use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

use anyhow::{Context, bail};

use crate::{cargo, stages, torch};

/// Builds the wheel quickly, not to run quickly: what the tests want is that it works. It shares its dependencies with the other tests.
const PROFILE: &str = "build-args=--profile dev";

/// A Python with the package as it is now, torch, Stable-Baselines3 and Gymnasium. `settings` are arguments for pip.
///
/// # Errors
/// Something could not be built or installed.
pub fn install(root: &Path, settings: &[&str]) -> anyhow::Result<PathBuf> {
    let python = torch::python(root, "drop-in", &root.join("tests/python/requirements.txt"))?;
    let mut pip = Command::new(&python);
    pip.args([
        "-m",
        "pip",
        "install",
        "--quiet",
        "--disable-pip-version-check",
        "--no-deps",
        "--force-reinstall",
    ]);
    let installed = pip.args(settings).arg(root.join("shield-python")).status();
    if !installed.with_context(|| format!("{} could not be started", python.display()))?.success() {
        bail!("the Python package could not be built and installed");
    }
    Ok(python)
}

/// Builds and installs the wheel, runs its tests, prints what a step costs, and compares exported policies with what they do here.
///
/// # Errors
/// Something could not be built, installed or started. A failed test is not an error but an exit code.
pub fn test(root: &Path) -> anyhow::Result<ExitCode> {
    let folder = root.join("tests/python");
    let python = install(root, &["--config-settings", PROFILE])?;
    for arguments in [&["-m", "pytest", "--quiet", "-p", "no:cacheprovider"][..], &["overhead.py"]] {
        // An environment variable of the user's must not lead the package to other plugins than its own.
        let mut program = Command::new(&python);
        program.current_dir(&folder).args(arguments).env_remove("SHIELD_PLUGIN_PATH");
        program.env("XDG_DATA_HOME", "/nonexistent").env("PYTHONDONTWRITEBYTECODE", "1");
        let status =
            program.status().with_context(|| format!("{} could not be started", python.display()))?;
        if !status.success() {
            return Ok(ExitCode::FAILURE);
        }
    }
    // Of the whole workspace, as everywhere: for one package, Cargo would choose other features and build every dependency once more.
    let features = ["--features", "onnx/python-tests"];
    let mut exported = cargo::command(root);
    exported.args(["test", "--quiet", "--workspace"]).args(features).args(["--lib", "stable_baselines"]);
    stages::run_some(exported.env("SHIELD_SB3_PYTHON", &python))?;
    Ok(ExitCode::SUCCESS)
}
