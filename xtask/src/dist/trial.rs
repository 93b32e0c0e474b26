//! The archive, tried as somebody would who has nothing but it: unpacked elsewhere, with an empty environment and another home.

use std::collections::BTreeSet;
use std::env;
use std::ffi::OsStr;
use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, ensure};
use serde_json::Value;

use super::{contents, output};
use crate::cargo;

/// Unpacks the archive, whose folder is `name`, and uses it as its README says.
///
/// # Errors
/// Something does not work; with what it prints.
pub fn try_elsewhere(root: &Path, archive: &Path, name: &str, optimised: bool) -> Result<()> {
    let elsewhere =
        tempfile::Builder::new().prefix("shield dist ").tempdir().context("no folder to try it in")?;
    let home = elsewhere.path().join("home");
    fs::create_dir(&home).with_context(|| format!("cannot create {}", home.display()))?;
    output(Command::new("tar").arg("-xzf").arg(archive).arg("-C").arg(elsewhere.path()))?;
    let unpacked = Unpacked { folder: elsewhere.path().join(name), home };
    symlink(unpacked.folder.join("shield"), unpacked.home.join("shield"))
        .context("the program cannot be linked")?;
    unpacked.every_plugin_is_found().context("`shield plugin list`")?;
    unpacked.quickstart_runs().context("the quickstart")?;
    unpacked.plugins_pass().context("`shield plugin check`")?;
    unpacked.a_program_in_c_is_shielded().context("examples/c/cart.c")?;
    unpacked.a_plugin_in_c_is_made().context("a new plugin in C")?;
    unpacked.a_plugin_in_rust_is_made(root, optimised).context("a new plugin in Rust")
}

struct Unpacked {
    folder: PathBuf,
    /// Empty but for a link to the program, as one would put it on the PATH.
    home: PathBuf,
}

impl Unpacked {
    /// A program, in the home folder, that knows nothing of this environment.
    fn alone(&self, program: impl AsRef<OsStr>) -> Command {
        let mut command = Command::new(program);
        command.env_clear().env("HOME", &self.home).current_dir(&self.home);
        command
    }

    fn shield(&self, arguments: &[&str]) -> Command {
        let mut command = self.alone(self.home.join("shield"));
        command.args(arguments);
        command
    }

    fn every_plugin_is_found(&self) -> Result<()> {
        let listed = output(&mut self.shield(&["plugin", "list"]))?;
        ensure!(!listed.contains("warning") && !listed.contains("Passed over"), "{listed}");
        let words: BTreeSet<&str> = listed.split_whitespace().collect();
        for file in contents::files_below(&self.folder.join("plugins"))? {
            let is_plugin = file.extension().is_some_and(|extension| extension == "so");
            let name = file.file_name().and_then(OsStr::to_str).unwrap_or_default();
            ensure!(!is_plugin || words.contains(name), "{name} is missing in\n{listed}");
        }
        Ok(())
    }

    fn quickstart_runs(&self) -> Result<()> {
        const FEW: [&str; 6] = ["--steps", "300", "--seeds", "0", "--variants", "shielded"];
        let experiment = self.folder.join("examples/quickstart.ron");
        output(self.shield(&["run"]).arg(experiment).args(FEW))?;
        let summary = self.home.join("runs/quickstart/shielded/seed-0/summary.json");
        let summary = fs::read(&summary).with_context(|| format!("there is no {}", summary.display()))?;
        let summary: Value = serde_json::from_slice(&summary).context("its summary is not JSON")?;
        ensure!(summary["steps"] == 300, "it says: {summary}");
        Ok(())
    }

    /// One that stands alone, and one that needs MuJoCo beside it.
    fn plugins_pass(&self) -> Result<()> {
        output(&mut self.shield(&["plugin", "check", "ensemble-threshold"]))?;
        output(&mut self.shield(&["plugin", "check", "mujoco/cliff-cart"]))?;
        Ok(())
    }

    fn a_program_in_c_is_shielded(&self) -> Result<()> {
        let program = self.home.join("cart");
        let mut cc = Command::new(env::var_os("CC").unwrap_or_else(|| "cc".into()));
        cc.args(["-Wall", "-Wextra", "-Werror"]).arg(self.folder.join("examples/c/cart.c"));
        cc.arg("-I").arg(self.folder.join("include")).arg("-L").arg(&self.folder).arg("-lshield_runtime");
        output(cc.arg(format!("-Wl,-rpath,{}", self.folder.display())).arg("-o").arg(&program))?;
        let said = output(self.alone(&program).arg(self.folder.join("examples/c/cart.ron")))?;
        ensure!(said.contains(" aborts, ") && !said.starts_with("0 aborts"), "it says: {said}");
        Ok(())
    }

    fn a_plugin_in_c_is_made(&self) -> Result<()> {
        output(&mut self.shield(&["plugin", "new", "acme/tank", "--kind", "environment", "--lang", "c"]))?;
        output(Command::new("make").current_dir(self.home.join("tank")))?;
        self.passes_and_runs("tank", "libtank.so")
    }

    /// Built optimised if the host is not and the other way round: what the two agree on must not depend on it.
    fn a_plugin_in_rust_is_made(&self, root: &Path, optimised: bool) -> Result<()> {
        output(&mut self.shield(&["plugin", "new", "acme/careful", "--kind", "abort-rule"]))?;
        let folder = self.home.join("careful");
        // Where the tests build such plugins, so that what they depend on is compiled once; offline, so that Cargo takes the same versions.
        let target = cargo::target_folder()?.join("fixtures");
        let mut build = cargo::command(root);
        build.current_dir(&folder).args(["build", "--quiet"]).args((!optimised).then_some("--release"));
        build.env("CARGO_TARGET_DIR", &target).env("CARGO_PROFILE_DEV_DEBUG", "false");
        output(build.env("CARGO_NET_OFFLINE", "true"))?;
        let built = target.join(if optimised { "debug" } else { "release" }).join("libcareful.so");
        // Where its experiment looks for it.
        let library = folder.join("target/release/libcareful.so");
        let parent = library.parent().context("a library lies in a folder")?;
        fs::create_dir_all(parent).with_context(|| format!("cannot create {}", parent.display()))?;
        fs::copy(&built, &library).with_context(|| format!("cannot copy {}", built.display()))?;
        self.passes_and_runs("careful", "target/release/libcareful.so")
    }

    fn passes_and_runs(&self, name: &str, library: &str) -> Result<()> {
        let folder = self.home.join(name);
        let check = ["plugin", "check", library];
        output(self.shield(&check).current_dir(&folder))?;
        let run = ["run", "experiment.ron", "--steps", "300"];
        output(self.shield(&run).current_dir(&folder))?;
        let plugins = folder.join(format!("runs/{name}/default/seed-0/plugins.json"));
        let plugins =
            fs::read_to_string(&plugins).with_context(|| format!("there is no {}", plugins.display()))?;
        ensure!(plugins.contains(&format!("acme/{name}")), "the run used other plugins: {plugins}");
        Ok(())
    }
}
