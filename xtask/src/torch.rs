//! torch, from one download of its Python package: libtorch for the torch plugin, and a Python that has torch to compare with.
//!
//! The package is made for graphics cards and would bring several GB of NVIDIA's libraries. What is set up here runs on the processor
//! and needs two small ones of them. A libtorch of the user's own, with CUDA, is used where `LIBTORCH` names it.

use std::env;
use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};

use crate::{cargo, native, python, say::say, stages};

/// What `tch` binds; the two change together.
const TORCH: &str = "torch==2.13.0";
/// The NVIDIA libraries that torch calls even without a graphics card.
const BESIDE: [&str; 2] = ["nvidia-cuda-runtime==13.0.96", "nvidia-cuda-cupti==13.0.85"];
const STABLE_BASELINES: &str = "stable-baselines3==2.9.0";
/// Names the user's own libtorch.
pub const LIBTORCH: &str = "LIBTORCH";
/// What a libtorch is recognised by.
const LIBRARY: &str = "lib/libtorch_cpu.so";
/// The parts of the package that libtorch for the processor consists of.
const KEPT: [&str; 4] = ["include", LIBRARY, "lib/libc10.so", "lib/libgomp.so.1"];
const REMEDY: &str = "this needs python3 with pip and the network (600 MB, once); or install libtorch 2.13 yourself and set LIBTORCH to its folder";

/// The folder of libtorch: the user's own if `LIBTORCH` names one, else `native/torch`, filled from torch's Python package if need be.
///
/// # Errors
/// The user's folder holds no libtorch, or the package cannot be had; with the remedy.
pub fn libtorch(root: &Path) -> Result<PathBuf> {
    if let Some(own) = env::var_os(LIBTORCH).map(PathBuf::from) {
        if !own.join(LIBRARY).exists() {
            bail!("{LIBTORCH} names {}, which holds no {LIBRARY}: {REMEDY}", own.display());
        }
        return Ok(own);
    }
    let folder = root.join("native/torch");
    if !folder.join(LIBRARY).exists() {
        say("bringing libtorch, once");
        arrange(&wheels(root)?, &folder)?;
    }
    Ok(folder)
}

/// Cargo on the torch plugin, which is a workspace of its own, in release mode: libtorch's bindings are compiled once.
fn plugin(root: &Path, chore: &str) -> Result<Command> {
    let mut command = cargo::command(root);
    command.env(LIBTORCH, libtorch(root)?).args([
        chore,
        "--release",
        "--manifest-path",
        "plugins/torch/Cargo.toml",
    ]);
    command.arg("--target-dir").arg(cargo::target_folder()?.join("torch"));
    Ok(command)
}

/// Builds the torch plugin and puts it beside `shield`.
///
/// # Errors
/// libtorch cannot be had, or the plugin does not build.
pub fn build(root: &Path) -> Result<()> {
    cargo::run(&mut plugin(root, "build")?)?;
    let (target, name) = (
        cargo::target_folder()?,
        format!("{}torch_learners{}", env::consts::DLL_PREFIX, env::consts::DLL_SUFFIX),
    );
    let (built, beside) = (target.join("torch/release").join(&name), target.join("release").join(&name));
    fs::copy(&built, &beside)
        .with_context(|| format!("cannot copy {} to {}", built.display(), beside.display()))?;
    Ok(())
}

