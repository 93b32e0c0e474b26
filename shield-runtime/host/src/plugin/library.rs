//! One loaded library: its file is read first, then opened, then every table of it is checked, and only then called.

mod c_entry;
mod load;
mod neighbours;
mod rust_entry;
mod tables;

use std::path::Path;

use shield_api::{
    abi::{AbortRuleTable, EnvironmentTable, LearnerTable, PolicyTable, ResetTaskTable},
    manifest::Manifest,
};

pub(super) use self::tables::{FunctionTable, function_table};
use super::{
    Kind, PluginError,
    file::{LibraryFile, check_pin},
    manifest::{Language, check_manifests, manifests_in, refuse_aborting},
};

/// A library whose tables were checked. It stays in the process for ever: instances and tables point into it.
#[derive(Debug)]
pub struct Library {
    file: LibraryFile,
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
    /// Its values are probabilities.
    SuccessCritic(&'static LearnerTable),
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
        Self::from_file(LibraryFile::open_trusted(path)?, false)
    }

    /// Loads what is in an open file. If its hash was compared with a pin, nothing else than what was hashed is executed.
    pub(super) fn from_file(file: LibraryFile, is_pinned: bool) -> Result<Self, PluginError> {
        Self::enter(file, is_pinned, refuse_aborting)
    }

    /// Loads the library at `path` into a process that may end: one that was built with `panic = "abort"` is welcome. `pinned` is the SHA-256 that
    /// the plugin `id` must have.
    ///
    /// # Errors
    /// As for [`load`](Self::load); the file has another hash.
    pub(super) fn load_isolated(path: &Path, id: &str, pinned: Option<&str>) -> Result<Self, PluginError> {
        let file = LibraryFile::open_trusted(path)?;
        if let Some(pinned) = pinned {
            check_pin(id, pinned, &file)?;
        }
        Self::enter(file, pinned.is_some(), |_, _| Ok(()))
    }

    fn enter(
        file: LibraryFile,
        is_pinned: bool,
        check: impl Fn(&Path, &[Manifest]) -> Result<(), PluginError>,
    ) -> Result<Self, PluginError> {
        let path = file.path();
        let manifests = manifests_in(&file)?;
        let language = check_manifests(path, &manifests)?;
        check(path, &manifests)?;
        let opened = load::open(&file, is_pinned)?;
        let list = match language {
            Language::Rust => rust_entry::enter(path, opened)?,
            Language::C => c_entry::enter(path, opened)?,
        };
        let plugins = tables::check_library(path, list, manifests)?;
        Ok(Self { file, plugins })
    }

    /// The file, as a canonical path.
    pub fn path(&self) -> &Path {
        self.file.path()
    }

    /// The file that was loaded.
    pub(super) fn file(&self) -> &LibraryFile {
        &self.file
    }

    /// What the plugins of the library say of themselves.
    pub fn manifests(&self) -> impl Iterator<Item = &Manifest> {
        self.plugins.iter().map(|plugin| &plugin.manifest)
    }

    /// The functions of the plugin with the given id.
    pub(super) fn table<T: KindTable>(&self, id: &str) -> Result<&'static T, PluginError> {
        self.pick(id, T::KIND, T::pick)
    }

    /// The functions of the success critic with the given id.
    pub(super) fn success_critic_table(&self, id: &str) -> Result<&'static LearnerTable, PluginError> {
        self.pick(id, Kind::SuccessCritic, |table| match table {
            Table::SuccessCritic(table) => Some(table),
            _ => None,
        })
    }

    fn pick<T>(
        &self,
        id: &str,
        wanted: Kind,
        pick: impl Fn(Table) -> Option<&'static T>,
    ) -> Result<&'static T, PluginError> {
        let named = || self.plugins.iter().filter(|plugin| plugin.manifest.id == id);
        if let Some(table) = named().find_map(|plugin| pick(plugin.table)) {
            return Ok(table);
        }
        let (path, id) = (self.path().to_owned(), id.to_string());
        Err(match named().next() {
            Some(other) => PluginError::WrongKind { path, id, found: other.kind, wanted },
            None => {
                let present = self.manifests().map(|manifest| manifest.id.clone()).collect();
                PluginError::NotInFile { path, id, present }
            }
        })
    }
}
