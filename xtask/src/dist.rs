//! `dist`: an archive that runs from any folder of a machine without Rust or the source.

mod contents;
mod licences;
mod tools;
mod trial;

use std::env;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, Result, ensure};
use cargo_metadata::{Message, Metadata, MetadataCommand, TargetKind};
use flate2::{Compression, write::GzEncoder};

use crate::cargo;
use crate::say::say;

/// What `shield` does not load, and so is no part of the archive.
pub const LEFT_OUT: [&str; 3] = ["xtask", "shield-tests", "shield-python"];

/// Builds everything, packs it, and tries the archive from another folder. Returns the archive, which lies in `target/dist`; the same
/// source makes the same archive.
///
/// `mujoco` is the folder of MuJoCo's library.
///
/// # Errors
/// Something cannot be built or written, or does not run where it was unpacked.
pub fn make(root: &Path, mujoco: &Path, optimised: bool) -> Result<PathBuf> {
    ensure!(env::consts::OS == "linux", "the archive is made on Linux only");
    let metadata = metadata(root)?;
    let built = build(root, &metadata, optimised)?;
    let profile = if optimised { "" } else { "-debug" };
    let version = env!("CARGO_PKG_VERSION");
    let name = format!("shield-{version}-{}-{}{profile}", env::consts::ARCH, env::consts::OS);
    let dist = cargo::target_folder()?.join("dist");
    fs::create_dir_all(&dist).with_context(|| format!("cannot create {}", dist.display()))?;

    let staging = tempfile::tempdir_in(&dist).context("cannot create a folder in target/dist")?;
    let (folder, packed) = (staging.path().join(&name), staging.path().join("packed.tar.gz"));
    let contents = contents::Contents { root, mujoco, metadata: &metadata, built: &built };
    let glibc = contents.fill(&folder)?;
    pack(&folder, &name, &packed).with_context(|| format!("{} could not be written", packed.display()))?;
    let size = fs::metadata(&packed).map_or(0, |data| data.len()) / 1_000_000;
    say(format_args!("packed {name} ({size} MB, for glibc {glibc} or newer); trying it from another folder"));
    trial::try_elsewhere(root, &packed, &name, optimised)
        .with_context(|| format!("{name} does not work elsewhere"))?;
    // Only what works is left behind.
    let archive = dist.join(format!("{name}.tar.gz"));
    fs::rename(&packed, &archive).with_context(|| format!("cannot create {}", archive.display()))?;
    Ok(archive)
}

fn metadata(root: &Path) -> Result<Metadata> {
    let platform = format!("{}-unknown-linux-gnu", env::consts::ARCH);
    let mut command = MetadataCommand::new();
    command.current_dir(root).other_options(["--filter-platform".into(), platform]);
    command.exec().context("the workspace's dependencies could not be read")
}

/// Builds the program and every library; returns the files. They are taken from what Cargo says, since older ones may lie beside them.
fn build(root: &Path, metadata: &Metadata, optimised: bool) -> Result<Vec<PathBuf>> {
    let mut command = cargo::command(root);
    command.args(["build", "--workspace", "--message-format", "json-render-diagnostics"]);
    if optimised {
        command.arg("--release").args(LEFT_OUT.map(|name| ["--exclude", name]).as_flattened());
    } // Else all of it, as the tests build it: Cargo would choose other features for a part.
    let output = command.stderr(Stdio::inherit()).output().context("cargo could not be started")?;
    ensure!(output.status.success(), "{} failed", cargo::describe(&command));
    let ours = metadata.workspace_packages();
    let is_packed = |id| ours.iter().any(|ours| ours.id == id && !LEFT_OUT.contains(&ours.name.as_str()));
    let mut files = Vec::new();
    for message in Message::parse_stream(&output.stdout[..]) {
        if let Message::CompilerArtifact(built) = message.context("cargo says what is not understood")?
            && is_packed(built.package_id)
            && built.target.kind.iter().any(|kind| matches!(kind, TargetKind::CDyLib | TargetKind::Bin))
        {
            files.extend(built.filenames.into_iter().map(PathBuf::from));
        }
    }
    Ok(files)
}

/// Packs `folder` as `name`: sorted, and with neither times nor owners, so that the same content is the same archive.
fn pack(folder: &Path, name: &str, archive: &Path) -> Result<()> {
    let mut builder = tar::Builder::new(GzEncoder::new(File::create(archive)?, Compression::best()));
    builder.mode(tar::HeaderMode::Deterministic);
    for file in contents::files_below(folder)? {
        builder.append_path_with_name(&file, Path::new(name).join(file.strip_prefix(folder)?))?;
    }
    builder.into_inner()?.finish()?;
    Ok(())
}

/// Runs a command to its end and returns what it prints.
fn output(command: &mut Command) -> Result<String> {
    let output = command.output().with_context(|| format!("{command:?} could not be started"))?;
    let printed = String::from_utf8_lossy(&output.stdout);
    let complaint = String::from_utf8_lossy(&output.stderr);
    ensure!(output.status.success(), "{command:?} failed ({})\n{printed}{complaint}", output.status);
    Ok(printed.into_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_same_content_gives_the_same_archive_and_stays_executable() {
        use std::os::unix::fs::PermissionsExt as _;
        let root = tempfile::tempdir().unwrap();
        let archives = ["one", "two"].map(|name| {
            let folder = root.path().join(name);
            fs::create_dir_all(folder.join("inner")).unwrap();
            // In another order, and with other rights.
            let mut files = [("program", 0o700), ("inner/text", 0o600)];
            if name == "two" {
                files = [("inner/text", 0o666), ("program", 0o777)];
            }
            for (file, mode) in files {
                fs::write(folder.join(file), file).unwrap();
                fs::set_permissions(folder.join(file), fs::Permissions::from_mode(mode)).unwrap();
            }
            let archive = root.path().join(format!("{name}.tar.gz"));
            pack(&folder, "shield", &archive).unwrap();
            archive
        });
        assert!(fs::read(&archives[0]).unwrap() == fs::read(&archives[1]).unwrap());
        output(Command::new("tar").arg("-xzf").arg(&archives[0]).current_dir(root.path())).unwrap();
        let mode =
            |file| fs::metadata(root.path().join("shield").join(file)).unwrap().permissions().mode() & 0o777;
        // Nobody else may write them: the loader refuses such plugins.
        assert_eq!((mode("program") & 0o122, mode("inner/text") & 0o133), (0o100, 0));
    }
}