/// Tests the torch plugin: by itself, and against what `ddpg` and `td3` compute.
///
/// # Errors
/// Something cannot be built or started, or a test fails.
pub fn test(root: &Path) -> Result<()> {
    let folder = cargo::target_folder()?.join("torch-reference");
    fs::create_dir_all(&folder).with_context(|| format!("cannot create {}", folder.display()))?;
    let mut write = cargo::command(root);
    write.args(["test", "--workspace", "--lib", "the_same_seed_learns_the_same_weights"]);
    stages::run_some(write.env("SHIELD_REFERENCE_FOLDER", &folder))?;
    stages::run_some(plugin(root, "test")?.env("SHIELD_REFERENCE_FOLDER", &folder))?;
    let mut lint = plugin(root, "clippy")?;
    cargo::run(lint.args(["--all-targets", "--", "-D", "warnings"]))
}

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
        let scratch = native::scratch_beside(&folder)?;
        let partial = scratch.path().join("wheels");
        let mut pip = Command::new("python3");
        pip.args(["-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps"]);
        run(pip.args(["--only-binary=:all:", "--dest"]).arg(&partial).arg(TORCH).args(BESIDE))?;
        fs::rename(&partial, &folder).with_context(|| format!("cannot create {}", folder.display()))?;
    }
    Ok(folder)
}

/// Fills `folder` in one move, so that an interrupted set-up leaves nothing half done.
fn arrange(wheels: &Path, folder: &Path) -> Result<()> {
    let scratch = native::scratch_beside(folder)?;
    let (package, ready) = (scratch.path().join("package"), scratch.path().join("ready"));
    fs::create_dir_all(ready.join("lib")).with_context(|| format!("cannot create {}", ready.display()))?;
    for wheel in files(wheels, "whl")? {
        run(Command::new("python3").args(["-m", "zipfile", "-e"]).arg(&wheel).arg(&package))?;
    }
    let rename = |from: PathBuf, to: PathBuf| {
        fs::rename(&from, to).with_context(|| format!("the packages hold no {}", from.display()))
    };
    for part in KEPT {
        rename(package.join("torch").join(part), ready.join(part))?;
    }
    for name in ["libcudart.so.13", "libcupti.so.13"] {
        rename(package.join("nvidia/cu13/lib").join(name), ready.join("lib").join(name))?;
    }
    // A linker takes this for the library: whoever links torch then needs nothing of CUDA.
    fs::write(ready.join("lib/libtorch.so"), "INPUT(libtorch_cpu.so)\n")
        .context("cannot write libtorch.so")?;
    fs::rename(&ready, folder).with_context(|| format!("cannot create {}", folder.display()))?;
    scratch.close().context("cannot remove what was unpacked")
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn libtorch_is_arranged_completely_or_not_at_all() {
        let root = env::temp_dir().join(format!("xtask-torch-{}", std::process::id()));
        fs::create_dir_all(root.join("wheels")).unwrap();
        let folder = root.join("torch");
        let script = "import sys, zipfile\n\
                      with zipfile.ZipFile(sys.argv[1], 'w') as wheel:\n    [wheel.writestr(n, 'x') for n in sys.argv[2:]]\n";
        let wheel = |parts: &[&str]| {
            let file = root.join("wheels/torch.whl");
            let made = Command::new("python3").args(["-c", script]).arg(file).args(parts).status().unwrap();
            assert!(made.success());
        };
        let torch = [
            "torch/include/torch.h",
            "torch/lib/libtorch_cpu.so",
            "torch/lib/libc10.so",
            "torch/lib/libgomp.so.1",
        ];
        wheel(&torch);
        assert!(arrange(&root.join("wheels"), &folder).is_err(), "a library of CUDA is missing");
        assert!(!folder.exists());
        let left: Vec<_> = fs::read_dir(&root).unwrap().map(|entry| entry.unwrap().file_name()).collect();
        assert_eq!(left, ["wheels"], "a failed set-up leaves nothing");
        wheel(&[&torch[..], &["nvidia/cu13/lib/libcudart.so.13", "nvidia/cu13/lib/libcupti.so.13"]].concat());
        arrange(&root.join("wheels"), &folder).unwrap();
        assert!(folder.join(LIBRARY).exists() && folder.join("include/torch.h").exists());
        assert!(fs::read_to_string(folder.join("lib/libtorch.so")).unwrap().contains("libtorch_cpu"));
        fs::remove_dir_all(root).unwrap();
    }
}
