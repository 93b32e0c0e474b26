//! Puts MuJoCo beside the library that is built, where its run path `$ORIGIN` finds it: no `LD_LIBRARY_PATH`, no absolute path in
//! the library, and the two files can be moved together.

use std::path::{Path, PathBuf};
use std::{env, fs, io};

const LINK_DIR: &str = "MUJOCO_DYNAMIC_LINK_DIR";
/// The name that the linker writes into what is built.
const LIBRARY: &str = "libmujoco.so.3.17.0";

fn main() -> io::Result<()> {
    println!("cargo::rerun-if-env-changed={LINK_DIR}");
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rustc-link-arg=-Wl,-rpath,$ORIGIN");
    // Without the variable, mujoco-rs takes an installed MuJoCo, which the system's loader finds by itself.
    if let Some(folder) = env::var_os(LINK_DIR) {
        let library = PathBuf::from(folder).join(LIBRARY);
        for folder in output_folders()? {
            let copy = folder.join(LIBRARY);
            place(&library, &copy)?;
            println!("cargo::rerun-if-changed={}", copy.display());
        }
    }
    Ok(())
}

/// `target/<profile>` holds the library, `target/<profile>/deps` the same and the test programs.
fn output_folders() -> io::Result<[PathBuf; 2]> {
    let out = PathBuf::from(env::var_os("OUT_DIR").ok_or_else(|| io::Error::other("OUT_DIR is not set"))?);
    // target/<profile>/build/<package>-<hash>/out
    let profile =
        out.ancestors().nth(3).ok_or_else(|| io::Error::other("OUT_DIR is not in a target folder"))?;
    Ok([profile.to_path_buf(), profile.join("deps")])
}

/// Links `copy` to `library`, or copies it to another file system. Atomic, for builds that run at the same time.
fn place(library: &Path, copy: &Path) -> io::Result<()> {
    let name = |error| io::Error::other(format!("{}: {error}", library.display()));
    let modified = fs::metadata(library).and_then(|data| data.modified()).map_err(name)?;
    let partial = copy.with_extension(format!("partial-{}", std::process::id()));
    if fs::hard_link(library, &partial).is_err() {
        fs::copy(library, &partial)?;
        // As old as the original, else cargo would take it for changed after each build.
        fs::File::options().append(true).open(&partial)?.set_modified(modified)?;
    }
    fs::rename(&partial, copy)?;
    // Renaming a link over another link to the same file does nothing, not even remove it.
    match fs::remove_file(&partial) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}
