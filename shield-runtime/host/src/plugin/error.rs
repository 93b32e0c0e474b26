//! What can go wrong between an id in an experiment and a running instance.

use std::path::PathBuf;

use shield_api::{
    ErrorKind, Position,
    abi::{ABI_MAJOR, ABI_MINOR},
};
use thiserror::Error;

use super::{Distrust, Kind, trust::ALLOW_WRITABLE};

/// Why a plugin cannot be used. Each message names the file, the values that disagree, and what helps.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum PluginError {
    /// The file or folder cannot be read.
    #[error("{}: cannot be read: {reason}", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system says.
        reason: String,
    },
    /// The file is not a shared library, or is cut short.
    #[error("{}: is not a complete shared library ({reason}); build or copy it again", path.display())]
    NotALibrary {
        /// The file.
        path: PathBuf,
        /// What the parser says.
        reason: String,
    },
    /// The library is somebody else's.
    #[error("{}: has no section `.shield_manifest`, so it is not a plugin; a plugin ends in `export_plugin!` (Rust) or \
             places its manifest with the macro of `shield_plugin.h` (C)", path.display())]
    NoManifest {
        /// The file.
        path: PathBuf,
    },
    /// The manifest cannot be understood.
    #[error("{}: its manifest is malformed: {reason}; rebuild the plugin", path.display())]
    BadManifest {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// The plugin was built against another major version of the interface.
    #[error("{}: the plugin {id:?} speaks interface {}.{}, this host {ABI_MAJOR}.{ABI_MINOR}; rebuild the plugin with \
             shield-api {ABI_MAJOR}, or use the host that belongs to it", path.display(), abi.0, abi.1)]
    Interface {
        /// The file.
        path: PathBuf,
        /// The plugin.
        id: String,
        /// Major and minor version of its interface.
        abi: (u32, u32),
    },
    /// A panic in the plugin would end this process.
    #[error("{}: the plugin {id:?} was built with panic = \"abort\", so that a panic in it would end the whole run; build \
             it with panic = \"unwind\", or give it a process of its own with `isolate: true`", path.display())]
    PanicAborts {
        /// The file.
        path: PathBuf,
        /// The plugin.
        id: String,
    },
    /// Others on this machine could have replaced the library.
    #[error("{}: {distrust}, or set {}=1 if you trust everyone on this machine", path.display(), ALLOW_WRITABLE)]
    Untrusted {
        /// The library.
        path: PathBuf,
        /// Where on the way to it, and who.
        distrust: Distrust,
    },
    /// Somebody wrote into the library, or put another in its place, while it was read or after it was loaded.
    #[error("{}: has changed since this program opened it; start the program again once the file stays as it is", path.display())]
    Changed {
        /// The library.
        path: PathBuf,
    },
    /// The library is not the one that the experiment pins.
    #[error("{}: its SHA-256 is {found}, but the experiment pins {id:?} to {pinned}; nothing of it was executed. Bring the \
             file that was meant or, if you trust this one, pin it with `shield plugin lock`", path.display())]
    NotPinned {
        /// The library.
        path: PathBuf,
        /// The plugin.
        id: String,
        /// What the experiment says.
        pinned: String,
        /// What the file has.
        found: String,
    },
    /// The system's loader refuses the library, for example for an undefined symbol.
    #[error("{}: the system cannot load it: {reason}", path.display())]
    Open {
        /// The file.
        path: PathBuf,
        /// What the loader says.
        reason: String,
    },
    /// The library does not export the symbol through which its language enters.
    #[error("{}: its manifest says {language:?}, but the library does not export `{symbol}`; {remedy}", path.display())]
    NoDoor {
        /// The file.
        path: PathBuf,
        /// The manifest's language.
        language: String,
        /// The symbol that is missing.
        symbol: &'static str,
        /// What helps.
        remedy: &'static str,
    },
    /// The library was built with an `abi_stable` whose own header differs.
    #[error("{}: was built with abi_stable {found}, this host with {expected}; rebuild the plugin with this host's \
             shield-api", path.display())]
    AbiStable {
        /// The file.
        path: PathBuf,
        /// The plugin's version.
        found: String,
        /// This host's.
        expected: String,
    },
    /// The library was built with another major version of the crate `shield-api`.
    #[error("{}: was built with shield-api {found}, this host with {expected}; rebuild the plugin with shield-api \
             {expected}", path.display())]
    InterfaceCrate {
        /// The file.
        path: PathBuf,
        /// The plugin's version.
        found: String,
        /// This host's.
        expected: String,
    },
    /// The library hides the layout of its tables.
    #[error("{}: was built without the description of its tables (`CheckTypeLayout::No`), so they cannot be compared; \
             export it with `export_plugin!`", path.display())]
    Unchecked {
        /// The file.
        path: PathBuf,
    },
    /// A table of the library has another layout than this host's.
    #[error("{}: its tables differ from this host's: {difference}; rebuild the plugin with this host's shield-api",
             path.display())]
    Layout {
        /// The file.
        path: PathBuf,
        /// The first difference, for example a field.
        difference: String,
    },
    /// A table of the library cannot be what it should.
    #[error("{}: {what}; the plugin's tables are not filled as `shield_plugin.h` says", path.display())]
    Table {
        /// The file.
        path: PathBuf,
        /// What is wrong with which table.
        what: String,
    },
    /// The loaded library says something else than the section of its file.
    #[error("{}: the plugin {id:?} says something else once loaded than the manifest in its file ({what}); rebuild it",
             path.display())]
    ManifestDiffers {
        /// The file.
        path: PathBuf,
        /// The plugin.
        id: String,
        /// What differs.
        what: String,
    },
    /// No plugin has that id.
    #[error("there is no {wanted} {id:?}{}; searched: {}", suggestions(similar), or_nothing(searched))]
    UnknownId {
        /// What was asked for.
        id: String,
        /// The kind that was asked for, or `plugin`.
        wanted: &'static str,
        /// Ids that look alike.
        similar: Vec<String>,
        /// Where the host looked, with what it found there.
        searched: Vec<String>,
    },
    /// The plugin exists, but is of another kind.
    #[error("{}: {id:?} is a plugin of kind {found}, but this place of the experiment needs one of kind {wanted}",
             path.display())]
    WrongKind {
        /// The file.
        path: PathBuf,
        /// The plugin.
        id: String,
        /// What it is.
        found: Kind,
        /// What was needed.
        wanted: Kind,
    },
    /// Several plugins have the same id.
    #[error(
        "the id {id:?} is taken more than once, in {}; remove one, or name the file with `path` in the experiment",
        list_paths(paths)
    )]
    DuplicateId {
        /// The id.
        id: String,
        /// The files.
        paths: Vec<PathBuf>,
    },
    /// The file that the experiment names holds other plugins.
    #[error("{}: holds no plugin {id:?}; it holds {}", path.display(), or_nothing(present))]
    NotInFile {
        /// The file.
        path: PathBuf,
        /// What was asked for.
        id: String,
        /// What there is.
        present: Vec<String>,
    },
    /// The plugin refuses its configuration.
    #[error("{id}: {message}")]
    Config {
        /// The plugin.
        id: String,
        /// The plugin's sentence.
        message: String,
        /// Where in the configuration text, if the plugin says so.
        position: Option<Position>,
    },
    /// The instance cannot be made, or describes itself wrongly.
    #[error("{id}: {message}")]
    Create {
        /// The plugin.
        id: String,
        /// The class of the failure.
        kind: ErrorKind,
        /// The sentence.
        message: String,
    },
}

impl PluginError {
    /// The plugin's own sentence about its configuration and where in the configuration's text the fault lies; `None` for every
    /// other error.
    pub fn config_fault(&self) -> Option<(&str, Option<Position>)> {
        match self {
            Self::Config { message, position, .. } => Some((message, *position)),
            _ => None,
        }
    }
}

fn suggestions(similar: &[String]) -> String {
    if similar.is_empty() { String::new() } else { format!("; did you mean {}?", similar.join(" or ")) }
}

fn or_nothing(items: &[String]) -> String {
    if items.is_empty() { "nothing".into() } else { items.join(", ") }
}

fn list_paths(paths: &[PathBuf]) -> String {
    let names: Vec<_> = paths.iter().map(|path| path.display().to_string()).collect();
    names.join(" and ")
}
