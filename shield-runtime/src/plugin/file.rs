//! The file of a library, open: its manifests, its hash and what is loaded come from this one file, whatever its path names meanwhile.

use std::{
    collections::HashMap,
    fs::{File, Metadata},
    io,
    os::unix::fs::{FileExt as _, MetadataExt as _},
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
};

use sha2::{Digest, Sha256};
use shield_api::regular_file;

use super::{PluginError, Selection, trust::check_trust};

/// How much is read at once.
const BLOCK: usize = 1 << 16;

/// SHA-256 of a file's bytes, as 64 lower-case hexadecimal digits.
///
/// # Errors
/// The file cannot be read.
pub fn fingerprint(path: &Path) -> Result<String, PluginError> {
    LibraryFile::open(path)?.sha256()
}

/// A library's file that is open for reading.
#[derive(Debug)]
pub(super) struct LibraryFile {
    path: PathBuf,
    file: File,
    opened: Content,
}

/// Which file it is. No other file has the numbers while this one is open or loaded.
pub(super) type FileNumber = (u64, u64);

/// Length and time of the last write: they change when somebody writes into the file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Content {
    length: u64,
    written: (i64, i64),
}

impl Content {
    fn of(data: &Metadata) -> Self {
        Self { length: data.len(), written: (data.mtime(), data.mtime_nsec()) }
    }
}

impl LibraryFile {
    /// Opens the file at `path`, whoever may have written it: to look at, not to load.
    pub(super) fn open(path: &Path) -> Result<Self, PluginError> {
        let open = || {
            let file = regular_file::open(path)?;
            let opened = Content::of(&file.metadata()?);
            io::Result::Ok(Self { path: path.into(), file, opened })
        };
        open().map_err(|error| unreadable(path, &error))
    }

    /// Opens the file at `path` if only root and the user of this program could have put it there. From then on it goes by its canonical path.
    pub(super) fn open_trusted(path: &Path) -> Result<Self, PluginError> {
        check_trust(path)?;
        // The system's loader would look for a bare name in its own folders.
        Self::open(&path.canonicalize().map_err(|error| unreadable(path, &error))?)
    }

    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    pub(super) fn file(&self) -> &File {
        &self.file
    }

    /// What was in the file when it was opened.
    pub(super) fn content(&self) -> Content {
        self.opened
    }

    pub(super) fn number(&self) -> Result<FileNumber, PluginError> {
        let data = self.metadata()?;
        Ok((data.dev(), data.ino()))
    }

    fn metadata(&self) -> Result<Metadata, PluginError> {
        self.file.metadata().map_err(|error| unreadable(&self.path, &error))
    }

    /// Refuses a file that somebody has written into since it was opened.
    pub(super) fn check_unchanged(&self) -> Result<(), PluginError> {
        if Content::of(&self.metadata()?) == self.opened {
            Ok(())
        } else {
            Err(PluginError::Changed { path: self.path.clone() })
        }
    }

    /// Refuses a file that is not at its path any more.
    pub(super) fn check_in_place(&self) -> Result<(), PluginError> {
        self.check_unchanged()?;
        let there = self.path.metadata().map_err(|error| unreadable(&self.path, &error))?;
        if (there.dev(), there.ino()) == self.number()? {
            Ok(())
        } else {
            Err(PluginError::Changed { path: self.path.clone() })
        }
    }

    /// SHA-256 of what was in the file when it was opened.
    pub(super) fn sha256(&self) -> Result<String, PluginError> {
        let (mut hasher, mut block, mut offset) = (Sha256::new(), vec![0; BLOCK], 0);
        loop {
            let count =
                self.file.read_at(&mut block, offset).map_err(|error| unreadable(&self.path, &error))?;
            if count == 0 {
                break;
            }
            hasher.update(&block[..count]);
            offset += count as u64;
        }
        self.check_unchanged()?;
        Ok(hasher.finalize().iter().map(|byte| format!("{byte:02x}")).collect())
    }
}

pub(super) fn unreadable(path: &Path, error: &io::Error) -> PluginError {
    PluginError::Unreadable { path: path.into(), reason: error.to_string() }
}

