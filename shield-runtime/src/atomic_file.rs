//! Files that appear under their name only when they are complete.
//!
//! The bytes first go to a temporary file in the same folder, called `.shield-`, twelve random letters and digits, and `.partial`. It is created only
//! if nothing has that name, so no two programs share it and it follows no link. [`AtomicFile::commit`] then renames it.
//!
//! Only a regular file is replaced. A folder, a device, a pipe and a symbolic link are refused: replacing a link would leave the file that it leads to
//! as it was, and following it would let the owner of a shared folder choose what is overwritten. The folders above may be links.

use std::{
    ffi::OsStr,
    fs::{self, File, Metadata},
    io::{self, Write},
    path::{Path, PathBuf},
};

use tempfile::{Builder, NamedTempFile};

const PREFIX: &str = ".shield-";
const SUFFIX: &str = ".partial";
/// Letters and digits between the two.
const RANDOM: usize = 12;

/// A file that is being written. Readers see it only after [`commit`](Self::commit); if it is dropped before, nothing is left.
#[derive(Debug)]
pub struct AtomicFile {
    target: PathBuf,
    temporary: NamedTempFile,
}

impl AtomicFile {
    /// Begins a file that will be called `path`. It gets the permissions of the file that it replaces; a new one has those that the umask leaves.
    ///
    /// # Errors
    /// Something other than a regular file has that name, or its folder cannot be written.
    pub fn create(path: &Path) -> io::Result<Self> {
        let target = std::path::absolute(path)?;
        let replaced = replaceable(&target)?;
        let folder = target.parent().ok_or(io::ErrorKind::IsADirectory)?;
        let temporary = temporary_in(folder, replaced.as_ref())?;
        Ok(Self { target, temporary })
    }

    /// Where the bytes are until then, for another program that writes them.
    pub fn temporary_path(&self) -> &Path {
        self.temporary.path()
    }

    /// Makes the bytes last, so that the name never stands for a torn file, even after a power failure.
    ///
    /// # Errors
    /// The system cannot write them.
    pub fn sync(&self) -> io::Result<()> {
        self.temporary.as_file().sync_all()
    }

    /// Gives the file its name, in the place of the one that has it.
    ///
    /// # Errors
    /// Something other than a regular file has that name now, or the folder cannot be written.
    pub fn commit(self) -> io::Result<()> {
        replaceable(&self.target)?;
        self.temporary.persist(&self.target)?;
        Ok(())
    }

    /// Gives the file its name if nothing has it. Of several programs that do so at once, one succeeds.
    ///
    /// # Errors
    /// Something has that name, or the folder cannot be written.
    pub(crate) fn commit_new(self) -> io::Result<()> {
        self.temporary.persist_noclobber(&self.target)?;
        Ok(())
    }
}

impl Write for AtomicFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.temporary.as_file_mut().write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.temporary.as_file_mut().flush()
    }
}

/// Writes a whole file in one step: readers find the old one or the new one.
///
/// # Errors
/// See [`AtomicFile`]. The old file is then as it was.
pub fn write_atomically(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut file = AtomicFile::create(path)?;
    file.write_all(bytes)?;
    file.commit()
}

/// Removes the temporary files that killed programs left in a folder. Nobody else may be writing there.
pub(crate) fn remove_leftovers(folder: &Path) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        if is_temporary(&entry.file_name()) && entry.file_type()?.is_file() {
            match fs::remove_file(entry.path()) {
                Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
                _ => {}
            }
        }
    }
    Ok(())
}

fn is_temporary(name: &OsStr) -> bool {
    let random =
        name.to_str().and_then(|name| name.strip_prefix(PREFIX)).and_then(|name| name.strip_suffix(SUFFIX));
    random.is_some_and(|random| {
        random.len() == RANDOM && random.bytes().all(|byte| byte.is_ascii_alphanumeric())
    })
}

/// The regular file of that name, if there is one; an error if the name stands for something else.
fn replaceable(path: &Path) -> io::Result<Option<Metadata>> {
    let found = match fs::symlink_metadata(path) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(None),
        found => found?,
    };
    ensure_regular(&found, path)?;
    Ok(Some(found))
}

/// Refuses what is not a regular file, and says what it is.
pub(crate) fn ensure_regular(found: &Metadata, path: &Path) -> io::Result<()> {
    let file_type = found.file_type();
    let reason = if file_type.is_file() {
        return Ok(());
    } else if file_type.is_symlink() {
        let target = fs::read_link(path).unwrap_or_default();
        format!("it is a symbolic link; name the file that it leads to, {}", target.display())
    } else if file_type.is_dir() {
        "it is a folder; choose the name of a file".into()
    } else {
        "it is a device, a pipe or a socket; choose the name of a regular file".into()
    };
    Err(io::Error::new(io::ErrorKind::InvalidInput, reason))
}

#[cfg(unix)]
fn temporary_in(folder: &Path, replaced: Option<&Metadata>) -> io::Result<NamedTempFile> {
    use std::os::unix::fs::PermissionsExt as _;
    let mode = replaced.map_or(0o666, |replaced| replaced.permissions().mode() & 0o777);
    // Never more open than the file that it replaces, not even for a moment.
    let temporary = builder().permissions(fs::Permissions::from_mode(mode)).tempfile_in(folder)?;
    if replaced.is_some() {
        restore_mode(temporary.as_file(), mode)?;
    }
    Ok(temporary)
}

