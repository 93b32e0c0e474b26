//! Native libraries: brings them where the build expects them, unless they are there or the user has their own.

use std::env;
use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use anyhow::{Context, Result, bail};
use tempfile::{Builder, TempDir};

/// What `mujoco-rs` binds; the two change together.
const MUJOCO_VERSION: &str = "3.17.0";
const MUJOCO_LINK_DIR: &str = "MUJOCO_DYNAMIC_LINK_DIR";
/// Where `.cargo/config.toml` looks.
const MUJOCO_FOLDER: &str = "native/mujoco";
/// What the linker is given; a link to the library of the version.
const MUJOCO_LIBRARY: &str = "libmujoco.so";
/// Where its licences are kept.
const LICENCES: &str = "licenses";

/// The folder that holds MuJoCo's library: the user's own if `MUJOCO_DYNAMIC_LINK_DIR` names one, else `native/mujoco/lib`,
/// filled from MuJoCo's Python package if need be.
///
/// # Errors
/// The user's folder holds no MuJoCo, the platform has no package, or the package cannot be had; each with the remedy.
pub fn mujoco(workspace_root: &Path) -> Result<PathBuf> {
    let ours = workspace_root.join(MUJOCO_FOLDER);
    let lib = ours.join("lib");
    if let Some(theirs) = env::var_os(MUJOCO_LINK_DIR).map(PathBuf::from)
        && !is_in_workspace(&theirs, workspace_root)
    {
        return check_own_mujoco(theirs);
    }
    if lib.join(MUJOCO_LIBRARY).exists() {
        return Ok(lib);
    }
    install_mujoco(&ours)?;
    Ok(lib)
}

/// The name of MuJoCo's library, as the linker writes it into what needs it.
pub fn mujoco_file() -> String {
    format!("{MUJOCO_LIBRARY}.{MUJOCO_VERSION}")
}

/// MuJoCo's licence and those of what is linked into it: files beside the folder `lib` of its library. Who hands on the library hands on these.
///
/// # Errors
/// The user's own MuJoCo has none, or the package, which holds them, cannot be had.
pub fn mujoco_licences(workspace_root: &Path, lib: &Path) -> Result<Vec<PathBuf>> {
    let folder = lib.parent().context("MuJoCo's library lies in a folder `lib`")?;
    let found = licences_in(folder)?;
    if !found.is_empty() {
        return Ok(found);
    }
    if !is_in_workspace(lib, workspace_root) {
        bail!(
            "{} holds neither `{LICENCES}` nor LICENSE: MuJoCo cannot be handed on without. Unset {MUJOCO_LINK_DIR}: MuJoCo is then brought \
             with its licences",
            folder.display()
        );
    }
    // An earlier set-up left them out.
    install_mujoco(folder)?;
    licences_in(folder)
}

/// As the Python package has them, or the archive of a release.
fn licences_in(folder: &Path) -> Result<Vec<PathBuf>> {
    let own = folder.join(LICENCES);
    let searched = if own.is_dir() { own.as_path() } else { folder };
    let mut found = Vec::new();
    for entry in fs::read_dir(searched).with_context(|| format!("cannot read {}", searched.display()))? {
        let path = entry?.path();
        let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default();
        if path.is_file() && ["LICENSE", "THIRD_PARTY"].iter().any(|start| name.starts_with(start)) {
            found.push(path);
        }
    }
    Ok(found)
}

/// Whether `path` is `native/mujoco/lib` in the workspace, however it is written and whether or not it exists: cargo itself sets
/// the variable to it when it runs this program.
fn is_in_workspace(path: &Path, workspace_root: &Path) -> bool {
    let root = path.ancestors().nth(3).and_then(|root| root.canonicalize().ok());
    path.ends_with(Path::new(MUJOCO_FOLDER).join("lib")) && root == workspace_root.canonicalize().ok()
}

fn check_own_mujoco(folder: PathBuf) -> Result<PathBuf> {
    if folder.join(MUJOCO_LIBRARY).exists() {
        return Ok(folder);
    }
    bail!(
        "{MUJOCO_LINK_DIR} names {}, which holds no {MUJOCO_LIBRARY}. Point it to the `lib` folder of MuJoCo {MUJOCO_VERSION}, or unset \
         it: MuJoCo is then brought here",
        folder.display()
    )
}

