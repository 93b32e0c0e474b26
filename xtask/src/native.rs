//! Native libraries.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, bail};

/// What `mujoco-rs` 7.0.0 binds.
const VERSION: &str = "3.17.0";

/// The folder with MuJoCo's library; it is downloaded if it is missing.
///
/// # Errors
/// There is no Python with pip, no network, or no wheel for this machine.
pub fn mujoco(workspace_root: &Path) -> anyhow::Result<PathBuf> {
    let folder = std::env::var_os("MUJOCO_DYNAMIC_LINK_DIR").map(PathBuf::from);
    let folder = folder.unwrap_or_else(|| workspace_root.join("native/mujoco/lib"));
    if folder.join("libmujoco.so").exists() {
        return Ok(folder);
    }
    let native = workspace_root.join("native");
    let download = native.join("download.partial");
    std::fs::create_dir_all(&download)?;
    python(
        &download,
        &[
            "-m",
            "pip",
            "download",
            "--no-deps",
            "--only-binary",
            ":all:",
            "--dest",
            ".",
            &format!("mujoco=={VERSION}"),
        ],
    )?;
    let wheel = std::fs::read_dir(&download)?
        .filter_map(|entry| entry.ok().map(|entry| entry.path()))
        .find(|path| path.extension().is_some_and(|extension| extension == "whl"))
        .context("pip downloaded no wheel")?;
    let wheel = wheel.to_str().context("the wheel's path is not UTF-8")?;
    python(&download, &["-m", "zipfile", "--extract", wheel, "."])?;
    let lib = native.join("mujoco/lib");
    std::fs::create_dir_all(&lib)?;
    let library = format!("libmujoco.so.{VERSION}");
    std::fs::rename(download.join("mujoco").join(&library), lib.join(&library))?;
    #[cfg(unix)]
    std::os::unix::fs::symlink(&library, lib.join("libmujoco.so"))?;
    std::fs::remove_dir_all(&download)?;
    Ok(lib)
}

fn python(folder: &Path, arguments: &[&str]) -> anyhow::Result<()> {
    // What pip prints must not mix with the output of the program that is run next.
    let output = std::io::stderr();
    let status = Command::new("python3").args(arguments).current_dir(folder).stdout(output).status();
    let status = status.context("python3 could not be started")?;
    if !status.success() {
        bail!("python3 {} failed ({status})", arguments.join(" "));
    }
    Ok(())
}
