//! A Python that has torch, to compare with.
//!
//! torch's package is made for graphics cards and would bring several GB of NVIDIA's libraries. What is set up here runs on the processor
//! and needs two small ones of them.

use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};

use crate::python;

/// The peer.
const TORCH: &str = "torch==2.13.0";
/// The NVIDIA libraries that torch calls even without a graphics card.
const BESIDE: [&str; 2] = ["nvidia-cuda-runtime==13.0.96", "nvidia-cuda-cupti==13.0.85"];
const STABLE_BASELINES: &str = "stable-baselines3==2.9.0";
const REMEDY: &str =
    "this needs python3 with venv and pip, a C compiler, and the network (some 800 MB, once)";

/// A Python with torch, Stable-Baselines3 and the packages of the file `requirements`, in `native/python/<name>`.
///
/// # Errors
/// It cannot be set up; with the remedy.
pub fn python(root: &Path, name: &str, requirements: &Path) -> Result<PathBuf> {
    let program = python::environment(root, name, requirements)?;
    let prefix = program.ancestors().nth(2).context("an environment has a folder")?;
    let stamp = prefix.join("torch.txt");
    if stamp.exists() {
        return Ok(program);
    }
    let mut pip = Command::new(&program);
    pip.args([
        "-m",
        "pip",
        "install",
        "--quiet",
        "--disable-pip-version-check",
        "--no-deps",
        STABLE_BASELINES,
    ]);
    run(pip.args(files(&wheels(root)?, "whl")?))?;
    let mut find = Command::new(&program);
    find.args(["-c", "import sysconfig; print(sysconfig.get_path('platlib'))"]);
    let found = find.output().context(REMEDY)?.stdout;
    let library = Path::new(String::from_utf8_lossy(&found).trim()).join("torch/lib");
    run(Command::new(&program).arg(root.join("tests/peers/without_cuda.py")).arg(&library))?;
    fs::write(&stamp, TORCH).with_context(|| format!("cannot write {}", stamp.display()))?;
    Ok(program)
}

/// The folder with the packages, downloaded if need be. pip checks their hashes.
fn wheels(root: &Path) -> Result<PathBuf> {
    let folder = root.join("native/wheels");
    if !folder.exists() {
        let partial = folder.with_extension(format!("{}.partial", std::process::id()));
        let mut pip = Command::new("python3");
        pip.args(["-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps"]);
        run(pip.args(["--only-binary=:all:", "--dest"]).arg(&partial).arg(TORCH).args(BESIDE))?;
        fs::rename(&partial, &folder).with_context(|| format!("cannot create {}", folder.display()))?;
    }
    Ok(folder)
}

fn files(folder: &Path, extension: &str) -> Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).with_context(|| format!("cannot read {}", folder.display()))? {
        let path = entry?.path();
        if path.extension() == Some(OsStr::new(extension)) {
            found.push(path);
        }
    }
    Ok(found)
}

fn run(command: &mut Command) -> Result<()> {
    let status = command.status().with_context(|| format!("cannot start python3: {REMEDY}"))?;
    if !status.success() {
        bail!("torch could not be set up ({status}): {REMEDY}");
    }
    Ok(())
}
