//! What a launch made on disk, so that it can take it back.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use anyhow::{Context, Result, anyhow};

use super::files;

/// The folder of a run that one launch began. Nothing else may ever be removed by it.
#[derive(Debug)]
pub struct NewFolder {
    path: PathBuf,
    /// The folder was not there before.
    is_own: bool,
}

impl NewFolder {
    pub(super) fn new(path: &Path, is_own: bool) -> Self {
        Self { path: path.to_owned(), is_own }
    }

    /// Removes what the launch wrote, and the folder if the launch made it. If the folder holds anything that a run does not write,
    /// everything stays.
    ///
    /// # Errors
    /// Something cannot be read or removed.
    pub fn discard(&self) -> Result<()> {
        let path = &self.path;
        self.remove().with_context(|| format!("{} cannot be removed", path.display()))
    }

    /// The same after a failure, whose `error` then also says what could not be removed.
    pub(super) fn discard_after(&self, error: anyhow::Error) -> anyhow::Error {
        match self.discard() {
            Ok(()) => error,
            Err(kept) => anyhow!("{error:#}; and {kept:#}"),
        }
    }

    fn remove(&self) -> io::Result<()> {
        let mut found = Found::default();
        found.collect(&self.path, Path::new(""))?;
        if found.has_others {
            return Ok(());
        }
        found.files.iter().try_for_each(fs::remove_file)?;
        // Only empty folders are removed: what somebody put there meanwhile stays.
        found.folders.iter().try_for_each(fs::remove_dir)?;
        if self.is_own { fs::remove_dir(&self.path) } else { Ok(()) }
    }
}

/// What is in the folder of a run.
#[derive(Default)]
struct Found {
    files: Vec<PathBuf>,
    /// Inner folders before outer ones.
    folders: Vec<PathBuf>,
    has_others: bool,
}

impl Found {
    fn collect(&mut self, run: &Path, inside: &Path) -> io::Result<()> {
        for entry in fs::read_dir(run.join(inside))? {
            let entry = entry?;
            let (name, kind) = (inside.join(entry.file_name()), entry.file_type()?);
            if kind.is_file() && is_of_a_run(&name) {
                self.files.push(entry.path());
            } else if kind.is_dir() && FOLDERS.iter().any(|folder| name == Path::new(folder)) {
                self.collect(run, &name)?;
                self.folders.push(entry.path());
            } else {
                self.has_others = true;
            }
        }
        Ok(())
    }
}

/// Whether a run writes a file of that name.
fn is_of_a_run(name: &Path) -> bool {
    let Some(name) = name.to_str() else { return false };
    let is_numbered = |first: &str, last: &str| {
        let number = name.strip_prefix(first).and_then(|rest| rest.strip_suffix(last));
        number.is_some_and(|number| number.bytes().all(|byte| byte.is_ascii_digit()))
    };
    files::NAMES.contains(&name)
        || OTHERS.contains(&name)
        || is_numbered("decisions/part-", ".parquet")
        || is_numbered("checkpoint/experience-", ".rows")
}

/// What a run writes besides the files that grow and the numbered ones.
const OTHERS: [&str; 6] = [
    "config.ron",
    "plugins.json",
    "summary.json",
    "checkpoint/lock",
    "checkpoint/latest.bin",
    "checkpoint/previous.bin",
];

/// The folders in the folder of a run.
const FOLDERS: [&str; 3] = ["tensorboard", "decisions", "checkpoint"];

#[cfg(test)]
mod tests {
    use super::*;

    /// A folder with everything that a run writes.
    fn written() -> tempfile::TempDir {
        let run = tempfile::tempdir().unwrap();
        FOLDERS.iter().for_each(|folder| fs::create_dir(run.path().join(folder)).unwrap());
        let numbered = ["decisions/part-000001.parquet", "checkpoint/experience-000000000000.rows"];
        for name in files::NAMES.iter().chain(&OTHERS).chain(&numbered) {
            fs::write(run.path().join(name), name).unwrap();
        }
        run
    }

    #[test]
    fn a_folder_with_nothing_else_goes() {
        let run = written();
        NewFolder::new(run.path(), true).discard().unwrap();
        assert!(!run.path().exists());
    }

    #[test]
    fn a_folder_that_was_there_before_is_empty_again() {
        let run = written();
        NewFolder::new(run.path(), false).discard().unwrap();
        assert_eq!(fs::read_dir(run.path()).unwrap().count(), 0);
    }

    #[test]
    fn everything_stays_where_there_is_something_else() {
        for name in [
            "notes.txt",
            "config.partial",
            "checkpoint/part-000001.parquet",
            "decisions/part-first.parquet",
            "checkpoint/refused-1.bin",
            "pictures/a.png",
        ] {
            let run = written();
            let path = run.path().join(name);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(&path, "mine").unwrap();
            NewFolder::new(run.path(), true).discard().unwrap();
            assert!(path.exists() && run.path().join("config.ron").exists(), "{name}");
        }
    }

    #[test]
    #[cfg(unix)]
    fn a_link_is_something_else() {
        let run = written();
        let elsewhere = tempfile::tempdir().unwrap();
        fs::write(elsewhere.path().join("lock"), "mine").unwrap();
        fs::remove_dir_all(run.path().join("checkpoint")).unwrap();
        std::os::unix::fs::symlink(elsewhere.path(), run.path().join("checkpoint")).unwrap();
        NewFolder::new(run.path(), true).discard().unwrap();
        assert!(elsewhere.path().join("lock").exists() && run.path().join("config.ron").exists());
    }
}
