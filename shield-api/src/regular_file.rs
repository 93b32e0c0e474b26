//! Reading files that a user names. A path may lead to a named pipe or a device, and opening or reading those can wait for ever. These functions
//! read regular files alone, also through links, and give an error for everything else.

use std::{
    fs::{self, File, FileType},
    io::{self, Read},
    path::Path,
};

/// Opens the regular file at `path` for reading. Never waits for another program.
///
/// # Errors
/// The file cannot be opened, or is a folder, a named pipe, a device or a socket.
///
/// ```
/// let folder = std::env::temp_dir();
/// let error = shield_api::regular_file::open(folder).unwrap_err();
/// assert_eq!(error.to_string(), "it is a folder; name a regular file");
/// ```
pub fn open(path: impl AsRef<Path>) -> io::Result<File> {
    let path = path.as_ref();
    // Opening a device may do something by itself, so the type is checked first.
    check_type(fs::metadata(path)?.file_type())?;
    let mut options = File::options();
    options.read(true);
    // Something else may be there by now.
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::custom_flags(&mut options, libc::O_NONBLOCK | libc::O_NOCTTY);
    let file = options.open(path)?;
    check_type(file.metadata()?.file_type())?;
    Ok(file)
}

/// The bytes of the regular file at `path`, like [`std::fs::read`].
///
/// # Errors
/// As for [`open`]; or the file cannot be read.
pub fn read(path: impl AsRef<Path>) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    open(path)?.read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// The text of the regular file at `path`, like [`std::fs::read_to_string`].
///
/// # Errors
/// As for [`read`]; or the file is not UTF-8 text.
pub fn read_to_string(path: impl AsRef<Path>) -> io::Result<String> {
    let mut text = String::new();
    open(path)?.read_to_string(&mut text)?;
    Ok(text)
}

fn check_type(found: FileType) -> io::Result<()> {
    if found.is_file() {
        return Ok(());
    }
    let kind = if found.is_dir() { io::ErrorKind::IsADirectory } else { io::ErrorKind::InvalidInput };
    Err(io::Error::new(kind, format!("it is {}; name a regular file", name(found))))
}

fn name(found: FileType) -> &'static str {
    #[cfg(unix)]
    {
        use std::os::unix::fs::FileTypeExt as _;
        if found.is_fifo() {
            return "a named pipe";
        }
        if found.is_socket() {
            return "a socket";
        }
        if found.is_char_device() || found.is_block_device() {
            return "a device";
        }
    }
    if found.is_dir() { "a folder" } else { "not a regular file" }
}

#[cfg(all(test, unix))]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use std::{
        os::unix::{fs::symlink, net::UnixListener},
        process::Command,
    };

    use super::*;

    #[test]
    fn only_a_regular_file_is_read_and_everything_else_is_an_error_that_says_what_it_is() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        assert!(Command::new("mkfifo").arg(at("pipe")).status().unwrap().success());
        let _listening = UnixListener::bind(at("socket")).unwrap();
        symlink("pipe", at("link to a pipe")).unwrap();
        symlink("/dev/zero", at("link to a device")).unwrap();
        for (path, expected) in [
            ("pipe", "it is a named pipe"),
            ("link to a pipe", "it is a named pipe"),
            ("link to a device", "it is a device"),
            ("socket", "it is a socket"),
            (".", "it is a folder"),
        ] {
            let message = read(at(path)).unwrap_err().to_string();
            assert!(message.starts_with(expected) && message.ends_with("name a regular file"), "{message}");
        }
        fs::write(at("file"), "text").unwrap();
        symlink("file", at("link")).unwrap();
        assert_eq!(read(at("link")).unwrap(), b"text");
        assert_eq!(read_to_string(at("file")).unwrap(), "text");
        assert_eq!(read(at("gone")).unwrap_err().kind(), io::ErrorKind::NotFound);
    }
}