/// Fills `folder` in one move, so that an interrupted set-up leaves nothing half done.
fn install_mujoco(folder: &Path) -> Result<()> {
    let scratch = scratch_beside(folder)?;
    let ready = scratch.path().join("ready");
    fs::create_dir(&ready).with_context(|| format!("cannot create {}", ready.display()))?;
    arrange_mujoco(&download_mujoco(scratch.path())?, &ready)?;
    replace(folder, &ready)?;
    scratch.close().context("cannot remove what was downloaded")
}

/// A folder beside `folder` in which it is prepared, of a name that nobody else has; removed when it is dropped.
pub fn scratch_beside(folder: &Path) -> Result<TempDir> {
    let parent = folder.parent().context("a folder to be filled lies in another")?;
    let mut prefix = folder.file_name().unwrap_or_default().to_owned();
    prefix.push(".");
    let made = fs::create_dir_all(parent)
        .and_then(|()| Builder::new().prefix(&prefix).suffix(".partial").tempdir_in(parent));
    made.with_context(|| format!("cannot create a folder in {}", parent.display()))
}

/// Downloads and unpacks the Python package, and returns where its content lies. pip checks the package's hash.
fn download_mujoco(folder: &Path) -> Result<PathBuf> {
    if env::consts::OS != "linux" {
        bail!(
            "MuJoCo is brought automatically on Linux only. Install MuJoCo {MUJOCO_VERSION} and set {MUJOCO_LINK_DIR} to its `lib` folder"
        );
    }
    // The package holds the same library for every version of Python: name one that it exists for, whatever runs here.
    let platform = format!("manylinux_2_28_{}", env::consts::ARCH);
    let requirement = format!("mujoco=={MUJOCO_VERSION}");
    let mut pip = Command::new("python3");
    pip.args([
        "-m",
        "pip",
        "download",
        "--quiet",
        "--disable-pip-version-check",
        "--no-deps",
        "--only-binary=:all:",
    ]);
    pip.args(["--python-version", "3.12", "--platform", &platform, "--dest"]).arg(folder).arg(&requirement);
    run(&mut pip)?;

    let wheel = find(folder, |name| name.ends_with(".whl"))?;
    let package = folder.join("package");
    run(Command::new("python3").args(["-m", "zipfile", "-e"]).arg(&wheel).arg(&package))?;
    Ok(package)
}

/// Moves library and headers from the unpacked package to where `mujoco-rs` and a C compiler expect them, and the licences beside them.
fn arrange_mujoco(package: &Path, ready: &Path) -> Result<()> {
    let licences = package.join(format!("mujoco-{MUJOCO_VERSION}.dist-info")).join(LICENCES);
    let package = package.join("mujoco");
    let versioned = mujoco_file();
    let lib = ready.join("lib");
    fs::create_dir_all(&lib)?;
    fs::rename(package.join(&versioned), lib.join(&versioned))
        .with_context(|| format!("MuJoCo's Python package holds no {versioned}"))?;
    fs::rename(package.join("include"), ready.join("include"))
        .context("MuJoCo's Python package holds no headers")?;
    fs::rename(licences, ready.join(LICENCES)).context("MuJoCo's Python package holds no licences")?;
    symlink(&versioned, lib.join(MUJOCO_LIBRARY)).context("cannot link MuJoCo's library to its usual name")
}

/// Puts `ready` in the place of `folder`: what is there is not complete, else we would not be here.
fn replace(folder: &Path, ready: &Path) -> Result<()> {
    match fs::remove_dir_all(folder) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            return Err(error).with_context(|| format!("cannot replace {}", folder.display()));
        }
        _ => {}
    }
    fs::rename(ready, folder).with_context(|| format!("cannot create {}", folder.display()))
}

fn find(folder: &Path, is_wanted: impl Fn(&str) -> bool) -> Result<PathBuf> {
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        if path.file_name().and_then(|name| name.to_str()).is_some_and(&is_wanted) {
            return Ok(path);
        }
    }
    bail!("pip left no package in {}", folder.display())
}

