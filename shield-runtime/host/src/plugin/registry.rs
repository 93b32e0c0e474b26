//! Finding plugins by id among the folders of the search path, and making instances of them.

use std::{
    collections::{BTreeMap, HashMap, HashSet},
    env::consts::{DLL_PREFIX, DLL_SUFFIX},
    fs,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError},
};

use shield_api::Setup;

use super::{
    Entry, Identity, Kind, LoadedAbortRule, LoadedEnvironment, LoadedLearner, LoadedPolicy, LoadedResetTask,
    PluginError, SearchPath, Selection, Skipped,
    isolated::{IsolatedEnvironment, IsolatedPolicy, Isolation},
    library::{KindTable, Library},
    manifest::{check_manifests, read_manifests, refuse_aborting},
    trust::{Fingerprints, check_writable},
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
                    paths
                        .iter()
                        .filter(|path| seen.insert((*path).clone()))
                        .for_each(|path| registry.add(path));
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

    fn add(&mut self, path: &Path) {
        let skipped = |ids, reason| Skipped { path: path.into(), ids, reason };
        let manifests = match read_manifests(path) {
            Ok(manifests) => manifests,
            Err(reason) => return self.skipped.push(skipped(Vec::new(), reason)),
        };
        let is_known = |entry: &Entry| manifests.iter().any(|manifest| manifest.id == entry.manifest.id);
        if self.entries.iter().any(|entry| is_known(entry) && is_same_content(&entry.path, path)) {
            return;
        }
        let checked = check_manifests(path, &manifests)
            .and_then(|_| refuse_aborting(path, &manifests))
            .and_then(|()| check_writable(path));
        if let Err(reason) = checked {
            let ids = manifests.into_iter().map(|manifest| manifest.id).collect();
            return self.skipped.push(skipped(ids, reason));
        }
        // The kinds were checked above.
        self.entries.extend(manifests.into_iter().filter_map(|manifest| Entry::new(path, manifest).ok()));
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

    /// An environment, ready for its first reset.
    ///
    /// # Errors
    /// The plugin cannot be found or loaded, refuses its configuration, or describes itself wrongly.
    pub fn environment(
        &self,
        choice: &Selection,
        config: &str,
        setup: &Setup,
    ) -> Result<LoadedEnvironment, PluginError> {
        LoadedEnvironment::create(&choice.id, self.table(choice)?, config, setup)
    }

    /// A learner.
    ///
    /// # Errors
    /// As for [`environment`](Self::environment).
    pub fn learner(
        &self,
        choice: &Selection,
        config: &str,
        setup: &Setup,
    ) -> Result<LoadedLearner, PluginError> {
        LoadedLearner::create(&choice.id, self.table(choice)?, config, setup)
    }

    /// A policy.
    ///
    /// # Errors
    /// As for [`environment`](Self::environment).
    pub fn policy(
        &self,
        choice: &Selection,
        config: &str,
        setup: &Setup,
    ) -> Result<LoadedPolicy, PluginError> {
        LoadedPolicy::create(&choice.id, self.table(choice)?, config, setup)
    }

    /// An abort rule.
    ///
    /// # Errors
    /// As for [`environment`](Self::environment).
    pub fn abort_rule(
        &self,
        choice: &Selection,
        config: &str,
        setup: &Setup,
    ) -> Result<LoadedAbortRule, PluginError> {
        LoadedAbortRule::create(&choice.id, self.table(choice)?, config, setup)
    }

    /// A reset task.
    ///
    /// # Errors
    /// As for [`environment`](Self::environment).
    pub fn reset_task(
        &self,
        choice: &Selection,
        config: &str,
        setup: &Setup,
    ) -> Result<LoadedResetTask, PluginError> {
        LoadedResetTask::create(&choice.id, self.table(choice)?, config, setup)
    }

    /// An environment in a process of its own.
    ///
    /// # Errors
    /// As for [`environment`](Self::environment); the process cannot be started, or fails on the way.
    pub fn isolated_environment(
        &self,
        choice: &Selection,
        config: &str,
        setup: &Setup,
        isolation: Isolation,
    ) -> Result<IsolatedEnvironment, PluginError> {
        let path = self.pinned_file(choice, Kind::Environment)?;
        IsolatedEnvironment::create(&choice.id, &path, config, setup, isolation)
    }

    /// A policy in a process of its own.
    ///
    /// # Errors
    /// As for [`isolated_environment`](Self::isolated_environment).
    pub fn isolated_policy(
        &self,
        choice: &Selection,
        config: &str,
        setup: &Setup,
        isolation: Isolation,
    ) -> Result<IsolatedPolicy, PluginError> {
        let path = self.pinned_file(choice, Kind::Policy)?;
        IsolatedPolicy::create(&choice.id, &path, config, setup, isolation)
    }

    /// The file of the plugin that a choice means, and what it says of itself there. Executes nothing.
    ///
    /// # Errors
    /// No file holds it, or the file cannot be read.
    pub fn entry(&self, choice: &Selection, kind: Kind) -> Result<Entry, PluginError> {
        let path = self.file(choice, kind)?;
        let mut manifests = read_manifests(&path)?;
        match manifests.iter().position(|manifest| manifest.id == choice.id) {
            Some(position) => Entry::new(&path, manifests.swap_remove(position)),
            None => {
                let present = manifests.into_iter().map(|manifest| manifest.id).collect();
                Err(PluginError::NotInFile { path, id: choice.id.clone(), present })
            }
        }
    }

    /// Which plugin a choice means, exactly. Executes nothing.
    ///
    /// # Errors
    /// As for [`entry`](Self::entry).
    pub fn identify(&self, choice: &Selection, kind: Kind) -> Result<Identity, PluginError> {
        let Entry { manifest, path, .. } = self.entry(choice, kind)?;
        Ok(Identity {
            kind: kind.name(),
            interface: format!("{}.{}", manifest.abi.0, manifest.abi.1),
            sha256: self.fingerprints.of(&path)?,
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

    /// The file of a plugin, if it is the one that the experiment pins.
    fn pinned_file(&self, choice: &Selection, kind: Kind) -> Result<PathBuf, PluginError> {
        let path = self.file(choice, kind)?;
        if let Some(pinned) = &choice.sha256 {
            let found = self.fingerprints.of(&path)?;
            if found != *pinned {
                let id = choice.id.clone();
                return Err(PluginError::NotPinned { path, id, pinned: pinned.clone(), found });
            }
        }
        Ok(path)
    }

    fn table<T: KindTable>(&self, choice: &Selection) -> Result<&'static T, PluginError> {
        self.library(&self.pinned_file(choice, T::KIND)?)?.table(&choice.id)
    }

    /// The library at `path`, loaded once.
    fn library(&self, path: &Path) -> Result<Arc<Library>, PluginError> {
        let path = path
            .canonicalize()
            .map_err(|error| PluginError::Unreadable { path: path.into(), reason: error.to_string() })?;
        let mut libraries = self.libraries.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(library) = libraries.get(&path) {
            return Ok(library.clone());
        }
        let library = Arc::new(Library::load(&path)?);
        libraries.insert(path, library.clone());
        Ok(library)
    }
}

/// Whether two paths hold the same library: a link, or a copy to the byte. Cargo leaves both kinds beside each other.
fn is_same_content(left: &Path, right: &Path) -> bool {
    let length = |path| fs::metadata(path).map(|data| data.len()).ok();
    same_file::is_same_file(left, right).unwrap_or(false)
        || length(left) == length(right)
            && matches!((fs::read(left), fs::read(right)), (Ok(left), Ok(right)) if left == right)
}

/// The libraries directly in a folder, as canonical paths in the order of their names. The host itself as a library for C, which lies
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
            // A dangling link stays as it is and is reported as unreadable.
            paths.push(path.canonicalize().unwrap_or(path));
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
