//! What lies in the archive, and where.

use std::collections::BTreeSet;
use std::env;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};
use cargo_metadata::Metadata;

use super::{LEFT_OUT, licences, output, tools};
use crate::{cargo, native};

/// The library for programs in C. It lies beside `plugins`, where it looks for them.
const RUNTIME: &str = "libshield_runtime.so";
/// What can be tried without the source; the programs in Rust build against the runtime, which is not packed.
const EXAMPLES: [&str; 16] = [
    "quickstart.ron",
    "gridworld.ron",
    "projection.ron",
    "onnx-cart.ron",
    "controller-cart.ron",
    "gymnasium-pendulum.ron",
    "policies/cart.onnx",
    "policies/home.onnx",
    "c/cart.c",
    "c/cart.ron",
    "c/controller.c",
    "c/controller.ron",
    "plugins/README.md",
    "plugins/tank.ron",
    "plugins/tank-c/tank.c",
    "plugins/rate-limit-cpp/rate_limit.cpp",
];

/// From what the folder is made.
pub struct Contents<'a> {
    pub root: &'a Path,
    /// The folder of MuJoCo's library.
    pub mujoco: &'a Path,
    pub metadata: &'a Metadata,
    /// The program and the libraries.
    pub built: &'a [PathBuf],
}

impl Contents<'_> {
    /// Fills the folder, and returns the oldest glibc that what lies in it runs with.
    pub fn fill(&self, folder: &Path) -> Result<String> {
        for file in self.built {
            let name = file.file_name().and_then(|name| name.to_str()).context("a library has a name")?;
            let is_beside = [RUNTIME, "shield"].contains(&name);
            let to = if is_beside { folder.join(name) } else { folder.join("plugins").join(name) };
            copy(file, &to)?;
            // Debug information is most of what was built, and names the folder in which that happened.
            output(Command::new("strip").arg("--strip-debug").arg(&to))?;
        }
        let mujoco = native::mujoco_file();
        copy(&self.mujoco.join(&mujoco), &folder.join("plugins").join(&mujoco))?;
        self.interface(folder)?;
        for name in EXAMPLES {
            copy(&self.root.join("examples").join(name), &folder.join("examples").join(name))?;
        }
        for experiment in files_below(&self.root.join("examples/paper"))? {
            if experiment.extension().is_some_and(|extension| extension == "ron") {
                let name = experiment.strip_prefix(self.root)?;
                copy(&experiment, &folder.join(name))?;
            }
        }
        self.licences(folder)?;
        let glibc = needed(folder)?;
        let read_me = include_str!("README.md")
            .replace("{glibc}", &glibc)
            .replace("{architecture}", env::consts::ARCH)
            .replace("{version}", env!("CARGO_PKG_VERSION"));
        write(&folder.join("README.md"), &read_me)?;
        Ok(glibc)
    }

    /// The headers, and `shield-api` as it is packaged, where `shield plugin new` finds it.
    fn interface(&self, folder: &Path) -> Result<()> {
        let mut package = cargo::command(self.root);
        package.args(["package", "--quiet", "--package", "shield-api", "--no-verify", "--allow-dirty"]);
        cargo::run(&mut package)?;
        let name = format!("shield-api-{}", env!("CARGO_PKG_VERSION"));
        let package = cargo::target_folder()?.join(format!("package/{name}.crate"));
        output(Command::new("tar").arg("-xzf").arg(package).arg("-C").arg(folder))?;
        let api = folder.join("shield-api");
        fs::rename(folder.join(name), &api).context("the package of shield-api has another name")?;
        for header in [api.join("include/shield_plugin.h"), self.root.join("shield-c/include/shield.h")] {
            let name = header.file_name().context("a header has a name")?;
            copy(&header, &folder.join("include").join(name))?;
        }
        Ok(())
    }

    fn licences(&self, folder: &Path) -> Result<()> {
        for name in ["LICENSE-APACHE", "LICENSE-MIT"] {
            copy(&self.root.join(name), &folder.join(name))?;
        }
        for file in native::mujoco_licences(self.root, self.mujoco)? {
            let name = file.file_name().context("a file has a name")?;
            copy(&file, &folder.join("licences/mujoco").join(name))?;
        }
        let text = licences::of_dependencies(self.metadata, &LEFT_OUT)?;
        write(&folder.join("licences/crates.txt"), &text)
    }
}

/// Every file below a folder, sorted by its path.
pub fn files_below(folder: &Path) -> Result<BTreeSet<PathBuf>> {
    let mut files = BTreeSet::new();
    for entry in fs::read_dir(folder).with_context(|| format!("cannot read {}", folder.display()))? {
        let path = entry.with_context(|| format!("cannot read {}", folder.display()))?.path();
        if path.is_dir() {
            files.append(&mut files_below(&path)?);
        } else {
            files.insert(path);
        }
    }
    Ok(files)
}

/// Checks that the libraries look for others only beside themselves, and returns the oldest glibc that all of them run with.
fn needed(folder: &Path) -> Result<String> {
    let mut newest = (0, 0);
    for file in files_below(folder)? {
        let is_library = file.extension().is_some_and(|extension| extension == "so");
        if !is_library && !file.ends_with("shield") && !file.ends_with(native::mujoco_file()) {
            continue;
        }
        if let Some(path) = tools::run_paths(&file)?.into_iter().find(|path| path != "$ORIGIN") {
            bail!("{} would look for libraries in {path}, which is only on this machine", file.display());
        }
        newest = newest.max(tools::glibc(&file)?);
    }
    Ok(format!("{}.{}", newest.0, newest.1))
}

fn copy(from: &Path, to: &Path) -> Result<()> {
    create_parent(to)?;
    fs::copy(from, to).with_context(|| format!("cannot copy {} to {}", from.display(), to.display()))?;
    Ok(())
}

fn write(path: &Path, text: &str) -> Result<()> {
    create_parent(path)?;
    fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))
}

fn create_parent(path: &Path) -> Result<()> {
    let parent = path.parent().context("a file lies in a folder")?;
    fs::create_dir_all(parent).with_context(|| format!("cannot create {}", parent.display()))
}