fn run(command: &mut Command) -> Result<()> {
    let remedy = || {
        format!(
            "MuJoCo {MUJOCO_VERSION} comes as a Python package: its download needs python3 with pip and the network (on Debian: apt install \
             python3-pip). Or install MuJoCo yourself and set {MUJOCO_LINK_DIR} to its `lib` folder"
        )
    };
    let Output { status, stderr, .. } =
        command.output().with_context(|| format!("cannot start python3. {}", remedy()))?;
    if status.success() {
        return Ok(());
    }
    bail!("{}\n{}", String::from_utf8_lossy(&stderr).trim_end(), remedy())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scratch(name: &str) -> PathBuf {
        let folder = env::temp_dir().join(format!("xtask-native-{name}-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        folder
    }

    #[test]
    fn a_users_folder_without_mujoco_is_refused_with_the_remedy() {
        let folder = scratch("own");
        let error = check_own_mujoco(folder.clone()).unwrap_err().to_string();
        assert!(error.contains("unset"), "{error}");
        fs::write(folder.join(MUJOCO_LIBRARY), b"").unwrap();
        assert_eq!(check_own_mujoco(folder.clone()).unwrap(), folder);
        fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn a_users_mujoco_without_its_licence_is_refused_with_the_remedy() {
        let folder = scratch("licence");
        let lib = folder.join("lib");
        fs::create_dir_all(&lib).unwrap();
        let refused = mujoco_licences(&env::temp_dir().join("elsewhere"), &lib).unwrap_err().to_string();
        assert!(refused.contains("LICENSE") && refused.contains("Unset"), "{refused}");
        // As in the archive of a release.
        fs::write(folder.join("LICENSE"), b"as you like").unwrap();
        let found = mujoco_licences(&env::temp_dir().join("elsewhere"), &lib).unwrap();
        assert_eq!(found, [folder.join("LICENSE")]);
        fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn the_folder_that_cargo_names_is_recognised_as_the_workspaces() {
        let root = scratch("root");
        let roundabout = root.join("..").join(root.file_name().unwrap());
        assert!(is_in_workspace(&root.join("native/mujoco/lib"), &roundabout));
        assert!(!is_in_workspace(&root.join("other/mujoco/lib"), &root));
        assert!(!is_in_workspace(&env::temp_dir().join("native/mujoco/lib"), &root));
        fs::remove_dir_all(root).unwrap();
    }

    #[test]
    fn a_program_that_is_missing_or_fails_is_reported_with_the_remedy() {
        for mut command in [Command::new("no-such-program-here"), Command::new("false")] {
            let error = format!("{:#}", run(&mut command).unwrap_err());
            assert!(error.contains("python3-pip") && error.contains(MUJOCO_LINK_DIR), "{error}");
        }
    }

    #[test]
    fn a_package_is_arranged_completely_or_not_at_all() {
        let root = scratch("arrange");
        let (package, ready, folder) = (root.join("package"), root.join("ready"), root.join("native"));
        let licences = package.join(format!("mujoco-{MUJOCO_VERSION}.dist-info/licenses"));
        fs::create_dir_all(package.join("mujoco/include/mujoco")).unwrap();
        fs::create_dir_all(&licences).unwrap();
        fs::write(licences.join("LICENSE"), b"as you like").unwrap();
        fs::create_dir_all(&ready).unwrap();
        assert!(arrange_mujoco(&package, &ready).unwrap_err().to_string().contains(MUJOCO_VERSION));
        assert!(!folder.exists());

        fs::write(package.join("mujoco").join(mujoco_file()), b"library").unwrap();
        arrange_mujoco(&package, &ready).unwrap();
        // A half-done folder of an older set-up is in the way.
        fs::create_dir_all(folder.join("lib")).unwrap();
        replace(&folder, &ready).unwrap();
        assert_eq!(fs::read(folder.join("lib").join(MUJOCO_LIBRARY)).unwrap(), b"library");
        assert!(folder.join("include/mujoco").exists() && !ready.exists());
        assert_eq!(mujoco_licences(&root, &folder.join("lib")).unwrap(), [folder.join("licenses/LICENSE")]);
        fs::remove_dir_all(root).unwrap();
    }
}
