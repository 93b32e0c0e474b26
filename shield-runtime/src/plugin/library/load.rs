//! Handing a library to the system's loader, so that it loads the file that was checked.

use std::{
    collections::BTreeMap,
    error::Error as _,
    fs::File,
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
};

use libloading::os::unix::{Library, RTLD_LOCAL, RTLD_NOW};

use super::{PluginError, neighbours};
use crate::plugin::file::{Content, FileNumber, LibraryFile};

/// What the system's loader has loaded. It knows a file by its number, and for a second file of the same number it gives the first library again,
/// whatever is in the file by then.
static LOADED: Mutex<BTreeMap<FileNumber, Loaded>> = Mutex::new(BTreeMap::new());

/// A library that is never unloaded.
struct Loaded {
    content: Content,
    exact: Option<Exact>,
}

/// A name that leads the loader to an open file. It keeps the name, so the descriptor stays open: the loader would take another file of this name for
/// the same library.
struct Exact {
    name: PathBuf,
    _descriptor: File,
}

/// Loads the library for ever. A pinned one is loaded from the open file that was hashed, and nothing else is executed. For another, the loader opens
/// the path again; a file that was put there meanwhile is an error afterwards.
pub(super) fn open(file: &LibraryFile, is_pinned: bool) -> Result<&'static libloading::Library, PluginError> {
    let (path, number) = (file.path(), file.number()?);
    let neighbours = neighbours::beside(file)?;
    let mut loaded = LOADED.lock().unwrap_or_else(PoisonError::into_inner);
    if loaded.get(&number).is_some_and(|earlier| earlier.content != file.content()) {
        return Err(PluginError::Changed { path: path.into() });
    }
    let exact = if is_pinned { exact_name(file, &loaded)? } else { None };
    if exact.is_some() {
        // Under that name, the library does not lie beside them.
        neighbours.iter().try_for_each(|neighbour| load_for_ever(neighbour, neighbour).map(drop))?;
    }
    let library = load_for_ever(exact.as_ref().map_or(path, |exact| &exact.name), path)?;
    let is_exact = exact.is_some();
    let entry = loaded.entry(number).or_insert(Loaded { content: file.content(), exact: None });
    if entry.exact.is_none() {
        entry.exact = exact;
    }
    if is_exact { file.check_unchanged() } else { file.check_in_place() }?;
    Ok(library)
}

/// `/proc/<process>/fd/<n>`, through which Linux opens a file that is open already.
#[cfg(target_os = "linux")]
fn exact_name(
    file: &LibraryFile,
    loaded: &BTreeMap<FileNumber, Loaded>,
) -> Result<Option<Exact>, PluginError> {
    use std::{io, os::fd::AsRawFd as _};

    let is_taken = |name: &Path| {
        loaded.values().any(|other| other.exact.as_ref().is_some_and(|exact| exact.name == name))
    };
    let find = || -> io::Result<Exact> {
        // A debugger finds the file by the number of the process, which may be another here than in `/proc`.
        let descriptors = Path::new("/proc").join(std::fs::read_link("/proc/self")?).join("fd");
        let mut passed_over = Vec::new();
        loop {
            let descriptor = file.file().try_clone()?;
            let name = descriptors.join(descriptor.as_raw_fd().to_string());
            name.metadata()?;
            if !is_taken(&name) {
                return Ok(Exact { name, _descriptor: descriptor });
            }
            // Somebody closed the descriptor behind our back.
            passed_over.push(descriptor);
        }
    };
    find().map(Some).map_err(|error| PluginError::Open {
        path: file.path().into(),
        reason: format!(
            "a pinned library is loaded by its descriptor in /proc, which cannot be reached: {error}"
        ),
    })
}

/// Other systems load libraries by their path alone.
#[cfg(not(target_os = "linux"))]
fn exact_name(
    _file: &LibraryFile,
    _loaded: &BTreeMap<FileNumber, Loaded>,
) -> Result<Option<Exact>, PluginError> {
    Ok(None)
}

/// Loads the library of that name, which errors call `path`. All symbols are bound at once: bound lazily, an undefined one would end the process at
/// its first call. None is visible to other libraries.
fn load_for_ever(name: &Path, path: &Path) -> Result<&'static libloading::Library, PluginError> {
    // SAFETY: the library's initialisers run. Its manifest asks to be loaded as a plugin, which is what the user named; or a plugin needs it.
    let opened = unsafe { Library::open(Some(name), RTLD_NOW | RTLD_LOCAL) };
    opened.map(|library| &*Box::leak(Box::new(library.into()))).map_err(|error| {
        // The system's sentence is in the source; the error itself only names the function that failed.
        let cause = error.source().map_or_else(|| error.to_string(), ToString::to_string);
        let (name, shown) = (name.display().to_string(), path.display().to_string());
        PluginError::Open { path: path.into(), reason: cause.replace(&name, &shown) }
    })
}

/// Whether the loader has a library of that bare name, which every library that needs the name then shares.
pub(super) fn is_loaded(name: &str) -> bool {
    // SAFETY: nothing is loaded, so no initialiser runs; the library is there before and after.
    unsafe { Library::open(Some(name), RTLD_NOW | libc::RTLD_NOLOAD) }.is_ok()
}
