//! The lock of a run: one process at a time judges its checkpoints and writes them.

use std::{
    fs::{File, Metadata, OpenOptions, TryLockError},
    io,
    path::Path,
};

use super::file::{CheckpointError, Result};
use crate::growing_file::without_following;

/// Takes the lock in the folder of the checkpoints. The system gives it back when the process ends, in whatever way.
///
/// The file stays as it is: it is neither truncated nor written. A link is not followed, because it could lead to a file of the user.
pub(super) fn lock(folder: &Path) -> Result<File> {
    let path = folder.join("lock");
    let failed = |error| CheckpointError::io(&path, error);
    match path.symlink_metadata() {
        Err(error) if error.kind() == io::ErrorKind::NotFound => {}
        found => ensure_regular(&found.map_err(failed)?, &path)?,
    }
    // The name may stand for something else by now.
    let mut options = OpenOptions::new();
    options.read(true).write(true).create(true).truncate(false);
    let file = without_following(&mut options).open(&path).map_err(failed)?;
    let opened = file.metadata().map_err(failed)?;
    ensure_regular(&opened, &path)?;
    let busy = || CheckpointError::Busy { path: folder.to_owned() };
    match file.try_lock() {
        Ok(()) => {}
        Err(TryLockError::WouldBlock) => return Err(busy()),
        Err(TryLockError::Error(error)) => return Err(failed(error)),
    }
    // Another process may have replaced the whole folder in between. Then this is the lock of a folder that is gone.
    match path.symlink_metadata() {
        Ok(present) if is_same(&opened, &present) => Ok(file),
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(failed(error)),
        _ => Err(busy()),
    }
}

fn ensure_regular(found: &Metadata, path: &Path) -> Result<()> {
    if found.is_file() { Ok(()) } else { Err(CheckpointError::IrregularLock { path: path.to_owned() }) }
}

#[cfg(unix)]
fn is_same(one: &Metadata, other: &Metadata) -> bool {
    use std::os::unix::fs::MetadataExt as _;
    (one.dev(), one.ino()) == (other.dev(), other.ino())
}

/// Without inodes there is nothing to compare.
#[cfg(not(unix))]
fn is_same(_one: &Metadata, _other: &Metadata) -> bool {
    true
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use std::{fs, os::unix::fs::symlink};

    use super::*;

    #[test]
    fn a_lock_that_is_a_link_is_refused_and_the_file_behind_it_is_untouched() {
        let folder = tempfile::tempdir().unwrap();
        let precious = folder.path().join("precious");
        fs::write(&precious, "mine").unwrap();
        symlink(&precious, folder.path().join("lock")).unwrap();
        assert!(matches!(lock(folder.path()), Err(CheckpointError::IrregularLock { .. })));
        assert_eq!(fs::read_to_string(&precious).unwrap(), "mine");
    }

    #[test]
    fn a_lock_that_is_a_link_to_nothing_creates_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let nothing = folder.path().join("nothing");
        symlink(&nothing, folder.path().join("lock")).unwrap();
        assert!(matches!(lock(folder.path()), Err(CheckpointError::IrregularLock { .. })));
        assert!(!nothing.exists());
    }

    #[test]
    fn a_pipe_and_a_folder_are_no_locks() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lock");
        let mode = rustix::fs::Mode::from_raw_mode(0o600);
        rustix::fs::mknodat(rustix::fs::CWD, &path, rustix::fs::FileType::Fifo, mode, 0).unwrap();
        assert!(matches!(lock(folder.path()), Err(CheckpointError::IrregularLock { .. })));
        fs::remove_file(&path).unwrap();
        fs::create_dir(&path).unwrap();
        assert!(matches!(lock(folder.path()), Err(CheckpointError::IrregularLock { .. })));
    }

    #[test]
    fn the_file_of_a_lock_keeps_its_bytes_and_a_second_lock_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join("lock"), "a note").unwrap();
        let first = lock(folder.path()).unwrap();
        assert!(matches!(lock(folder.path()), Err(CheckpointError::Busy { .. })));
        drop(first);
        drop(lock(folder.path()).unwrap());
        assert_eq!(fs::read_to_string(folder.path().join("lock")).unwrap(), "a note");
    }
}
