//! Making instances of plugins; their libraries are loaded on the way.

use std::sync::{Arc, PoisonError};

use shield_api::Setup;

use super::Registry;
use crate::plugin::{
    Kind, LoadedAbortRule, LoadedEnvironment, LoadedLearner, LoadedPolicy, LoadedResetTask,
    LoadedSuccessCritic, PluginError, Selection,
    file::{LibraryFile, unreadable},
    isolated::{IsolatedEnvironment, IsolatedPolicy, Isolation},
    library::{KindTable, Library},
};

impl Registry {
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

    /// A success critic.
    ///
    /// # Errors
    /// As for [`environment`](Self::environment).
    pub fn success_critic(
        &self,
        choice: &Selection,
        config: &str,
        setup: &Setup,
    ) -> Result<LoadedSuccessCritic, PluginError> {
        let table = self.library(choice, Kind::SuccessCritic)?.success_critic_table(&choice.id)?;
        LoadedSuccessCritic::create(&choice.id, table, config, setup)
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
        IsolatedEnvironment::create(&self.located(choice, Kind::Environment)?, config, setup, isolation)
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
        IsolatedPolicy::create(&self.located(choice, Kind::Policy)?, config, setup, isolation)
    }

    /// The choice with its file, for another process to load. The process checks what it opens; checked here too, a fault is known before it starts.
    fn located(&self, choice: &Selection, kind: Kind) -> Result<Selection, PluginError> {
        let path = self.file(choice, kind)?;
        self.fingerprints.check_pin(choice, &LibraryFile::open_trusted(&path)?)?;
        Ok(choice.clone().at(path))
    }

    fn table<T: KindTable>(&self, choice: &Selection) -> Result<&'static T, PluginError> {
        self.library(choice, T::KIND)?.table(&choice.id)
    }

    /// The library of a plugin, loaded once, if it is the one that the experiment pins.
    fn library(&self, choice: &Selection, kind: Kind) -> Result<Arc<Library>, PluginError> {
        let path = self.file(choice, kind)?;
        let canonical = path.canonicalize().map_err(|error| unreadable(&path, &error))?;
        let mut libraries = self.libraries.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(library) = libraries.get(&canonical) {
            self.fingerprints.check_pin(choice, library.file())?;
            return Ok(library.clone());
        }
        let file = LibraryFile::open_trusted(&path)?;
        self.fingerprints.check_pin(choice, &file)?;
        let library = Arc::new(Library::from_file(file, choice.sha256.is_some())?);
        libraries.insert(library.path().to_owned(), library.clone());
        Ok(library)
    }
}
