//! What is asked of a file before anything of it is executed: who may have written it, and whether it is the one that was meant.

use std::{
    collections::HashMap,
    fs::{self, Metadata},
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
};

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

/// The fingerprints of files that were read already: reading a large library anew for each of its instances would take longer than
/// making them. A file that has changed since is read again.
#[derive(Debug, Default)]
pub(super) struct Fingerprints(Mutex<HashMap<PathBuf, (Stamp, String)>>);

impl Fingerprints {
    /// As [`fingerprint`].
    pub(super) fn of(&self, path: &Path) -> Result<String, PluginError> {
        let data = fs::metadata(path)
            .map_err(|error| PluginError::Unreadable { path: path.into(), reason: error.to_string() })?;
        let stamp = stamp(&data);
        let mut known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, found)) = known.get(path).filter(|(read, _)| *read == stamp) {
            return Ok(found.clone());
        }
        let found = fingerprint(path)?;
        known.insert(path.into(), (stamp, found.clone()));
        Ok(found)
    }
}

/// What changes with the content of a file: device, number, length, and the time of the last change, which nobody sets at will.
#[cfg(unix)]
type Stamp = (u64, u64, u64, i64, i64);

#[cfg(unix)]
fn stamp(data: &Metadata) -> Stamp {
    use std::os::unix::fs::MetadataExt as _;
    (data.dev(), data.ino(), data.len(), data.ctime(), data.ctime_nsec())
}

#[cfg(not(unix))]
type Stamp = (u64, Option<std::time::SystemTime>);

#[cfg(not(unix))]
fn stamp(data: &Metadata) -> Stamp {
    (data.len(), data.modified().ok())
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
    fn the_fingerprint_is_the_standard_sha_256() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("abc");
        std::fs::write(&path, "abc").unwrap();
        // FIPS 180-2, appendix B.1.
        let expected = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(fingerprint(&path).unwrap(), expected);
    }

    #[test]
    fn a_file_is_read_once_unless_it_changes() {
        let folder = tempfile::tempdir().unwrap();
        let (path, other) = (folder.path().join("a"), folder.path().join("b"));
        std::fs::write(&path, "abc").unwrap();
        let known = Fingerprints::default();
        let first = known.of(&path).unwrap();
        assert_eq!(first, fingerprint(&path).unwrap());
        // What is remembered is given, without a look at the bytes.
        known.0.lock().unwrap().values_mut().for_each(|(_, found)| *found = "remembered".into());
        assert_eq!(known.of(&path).unwrap(), "remembered");
        // Another file takes its place, of the same length and at the same time.
        std::fs::write(&other, "abd").unwrap();
        std::fs::rename(&other, &path).unwrap();
        assert_eq!(known.of(&path).unwrap(), fingerprint(&path).unwrap());
        assert_ne!(known.of(&path).unwrap(), first);
        std::fs::remove_file(&path).unwrap();
        assert!(known.of(&path).is_err());
    }
}
