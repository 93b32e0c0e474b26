//! Finding plugins by id among the folders of the search path.

mod instances;

use std::{
    collections::{BTreeMap, HashMap, HashSet},
    env::consts::{DLL_PREFIX, DLL_SUFFIX},
    fs,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError},
};

use shield_api::{manifest::Manifest, regular_file};

use super::{
    Entry, Identity, Kind, PluginError, SearchPath, Selection, Skipped,
    file::{Fingerprints, LibraryFile},
    library::Library,
    manifest::{check_manifests, manifests_in, read_manifests, refuse_aborting},
    trust::check_trust,
};

/// The plugins of a search path, and the libraries that were loaded so far. Several threads may use one registry.
#[derive(Debug, Default)]
pub struct Registry {
    entries: Vec<Entry>,
    skipped: Vec<Skipped>,
    searched: Vec<String>,
    libraries: Mutex<HashMap<PathBuf, Arc<Library>>>,
    fingerprints: Fingerprints,
}

impl Registry {
    /// Reads the manifests of every library in the folders; executes nothing. What cannot be read is kept in
    /// [`skipped`](Self::skipped) with its reason.
    pub fn scan(search_path: &SearchPath) -> Self {
        let mut registry = Self::default();
        let mut seen = HashSet::new();
        for folder in search_path.folders() {
            match libraries_in(folder) {
                Ok(paths) => {
                    registry.searched.push(folder.display().to_string());
                    paths.iter().for_each(|path| registry.add(path, &mut seen));
                }
                Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                    registry.searched.push(format!("{} (no such folder)", folder.display()));
                }
                Err(error) => {
                    registry.searched.push(format!("{} ({error})", folder.display()));
                    let reason = PluginError::Unreadable { path: folder.clone(), reason: error.to_string() };
                    registry.skipped.push(Skipped { path: folder.clone(), ids: Vec::new(), reason });
                }
            }
        }
        registry
    }

    /// Adds the library that the search path has as `named`, unless the file it leads to was `seen`.
    fn add(&mut self, named: &Path, seen: &mut HashSet<PathBuf>) {
        // A dangling link stays as it is and is reported as unreadable.
        let path = named.canonicalize().unwrap_or_else(|_| named.into());
        if seen.contains(named) || seen.contains(&path) {
            return;
        }
        let mut skip = |ids, reason| {
            // Another way to the same file may be trusted.
            let is_way = matches!(reason, PluginError::Untrusted { .. });
            seen.insert(if is_way { named.into() } else { path.clone() });
            self.skipped.push(Skipped { path: named.into(), ids, reason });
        };
        let manifests = match read_manifests(&path) {
            Ok(manifests) => manifests,
            Err(reason) => return skip(Vec::new(), reason),
        };
        let is_known = |entry: &Entry| manifests.iter().any(|manifest| manifest.id == entry.manifest.id);
        if self.entries.iter().any(|entry| is_known(entry) && is_same_content(&entry.path, &path)) {
            return;
        }
        let checked = check_manifests(&path, &manifests)
            .and_then(|_| refuse_aborting(&path, &manifests))
            .and_then(|()| check_trust(named));
        if let Err(reason) = checked {
            let ids = manifests.into_iter().map(|manifest| manifest.id).collect();
            return skip(ids, reason);
        }
        // The kinds were checked above.
        self.entries.extend(manifests.into_iter().filter_map(|manifest| Entry::new(&path, manifest).ok()));
        seen.insert(path);
    }

    /// Every plugin that was found, in the order of the search path; also those whose id is taken twice.
    pub fn entries(&self) -> &[Entry] {
        &self.entries
    }

    /// What was passed over, and why.
    pub fn skipped(&self) -> &[Skipped] {
        &self.skipped
    }

    /// One error for each id that is taken more than once.
    pub fn duplicates(&self) -> Vec<PluginError> {
        let mut paths: BTreeMap<&str, Vec<PathBuf>> = BTreeMap::new();
        for entry in &self.entries {
            paths.entry(&entry.manifest.id).or_default().push(entry.path.clone());
        }
        paths
            .into_iter()
            .filter(|(_, paths)| paths.len() > 1)
            .map(|(id, paths)| PluginError::DuplicateId { id: id.into(), paths })
            .collect()
    }

    /// The plugin of that id.
    ///
    /// # Errors
    /// No plugin has the id (the message suggests similar ones and says where it was looked for), several have it, it is of
    /// another kind, or its file was passed over.
    pub fn find(&self, id: &str, wanted: Kind) -> Result<&Entry, PluginError> {
        let found: Vec<&Entry> = self.entries.iter().filter(|entry| entry.manifest.id == id).collect();
        match found[..] {
            [entry] if entry.kind == wanted => Ok(entry),
            [entry] => Err(PluginError::WrongKind {
                path: entry.path.clone(),
                id: id.into(),
                found: entry.kind,
                wanted,
            }),
            [] => Err(self.unknown(id, Some(wanted))),
            _ => Err(PluginError::DuplicateId {
                id: id.into(),
                paths: found.into_iter().map(|entry| entry.path.clone()).collect(),
            }),
        }
    }

    /// What a user means by `plugin`: every plugin of the library, if there is such a file; else every plugin of that id, of whatever kind
    /// and in however many files. Executes nothing.
    ///
    /// # Errors
    /// The file cannot be read or has a plugin of an unknown kind; there is no such id, or its file was passed over.
    pub fn named(&self, plugin: &str) -> Result<Vec<Entry>, PluginError> {
        let path = Path::new(plugin);
        if path.is_file() {
            return read_manifests(path)?.into_iter().map(|manifest| Entry::new(path, manifest)).collect();
        }
        let found: Vec<Entry> =
            self.entries.iter().filter(|entry| entry.manifest.id == plugin).cloned().collect();
        if found.is_empty() { Err(self.unknown(plugin, None)) } else { Ok(found) }
    }

    fn unknown(&self, id: &str, wanted: Option<Kind>) -> PluginError {
        if let Some(skipped) = self.skipped.iter().find(|skipped| skipped.ids.iter().any(|other| other == id))
        {
            return skipped.reason.clone();
        }
        let mut similar: Vec<(f64, &str)> = self
            .entries
            .iter()
            .filter(|entry| wanted.is_none_or(|wanted| entry.kind == wanted))
            .map(|entry| (likeness(id, &entry.manifest.id), entry.manifest.id.as_str()))
            .filter(|(likeness, _)| *likeness >= 0.5)
            .collect();
        similar.sort_by(|left, right| right.0.total_cmp(&left.0));
        PluginError::UnknownId {
            id: id.into(),
            wanted: wanted.map_or("plugin", Kind::name),
            similar: similar.into_iter().take(3).map(|(_, id)| format!("{id:?}")).collect(),
            searched: self.searched.clone(),
        }
    }

    /// The file of the plugin that a choice means, and what it says of itself there. Executes nothing.
    ///
    /// # Errors
    /// No file holds it, or the file cannot be read.
    pub fn entry(&self, choice: &Selection, kind: Kind) -> Result<Entry, PluginError> {
        let path = self.file(choice, kind)?;
        match self.loaded(&path) {
            Some(library) => entry_of(choice, &path, library.manifests().cloned().collect()),
            None => entry_of(choice, &path, read_manifests(&path)?),
        }
    }

    /// Which plugin a choice means, exactly: of a library that is loaded already, what was loaded. Executes nothing.
    ///
    /// # Errors
    /// As for [`entry`](Self::entry).
    pub fn identify(&self, choice: &Selection, kind: Kind) -> Result<Identity, PluginError> {
        let path = self.file(choice, kind)?;
        let (manifests, sha256) = match self.loaded(&path) {
            Some(library) => (library.manifests().cloned().collect(), self.fingerprints.of(library.file())?),
            None => {
                let file = LibraryFile::open(&path)?;
                (manifests_in(&file)?, self.fingerprints.of(&file)?)
            }
        };
        let Entry { manifest, .. } = entry_of(choice, &path, manifests)?;
        Ok(Identity {
            kind: kind.name(),
            interface: format!("{}.{}", manifest.abi.0, manifest.abi.1),
            sha256,
            id: manifest.id,
            version: manifest.version,
            language: manifest.language,
        })
    }

    /// The file of a plugin. One in which a panic aborts counts: it may be isolated, and is refused where it is loaded.
    fn file(&self, choice: &Selection, kind: Kind) -> Result<PathBuf, PluginError> {
        if let Some(path) = &choice.path {
            return Ok(path.clone());
        }
        match self.find(&choice.id, kind) {
            Ok(entry) => Ok(entry.path.clone()),
            Err(PluginError::PanicAborts { path, .. }) => Ok(path),
            Err(error) => Err(error),
        }
    }

    /// The library at `path`, if it is loaded.
    fn loaded(&self, path: &Path) -> Option<Arc<Library>> {
        let canonical = path.canonicalize().ok()?;
        let libraries = self.libraries.lock().unwrap_or_else(PoisonError::into_inner);
        libraries.get(&canonical).cloned()
    }
}

