//! The file of a checkpoint: a header that tells what it is, a checksum, and the body.

use std::{
    fs::{self, File},
    io::{self, Write},
    path::{Path, PathBuf},
};

use serde::{Serialize, de::DeserializeOwned};
use shield_api::regular_file;

use crate::atomic_file::AtomicFile;

const MAGIC: &[u8; 8] = b"SHIELDCP";
/// Format of a run's checkpoint. To be raised with every change of what is saved, as the next one is: a body does not describe itself.
pub const RUN: u32 = 3;
/// Format of what a drop-in has learned.
pub const DROP_IN: u32 = 2;
/// Magic, version, length of the body, its checksum.
const HEADER: usize = 8 + 4 + 8 + 4;

/// What a state file gives.
pub type Result<T> = std::result::Result<T, CheckpointError>;

/// Why a checkpoint cannot be written or used.
#[derive(Debug, thiserror::Error)]
pub enum CheckpointError {
    /// A file cannot be written or read.
    #[error("{path}: {error}")]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What the system says.
        error: io::Error,
    },
    /// It is not a checkpoint.
    #[error("{path} is not a checkpoint of a run")]
    Foreign {
        /// The file.
        path: PathBuf,
    },
    /// Another version of the program wrote it.
    #[error("{path} has checkpoint format {found}, this program reads format {read}")]
    Version {
        /// The file.
        path: PathBuf,
        /// Its format.
        found: u32,
        /// The one that it should have.
        read: u32,
    },
    /// It is incomplete or damaged.
    #[error("{path} is damaged: {what}")]
    Torn {
        /// The file.
        path: PathBuf,
        /// In which way.
        what: &'static str,
    },
    /// A plugin is not what it was when the checkpoint was written.
    #[error("{path} was written with {was}; now there is {is}")]
    Plugin {
        /// The file.
        path: PathBuf,
        /// The plugin then.
        was: String,
        /// The plugin now.
        is: String,
    },
    /// It belongs to a run of another configuration.
    #[error("{path} belongs to a run with another configuration: {difference}")]
    Config {
        /// The file.
        path: PathBuf,
        /// The first field that differs.
        difference: String,
    },
    /// Another process writes the run.
    #[error("{path} is being written by another process")]
    Busy {
        /// The folder of the checkpoints.
        path: PathBuf,
    },
    /// A plugin refuses its state, or ended while it loaded it.
    #[error("{path} is refused: {error}")]
    Refused {
        /// The file.
        path: PathBuf,
        /// What the plugin says.
        error: shield_api::Error,
    },
    /// The lock is a link, a folder or a device.
    #[error("{path} is not a regular file; a lock must be one")]
    IrregularLock {
        /// The lock.
        path: PathBuf,
    },
}

/// What helps where a run cannot go on.
pub const BEGIN_ANEW: &str =
    "move the folder aside, or begin anew with `shield run` and --overwrite, which removes it";

impl CheckpointError {
    /// What the system says of a file.
    pub fn io(path: &Path, error: io::Error) -> Self {
        Self::Io { path: path.to_owned(), error }
    }

    /// Whether what was saved is bad, so that the checkpoint before it may do. A file that is missing or cannot be read is not: once that is
    /// put right, this checkpoint is as good as ever. Neither is another version.
    pub fn is_damage(&self) -> bool {
        matches!(self, Self::Foreign { .. } | Self::Torn { .. } | Self::Refused { .. })
    }

    /// What the user can do about it.
    pub fn remedy(&self) -> String {
        match self {
            Self::Io { error, .. } if error.kind() == io::ErrorKind::NotFound => {
                format!("put the file back, or {BEGIN_ANEW}")
            }
            Self::Io { .. } => "remove the cause, then give the same command again".into(),
            Self::Foreign { .. } | Self::Torn { .. } | Self::Refused { .. } => BEGIN_ANEW.into(),
            Self::Version { .. } => {
                format!("go on with the version of shield that wrote it, or {BEGIN_ANEW}")
            }
            Self::Plugin { .. } => format!("install the plugin that wrote it, or {BEGIN_ANEW}"),
            Self::Config { .. } => format!("go on with the configuration of the run, or {BEGIN_ANEW}"),
            Self::Busy { .. } => "wait until that process has ended".into(),
            Self::IrregularLock { .. } => "remove it if no other process writes the run".into(),
        }
    }
}

