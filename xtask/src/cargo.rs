//! Cargo, called from within Cargo.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, bail};

/// Names the folder of MuJoCo's library; `.cargo/config.toml` gives it a default.
pub const MUJOCO_FOLDER: &str = "MUJOCO_DYNAMIC_LINK_DIR";

/// The folder with the workspace's `Cargo.toml`.
pub fn workspace_root() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/.."))
}

/// The folder into which Cargo builds: this program lies in `debug` inside it.
pub fn target_folder() -> anyhow::Result<PathBuf> {
    let own = std::env::current_exe().context("the path of this program is unknown")?;
    let target = own.ancestors().nth(2).context("this program does not lie in Cargo's target folder")?;
    Ok(target.to_owned())
}

/// Cargo in the workspace's folder.
pub fn command(root: &Path) -> Command {
    let mut command = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| OsString::from("cargo")));
    command.current_dir(root);
    // Cargo has put its default into our environment. If we passed it on, it would look like a setting of the user's, and
    // what is built here would be built again by the next plain `cargo build`.
    let default = root.join("native/mujoco/lib");
    let given = std::env::var_os(MUJOCO_FOLDER).map(PathBuf::from);
    if given.is_some_and(|given| same_place(&given, &default)) {
        command.env_remove(MUJOCO_FOLDER);
    }
    command
}

fn same_place(one: &Path, other: &Path) -> bool {
    match (one.canonicalize(), other.canonicalize()) {
        (Ok(one), Ok(other)) => one == other,
        _ => one == other,
    }
}

/// Runs a command to its end.
///
/// # Errors
/// It cannot be started or does not succeed.
pub fn run(command: &mut Command) -> anyhow::Result<()> {
    let status = command.status().with_context(|| format!("{command:?} could not be started"))?;
    if !status.success() {
        bail!("{} failed ({status})", describe(command));
    }
    Ok(())
}

/// The command as one would type it.
pub fn describe(command: &Command) -> String {
    let arguments = command.get_args().map(|argument| argument.to_string_lossy());
    std::iter::once("cargo".into()).chain(arguments).collect::<Vec<_>>().join(" ")
}
