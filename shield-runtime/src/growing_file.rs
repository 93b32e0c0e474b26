//! Files that grow while a run goes on: tables, events, segments of experience.
//!
//! They are opened without following a link, and only a regular file is written: another program may have put something else in its place
//! since the run was stopped.

use std::{
    fs::{File, OpenOptions},
    io::{self, Seek, SeekFrom},
    path::Path,
};

use crate::atomic_file::ensure_regular;

/// An empty file; what a file of that name had is cut off.
pub(crate) fn begin(path: &Path) -> io::Result<File> {
    let file = open(path, OpenOptions::new().create(true).truncate(false))?;
    cut_back(&file, 0)?;
    Ok(file)
}

/// The file that is there, as it is. It goes on after [`cut_back`].
pub(crate) fn reopen(path: &Path) -> io::Result<File> {
    open(path, &mut OpenOptions::new())
}

/// Cuts off what follows the first `length` bytes, and goes on from there.
pub(crate) fn cut_back(mut file: &File, length: u64) -> io::Result<()> {
    file.set_len(length)?;
    file.seek(SeekFrom::End(0))?;
    Ok(())
}

fn open(path: &Path, options: &mut OpenOptions) -> io::Result<File> {
    match path.symlink_metadata() {
        Err(error) if error.kind() == io::ErrorKind::NotFound => {}
        found => ensure_regular(&found?, path)?,
    }
    // The name may stand for something else by now.
    let file = without_following(options.write(true)).open(path)?;
    ensure_regular(&file.metadata()?, path)?;
    Ok(file)
}

/// Neither follows a link nor waits for the reader of a pipe.
#[cfg(unix)]
pub(crate) fn without_following(options: &mut OpenOptions) -> &mut OpenOptions {
    use rustix::fs::OFlags;
    use std::os::unix::fs::OpenOptionsExt as _;
    options.custom_flags((OFlags::NOFOLLOW | OFlags::NONBLOCK).bits().cast_signed())
}

#[cfg(not(unix))]
pub(crate) fn without_following(options: &mut OpenOptions) -> &mut OpenOptions {
    options
}

#[cfg(test)]
mod tests {
    use std::{fs, io::Write};

    use super::*;

    #[test]
    fn a_file_grows_from_where_it_was_and_loses_what_followed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("metrics.csv");
        assert!(reopen(&path).is_err(), "there is nothing to go on with");
        begin(&path).unwrap().write_all(b"0123456789").unwrap();
        let mut file = reopen(&path).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"0123456789", "opening it changes nothing");
        cut_back(&file, 4).unwrap();
        file.write_all(b"abc").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"0123abc");
        begin(&path).unwrap().write_all(b"x").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"x");
    }

    #[cfg(unix)]
    #[test]
    fn only_a_regular_file_grows() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::write(at("precious"), "precious").unwrap();
        fs::create_dir(at("folder")).unwrap();
        std::os::unix::fs::symlink("precious", at("link")).unwrap();
        std::os::unix::fs::symlink("nowhere", at("dangling")).unwrap();
        let mode = rustix::fs::Mode::RWXU;
        rustix::fs::mknodat(rustix::fs::CWD, at("pipe"), rustix::fs::FileType::Fifo, mode, 0).unwrap();
        for name in ["folder", "link", "dangling", "pipe"] {
            assert!(begin(&at(name)).is_err() && reopen(&at(name)).is_err(), "{name}");
        }
        assert!(!at("nowhere").exists());
        assert_eq!(fs::read(at("precious")).unwrap(), b"precious");
    }
}