/// What the plugin that is meant says of itself.
fn entry_of(choice: &Selection, path: &Path, mut manifests: Vec<Manifest>) -> Result<Entry, PluginError> {
    match manifests.iter().position(|manifest| manifest.id == choice.id) {
        Some(position) => Entry::new(path, manifests.swap_remove(position)),
        None => {
            let present = manifests.into_iter().map(|manifest| manifest.id).collect();
            Err(PluginError::NotInFile { path: path.into(), id: choice.id.clone(), present })
        }
    }
}

/// Whether two paths hold the same library: a link, or a copy to the byte. Cargo leaves both kinds beside each other.
fn is_same_content(left: &Path, right: &Path) -> bool {
    let length = |path| fs::metadata(path).map(|data| data.len()).ok();
    same_file::is_same_file(left, right).unwrap_or(false)
        || length(left) == length(right)
            && matches!((regular_file::read(left), regular_file::read(right)), (Ok(left), Ok(right)) if left == right)
}

/// The libraries directly in a folder, in the order of their names. The host itself as a library for C, which lies
/// beside its plugins, is left out: it would be passed over in every list.
fn libraries_in(folder: &Path) -> std::io::Result<Vec<PathBuf>> {
    let host = format!("{DLL_PREFIX}shield_runtime{DLL_SUFFIX}");
    let mut paths = Vec::new();
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        let is_library = path
            .file_name()
            .and_then(|name| name.to_str())
            .is_some_and(|name| name.ends_with(DLL_SUFFIX) && name != host);
        if is_library && !path.is_dir() {
            paths.push(path);
        }
    }
    paths.sort();
    Ok(paths)
}

/// From 0 to 1; the part after the slash counts by itself too, since it is what people remember.
fn likeness(asked: &str, id: &str) -> f64 {
    let name = |id: &str| id.rsplit('/').next().unwrap_or(id).to_string();
    strsim::normalized_damerau_levenshtein(asked, id)
        .max(strsim::normalized_damerau_levenshtein(&name(asked), &name(id)))
}