/// Gives back what the umask took.
#[cfg(unix)]
fn restore_mode(file: &File, mode: u32) -> io::Result<()> {
    use std::os::unix::fs::PermissionsExt as _;
    let has_mode = file.metadata()?.permissions().mode() & 0o777 == mode;
    if has_mode { Ok(()) } else { file.set_permissions(fs::Permissions::from_mode(mode)) }
}

#[cfg(not(unix))]
fn temporary_in(folder: &Path, _replaced: Option<&Metadata>) -> io::Result<NamedTempFile> {
    builder().tempfile_in(folder)
}

fn builder() -> Builder<'static, 'static> {
    let mut builder = Builder::new();
    builder.prefix(PREFIX).suffix(SUFFIX).rand_bytes(RANDOM);
    builder
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let entries = fs::read_dir(folder).unwrap();
        let mut names: Vec<String> =
            entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn files_whose_names_differ_after_a_dot_are_written_at_the_same_time() {
        let folder = tempfile::tempdir().unwrap();
        let paths = ["q-0.5", "q-0.7", "q-0"].map(|name| folder.path().join(name));
        let mut files = paths.each_ref().map(|path| AtomicFile::create(path).unwrap());
        for (file, path) in files.iter_mut().zip(&paths) {
            file.write_all(path.to_str().unwrap().as_bytes()).unwrap();
        }
        files.into_iter().for_each(|file| file.commit().unwrap());
        for path in &paths {
            assert_eq!(fs::read_to_string(path).unwrap(), path.to_str().unwrap());
        }
        assert_eq!(names(folder.path()), ["q-0", "q-0.5", "q-0.7"]);
    }

    #[test]
    fn a_file_that_is_given_up_leaves_nothing_and_the_old_one_stays() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("keep.sav");
        write_atomically(&path, b"old").unwrap();
        let mut file = AtomicFile::create(&path).unwrap();
        file.write_all(b"half of the n").unwrap();
        assert_eq!(names(folder.path()).len(), 2);
        drop(file);
        assert_eq!(names(folder.path()), ["keep.sav"]);
        assert_eq!(fs::read(&path).unwrap(), b"old");
    }

    #[test]
    fn a_file_that_cannot_get_its_name_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("state");
        let file = AtomicFile::create(&path).unwrap();
        fs::create_dir(&path).unwrap();
        assert!(file.commit().unwrap_err().to_string().contains("it is a folder"));
        assert!(AtomicFile::create(&folder.path().join("missing/state")).is_err());
        assert!(AtomicFile::create(Path::new("/")).is_err() && AtomicFile::create(Path::new("")).is_err());
        assert_eq!(names(folder.path()), ["state"]);
    }

    #[cfg(unix)]
    #[test]
    fn only_a_regular_file_is_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::write(at("precious"), "precious").unwrap();
        fs::create_dir(at("folder")).unwrap();
        std::os::unix::fs::symlink("precious", at("link")).unwrap();
        std::os::unix::fs::symlink("nowhere", at("dangling")).unwrap();
        let _socket = std::os::unix::net::UnixListener::bind(at("socket")).unwrap();
        let before = names(folder.path());
        for (name, reason) in [
            ("folder", "it is a folder"),
            ("link", "it is a symbolic link; name the file that it leads to, precious"),
            ("dangling", "it is a symbolic link; name the file that it leads to, nowhere"),
            ("socket", "it is a device, a pipe or a socket"),
        ] {
            let error = write_atomically(&at(name), b"new").unwrap_err().to_string();
            assert!(error.contains(reason), "{name}: {error}");
        }
        // It is only begun: a mistake here must not cost the machine its device.
        let error = AtomicFile::create(Path::new("/dev/null")).unwrap_err().to_string();
        assert!(error.contains("it is a device"), "{error}");
        assert_eq!(names(folder.path()), before);
        assert_eq!(fs::read(at("precious")).unwrap(), b"precious");
    }

    #[cfg(unix)]
    #[test]
    fn a_replaced_file_keeps_its_permissions_and_a_new_one_has_the_usual_ones() {
        use std::os::unix::fs::PermissionsExt as _;
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let mode = |name: &str| fs::metadata(at(name)).unwrap().permissions().mode() & 0o777;
        fs::write(at("usual"), "").unwrap();
        write_atomically(&at("new"), b"").unwrap();
        assert_eq!(mode("new"), mode("usual"));
        for kept in [0o600, 0o640, 0o666, 0o400] {
            fs::set_permissions(at("new"), fs::Permissions::from_mode(kept)).unwrap();
            write_atomically(&at("new"), b"again").unwrap();
            assert_eq!(mode("new"), kept);
        }
    }

    #[test]
    fn what_a_killed_program_left_is_removed_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let left = AtomicFile::create(&at("latest.bin")).unwrap();
        // As after SIGKILL: nobody removes it.
        let (_, left) = left.temporary.keep().unwrap();
        assert!(left.exists());
        let kept = [
            ".shield-0123456789a.partial",
            ".shield-0123456789abc.partial",
            ".shield-0123456789a_.partial",
            ".shield-0123456789ab.partial.txt",
            "keep.partial",
            "latest.bin",
        ];
        kept.iter().for_each(|name| fs::write(at(name), "").unwrap());
        fs::create_dir(at(".shield-0123456789ab.partial")).unwrap();
        remove_leftovers(folder.path()).unwrap();
        assert!(!left.exists());
        assert_eq!(names(folder.path()).len(), kept.len() + 1);
    }
}