/// Writes `body` to `path` in one step: a reader finds the old file or the new one. The old one becomes `previous`, if that is given.
pub fn write(path: &Path, format: u32, previous: Option<&Path>, body: &impl Serialize) -> Result<()> {
    let mut bytes = vec![0; HEADER];
    bytes = postcard::to_extend(body, bytes)
        .map_err(|error| CheckpointError::io(path, io::Error::other(error)))?;
    let length = (bytes.len() - HEADER) as u64;
    let checksum = crc32fast::hash(&bytes[HEADER..]);
    bytes[..8].copy_from_slice(MAGIC);
    bytes[8..12].copy_from_slice(&format.to_le_bytes());
    bytes[12..20].copy_from_slice(&length.to_le_bytes());
    bytes[20..24].copy_from_slice(&checksum.to_le_bytes());

    let write = || {
        let mut file = AtomicFile::create(path)?;
        file.write_all(&bytes)?;
        file.sync()?;
        if let Some(previous) = previous.filter(|_| path.exists()) {
            fs::rename(path, previous)?;
        }
        file.commit()
    };
    write().map_err(|error| CheckpointError::io(path, error))?;
    path.parent().map_or(Ok(()), sync_folder)
}

/// Reads what [`write`] wrote in the same format.
pub fn read<T: DeserializeOwned>(path: &Path, format: u32) -> Result<T> {
    let bytes = regular_file::read(path).map_err(|error| CheckpointError::io(path, error))?;
    let torn = |what| CheckpointError::Torn { path: path.to_owned(), what };
    if !bytes.starts_with(MAGIC) {
        return Err(CheckpointError::Foreign { path: path.to_owned() });
    }
    let mut rest = &bytes[MAGIC.len()..];
    let cut = || torn("it ends too early");
    let found = u32::from_le_bytes(take(&mut rest).ok_or_else(cut)?);
    if found != format {
        return Err(CheckpointError::Version { path: path.to_owned(), found, read: format });
    }
    let length = u64::from_le_bytes(take(&mut rest).ok_or_else(cut)?);
    let checksum = u32::from_le_bytes(take(&mut rest).ok_or_else(cut)?);
    if rest.len() as u64 != length {
        return Err(torn("its length is wrong"));
    }
    if crc32fast::hash(rest) != checksum {
        return Err(torn("its checksum is wrong"));
    }
    postcard::from_bytes(rest).map_err(|_| torn("it cannot be understood"))
}

fn take<const N: usize>(rest: &mut &[u8]) -> Option<[u8; N]> {
    let (value, after) = rest.split_first_chunk()?;
    *rest = after;
    Some(*value)
}

/// Makes new names in a folder last.
pub fn sync_folder(folder: &Path) -> Result<()> {
    // Only Unix can sync a folder; elsewhere the file system does what it does.
    if cfg!(unix) {
        let synced = File::open(folder).and_then(|folder| folder.sync_all());
        synced.map_err(|error| CheckpointError::io(folder, error))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written() -> (tempfile::TempDir, PathBuf, Vec<u8>) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("latest.bin");
        write(&path, RUN, Some(&folder.path().join("previous.bin")), &vec![7u32; 50]).unwrap();
        let bytes = fs::read(&path).unwrap();
        (folder, path, bytes)
    }

    #[test]
    fn a_written_file_is_read_back_and_the_previous_one_kept() {
        let (folder, path, _) = written();
        let previous = folder.path().join("previous.bin");
        write(&path, RUN, Some(&previous), &vec![8u32; 3]).unwrap();
        assert_eq!(read::<Vec<u32>>(&path, RUN).unwrap(), [8; 3]);
        assert_eq!(read::<Vec<u32>>(&previous, RUN).unwrap(), [7; 50]);
    }

    #[test]
    fn every_truncation_and_every_flipped_byte_is_refused() {
        let (_folder, path, bytes) = written();
        for length in 0..bytes.len() {
            fs::write(&path, &bytes[..length]).unwrap();
            assert!(read::<Vec<u32>>(&path, RUN).unwrap_err().is_damage(), "{length} bytes were accepted");
        }
        for index in 0..bytes.len() {
            let mut damaged = bytes.clone();
            damaged[index] ^= 0x10;
            fs::write(&path, &damaged).unwrap();
            assert!(read::<Vec<u32>>(&path, RUN).is_err(), "a flipped byte {index} was accepted");
        }
    }

    #[test]
    fn another_format_is_named_and_is_no_damage() {
        let (_folder, path, mut bytes) = written();
        let error = read::<Vec<u32>>(&path, DROP_IN).unwrap_err();
        let message = error.to_string();
        assert!(message.contains("format 3, this program reads format 2") && !error.is_damage(), "{message}");
        bytes[8] = 9;
        fs::write(&path, &bytes).unwrap();
        let error = read::<Vec<u32>>(&path, RUN).unwrap_err();
        assert!(error.to_string().contains("format 9") && !error.is_damage(), "{error}");
    }
}
