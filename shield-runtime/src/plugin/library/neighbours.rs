//! The libraries that a plugin brings along, such as MuJoCo's: its run path names `$ORIGIN`, the folder in which it lies.

use std::{
    collections::BTreeSet,
    env,
    ffi::OsStr,
    os::unix::ffi::OsStrExt as _,
    path::{Path, PathBuf},
};

use object::{
    File, ReadCache, ReadRef, elf,
    read::elf::{Dyn as _, ElfFile, FileHeader},
};

use super::{PluginError, load::is_loaded};
use crate::plugin::{file::LibraryFile, trust::check_trust};

/// The libraries that `library` needs and the system's loader would find by `$ORIGIN`, but for those that are loaded already. Whoever could replace
/// one of them, or one that they need in turn, could decide what runs, so each must be trusted.
pub(super) fn beside(library: &LibraryFile) -> Result<Vec<PathBuf>, PluginError> {
    let direct = neighbours(library)?;
    let (mut seen, mut waiting) = (BTreeSet::new(), direct.clone());
    while let Some(path) = waiting.pop() {
        if seen.insert(path.clone()) {
            check_trust(&path)?;
            // As the loader does, from the folder that the path names, even if it is a link.
            waiting.extend(neighbours(&LibraryFile::open(&path)?)?);
        }
    }
    Ok(direct)
}

fn neighbours(library: &LibraryFile) -> Result<Vec<PathBuf>, PluginError> {
    let path = library.path();
    let needs = needs(library)
        .map_err(|error| PluginError::NotALibrary { path: path.into(), reason: error.to_string() })?;
    let folder = path.parent().unwrap_or(Path::new("/"));
    let named = needs.names.iter().filter(|name| !name.contains('/') && !is_loaded(name));
    Ok(named.filter_map(|name| needs.find(name, folder)).collect())
}

/// What a library says to the loader.
#[derive(Debug, Default)]
struct Needs {
    /// The libraries that it needs.
    names: Vec<String>,
    /// `DT_RUNPATH`: where to look after `LD_LIBRARY_PATH`.
    run_path: Option<Vec<u8>>,
    /// `DT_RPATH`: where to look before it, if there is no `DT_RUNPATH`.
    early_run_path: Option<Vec<u8>>,
}

impl Needs {
    /// Where the loader finds the library of that name, if it is by `$ORIGIN`.
    fn find(&self, name: &str, folder: &Path) -> Option<PathBuf> {
        let variable = env::var_os("LD_LIBRARY_PATH").unwrap_or_default();
        let variable = places(variable.as_bytes(), folder);
        let places = match (&self.run_path, &self.early_run_path) {
            (Some(late), _) => [variable, places(late, folder)].concat(),
            (None, Some(early)) => [places(early, folder), variable].concat(),
            (None, None) => return None,
        };
        let found = places.into_iter().find(|place| place.folder.join(name).is_file())?;
        found.is_origin.then(|| found.folder.join(name))
    }
}

#[derive(Debug, Clone)]
struct Place {
    folder: PathBuf,
    is_origin: bool,
}

/// The folders of a run path.
fn places(run_path: &[u8], folder: &Path) -> Vec<Place> {
    let parts = run_path.split(|byte| *byte == b':').filter(|part| !part.is_empty());
    let place = |part: &[u8]| {
        let after = [&b"$ORIGIN"[..], b"${ORIGIN}"].iter().find_map(|origin| part.strip_prefix(*origin));
        match after {
            Some(rest) => {
                let whole = [folder.as_os_str().as_bytes(), rest].concat();
                Place { folder: OsStr::from_bytes(&whole).into(), is_origin: true }
            }
            None => Place { folder: OsStr::from_bytes(part).into(), is_origin: false },
        }
    };
    parts.map(place).collect()
}

fn needs(library: &LibraryFile) -> object::Result<Needs> {
    let cache = ReadCache::new(library.file());
    match File::parse(&cache)? {
        File::Elf64(file) => needs_of(&file),
        File::Elf32(file) => needs_of(&file),
        _ => Ok(Needs::default()),
    }
}

fn needs_of<'data, Elf: FileHeader, R: ReadRef<'data>>(
    file: &ElfFile<'data, Elf, R>,
) -> object::Result<Needs> {
    let (endian, data, sections) = (file.endian(), file.data(), file.elf_section_table());
    let mut needs = Needs::default();
    let Some((entries, link)) = sections.dynamic(endian, data)? else { return Ok(needs) };
    let strings = sections.strings(endian, data, link)?;
    for entry in entries {
        let text = || entry.string(endian, strings);
        match entry.tag(endian) {
            elf::DT_NEEDED => needs.names.push(String::from_utf8_lossy(text()?).into_owned()),
            elf::DT_RUNPATH => needs.run_path = Some(text()?.to_vec()),
            elf::DT_RPATH => needs.early_run_path = Some(text()?.to_vec()),
            elf::DT_NULL => break,
            _ => {}
        }
    }
    Ok(needs)
}
