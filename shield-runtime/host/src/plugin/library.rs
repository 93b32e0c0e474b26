//! One loaded library: its file is read first, then opened, then every table of it is checked, and only then called.

mod c_door;
mod rust_door;
mod tables;

use std::path::{Path, PathBuf};

use shield_api::{
    abi::{AbortRuleTable, EnvironmentTable, LearnerTable, PolicyTable, ResetTaskTable},
    manifest::Manifest,
};

pub(super) use self::tables::{FunctionTable, function_table};
use super::{
    Kind, PluginError,
    manifest::{Language, check_manifests, read_manifests, refuse_aborting},
    trust::check_writable,
};

/// A library whose tables were checked. It stays in the process for ever: instances and tables point into it.
#[derive(Debug)]
pub struct Library {
    path: PathBuf,
    plugins: Vec<LoadedPlugin>,
}

/// One plugin of a library.
#[derive(Debug)]
pub(super) struct LoadedPlugin {
    pub(super) manifest: Manifest,
    pub(super) kind: Kind,
    pub(super) table: Table,
}

/// The functions of a plugin.
#[derive(Debug, Clone, Copy)]
pub(super) enum Table {
    Environment(&'static EnvironmentTable),
    Learner(&'static LearnerTable),
    Policy(&'static PolicyTable),
    AbortRule(&'static AbortRuleTable),
    ResetTask(&'static ResetTaskTable),
}

/// The table of one kind.
pub(super) trait KindTable: Sized + 'static {
    const KIND: Kind;

    /// The table, if it is of this kind.
    fn pick(table: Table) -> Option<&'static Self>;
}

macro_rules! kind_tables {
    ($($kind:ident => $table:ty),* $(,)?) => { $(
        impl KindTable for $table {
            const KIND: Kind = Kind::$kind;

            fn pick(table: Table) -> Option<&'static Self> {
                if let Table::$kind(table) = table { Some(table) } else { None }
            }
        }
    )* };
}

kind_tables! {
    Environment => EnvironmentTable,
    Learner => LearnerTable,
    Policy => PolicyTable,
    AbortRule => AbortRuleTable,
    ResetTask => ResetTaskTable,
}

impl Library {
    /// Loads the library at `path`. What its manifest rules out is refused before anything of it is executed.
    ///
    /// # Errors
    /// Each way in which the file, its manifest, its doors or its tables can be wrong is one case of [`PluginError`].
    pub fn load(path: &Path) -> Result<Self, PluginError> {
        Self::enter(path, refuse_aborting)
    }

    /// Loads the library at `path` into a process that may end: one that was built with `panic = "abort"` is welcome.
    ///
    /// # Errors
    /// As for [`load`](Self::load).
    pub(super) fn load_isolated(path: &Path) -> Result<Self, PluginError> {
        Self::enter(path, |_, _| Ok(()))
    }

    fn enter(
        path: &Path,
        check: impl Fn(&Path, &[Manifest]) -> Result<(), PluginError>,
    ) -> Result<Self, PluginError> {
        // The system's loader would look for a bare name in its own folders.
        let path = path
            .canonicalize()
            .map_err(|error| PluginError::Unreadable { path: path.into(), reason: error.to_string() })?;
        let manifests = read_manifests(&path)?;
        let language = check_manifests(&path, &manifests)?;
        check(&path, &manifests)?;
        check_writable(&path)?;
        let opened = open(&path)?;
        let list = match language {
            Language::Rust => rust_door::enter(&path, opened)?,
            Language::C => c_door::enter(&path, opened)?,
        };
        let plugins = tables::check_library(&path, list, manifests)?;
        Ok(Self { path, plugins })
    }

    /// The file, as a canonical path.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// What the plugins of the library say of themselves.
    pub fn manifests(&self) -> impl Iterator<Item = &Manifest> {
        self.plugins.iter().map(|plugin| &plugin.manifest)
    }

    /// The functions of the plugin with the given id.
    pub(super) fn table<T: KindTable>(&self, id: &str) -> Result<&'static T, PluginError> {
        let named = || self.plugins.iter().filter(|plugin| plugin.manifest.id == id);
        if let Some(table) = named().find_map(|plugin| T::pick(plugin.table)) {
            return Ok(table);
        }
        let (path, id) = (self.path.clone(), id.to_string());
        Err(match named().next() {
            Some(other) => PluginError::WrongKind { path, id, found: other.kind, wanted: T::KIND },
            None => {
                let present = self.manifests().map(|manifest| manifest.id.clone()).collect();
                PluginError::NotInFile { path, id, present }
            }
        })
    }
}

/// Opens the library for ever. All symbols are bound at once: bound lazily, an undefined one would end the process at its first
/// call. None is visible to other libraries.
fn open(path: &Path) -> Result<&'static libloading::Library, PluginError> {
    #[cfg(unix)]
    // SAFETY: the library's initialisers run. Its manifest asks to be loaded as a plugin, which is what the user named.
    let opened = unsafe {
        use libloading::os::unix::{Library, RTLD_LOCAL, RTLD_NOW};
        Library::open(Some(path), RTLD_NOW | RTLD_LOCAL).map(libloading::Library::from)
    };
    #[cfg(not(unix))]
    // SAFETY: as above.
    let opened = unsafe { libloading::Library::new(path) };
    match opened {
        Ok(library) => Ok(Box::leak(Box::new(library))),
        Err(error) => {
            // The system's sentence is in the source; the error itself only names the function that failed.
            let cause = std::error::Error::source(&error).map(ToString::to_string);
            Err(PluginError::Open { path: path.into(), reason: cause.unwrap_or_else(|| error.to_string()) })
        }
    }
}
