//! Which program the worker processes run.

use std::{
    env,
    ffi::OsStr,
    path::{Path, PathBuf},
};

/// The environment variable that names the program, where it is not found by itself.
pub const VARIABLE: &str = "SHIELD_WORKER";
const NAME: &str = "shield";

/// The program `shield`: what the variable names; this program, if it is the one; else the one beside it, or in the folder above,
/// where Cargo puts it for a test.
pub(super) fn find() -> Result<PathBuf, String> {
    if let Some(named) = env::var_os(VARIABLE).filter(|value| !value.is_empty()) {
        return Ok(named.into());
    }
    let own = env::current_exe().map_err(|error| format!("the path of this program is unknown: {error}"))?;
    beside(&own)
}

fn beside(own: &Path) -> Result<PathBuf, String> {
    if own.file_stem() == Some(OsStr::new(NAME)) {
        return Ok(own.into());
    }
    let file = format!("{NAME}{}", env::consts::EXE_SUFFIX);
    let candidates = own.ancestors().skip(1).take(2).map(|folder| folder.join(&file));
    let searched: Vec<PathBuf> = candidates.collect();
    searched.iter().find(|path| path.is_file()).cloned().ok_or_else(|| {
        let searched: Vec<String> = searched.iter().map(|path| path.display().to_string()).collect();
        format!(
            "an isolated plugin runs in the program `{NAME}`, which was not found (searched: {}); name it in the environment \
             variable {VARIABLE}",
            searched.join(", ")
        )
    })
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn a_missing_program_is_reported_with_the_remedy() {
        let folder = tempfile::tempdir().unwrap();
        let test = folder.path().join("deps/test");
        let error = beside(&test).unwrap_err();
        assert!(error.contains(VARIABLE), "{error}");
        fs::write(folder.path().join("shield"), "").unwrap();
        assert_eq!(beside(&test).unwrap(), folder.path().join("shield"));
        assert_eq!(beside(Path::new("/opt/shield")).unwrap(), Path::new("/opt/shield"));
    }
}
