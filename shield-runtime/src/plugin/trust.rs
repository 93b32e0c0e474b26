//! What is asked of a file before anything of it is executed: who may have written it, and whether it is the one that was meant.

use std::{fs, path::Path};

use sha2::{Digest, Sha256};

use super::PluginError;

/// Set to 1 to load plugins that others on this machine may have replaced.
pub const ALLOW_WRITABLE: &str = "SHIELD_ALLOW_WRITABLE_PLUGINS";

/// SHA-256 of a file's bytes, as 64 lower-case hexadecimal digits.
///
/// # Errors
/// The file cannot be read.
pub fn fingerprint(path: &Path) -> Result<String, PluginError> {
    let bytes = fs::read(path)
        .map_err(|error| PluginError::Unreadable { path: path.into(), reason: error.to_string() })?;
    Ok(Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect())
}

/// Refuses a file that every user of the machine may write, or whose folder they may: what runs in this process would be theirs.
pub(super) fn check_writable(path: &Path) -> Result<(), PluginError> {
    if std::env::var_os(ALLOW_WRITABLE).is_some_and(|value| value == "1") {
        return Ok(());
    }
    match [Some(path), path.parent()].into_iter().flatten().find(|path| others_may_write(path)) {
        Some(writable) => Err(PluginError::Writable { path: path.into(), writable: writable.into() }),
        None => Ok(()),
    }
}

#[cfg(unix)]
fn others_may_write(path: &Path) -> bool {
    use std::os::unix::fs::MetadataExt as _;
    const WRITE_BY_OTHERS: u32 = 0o002;
    // What cannot be looked at cannot be loaded either, and says so itself.
    path.metadata().is_ok_and(|data| data.mode() & WRITE_BY_OTHERS != 0)
}

#[cfg(not(unix))]
fn others_may_write(_: &Path) -> bool {
    false
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_fingerprint_is_the_one_that_every_tool_gives() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("abc");
        std::fs::write(&path, "abc").unwrap();
        // FIPS 180-2, appendix B.1.
        let expected = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(fingerprint(&path).unwrap(), expected);
    }
}