/// Hashes that were computed already: reading a large library anew for each of its instances would take longer than making them. A file that has
/// changed since is read again.
#[derive(Debug, Default)]
pub(super) struct Fingerprints(Mutex<HashMap<Stamp, String>>);

/// What changes with the content of a file: device, number, length, and the time of the last change, which nobody sets at will.
type Stamp = (u64, u64, u64, i64, i64);

impl Fingerprints {
    /// As [`fingerprint`].
    pub(super) fn of(&self, file: &LibraryFile) -> Result<String, PluginError> {
        let data = file.metadata()?;
        let stamp = (data.dev(), data.ino(), data.len(), data.ctime(), data.ctime_nsec());
        let mut known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(found) = known.get(&stamp) {
            file.check_unchanged()?;
            return Ok(found.clone());
        }
        let found = file.sha256()?;
        known.insert(stamp, found.clone());
        Ok(found)
    }

    /// Refuses a file that is not the one that the experiment pins.
    pub(super) fn check_pin(&self, choice: &Selection, file: &LibraryFile) -> Result<(), PluginError> {
        choice.sha256.as_ref().map_or(Ok(()), |pinned| compare(&choice.id, pinned, self.of(file)?, file))
    }
}

/// As [`Fingerprints::check_pin`], for a file that is loaded once.
pub(super) fn check_pin(id: &str, pinned: &str, file: &LibraryFile) -> Result<(), PluginError> {
    compare(id, pinned, file.sha256()?, file)
}

fn compare(id: &str, pinned: &str, found: String, file: &LibraryFile) -> Result<(), PluginError> {
    if found == pinned {
        return Ok(());
    }
    let (path, id, pinned) = (file.path.clone(), id.into(), pinned.into());
    Err(PluginError::NotPinned { path, id, pinned, found })
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn the_fingerprint_is_the_one_that_every_tool_gives() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("abc");
        fs::write(&path, "abc").unwrap();
        // FIPS 180-2, appendix B.1.
        let expected = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(fingerprint(&path).unwrap(), expected);
        // More than one block: as `sha256sum` has it.
        fs::write(&path, vec![b'a'; 1_000_000]).unwrap();
        let expected = "cdc76e5c9914fb9281a1c7e284d73e67f1809a48a497200e046d39ccc7112cd0";
        assert_eq!(fingerprint(&path).unwrap(), expected);
    }

    #[test]
    fn a_file_is_read_once_unless_it_changes() {
        let folder = tempfile::tempdir().unwrap();
        let (path, other) = (folder.path().join("a"), folder.path().join("b"));
        fs::write(&path, "abc").unwrap();
        let known = Fingerprints::default();
        let of = |path: &Path| known.of(&LibraryFile::open(path).unwrap());
        let first = of(&path).unwrap();
        assert_eq!(first, fingerprint(&path).unwrap());
        // What is remembered is given, without a look at the bytes.
        known.0.lock().unwrap().values_mut().for_each(|found| *found = "remembered".into());
        assert_eq!(of(&path).unwrap(), "remembered");
        // Another file takes its place, of the same length and at the same time.
        fs::write(&other, "abd").unwrap();
        fs::rename(&other, &path).unwrap();
        assert_eq!(of(&path).unwrap(), fingerprint(&path).unwrap());
        assert_ne!(of(&path).unwrap(), first);
        fs::remove_file(&path).unwrap();
        assert!(LibraryFile::open(&path).is_err());
    }

    #[test]
    fn an_open_file_stays_itself_when_its_path_gets_another_and_is_refused_once_it_is_written_into() {
        let folder = tempfile::tempdir().unwrap();
        let (path, other) = (folder.path().join("a"), folder.path().join("b"));
        fs::write(&path, "abc").unwrap();
        let file = LibraryFile::open(&path).unwrap();
        let hash = file.sha256().unwrap();
        file.check_in_place().unwrap();
        fs::hard_link(&path, folder.path().join("kept")).unwrap();
        fs::write(&other, "abd").unwrap();
        fs::rename(&other, &path).unwrap();
        assert_eq!(file.sha256().unwrap(), hash);
        assert_eq!(file.check_in_place(), Err(PluginError::Changed { path: path.clone() }));
        fs::write(folder.path().join("kept"), "abcd").unwrap();
        assert_eq!(file.sha256(), Err(PluginError::Changed { path }));
    }
}
