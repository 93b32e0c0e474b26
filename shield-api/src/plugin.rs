//! What every kind of plugin shares: how it is made, how its state is kept, and what the host offers it.

use crate::{Error, PluginConfig, Result, Spaces, abi};

/// How an instance is made. Implemented once per plugin, beside the trait of its kind.
pub trait Plugin: Checkpoint + Sized + 'static {
    /// The plugin's own configuration, declared with [`config!`](crate::config!). The host hands over the RON text
    /// of the experiment verbatim; it is parsed before [`create`](Self::create) is called.
    type Config: PluginConfig;

    /// Makes an instance. Called once per instance, before anything else; the configuration is already parsed.
    ///
    /// # Errors
    /// [`ErrorKind::InvalidConfig`](crate::ErrorKind::InvalidConfig) for a value that cannot be; whatever else
    /// prevents the instance from existing.
    fn create(config: Self::Config, setup: &Setup) -> Result<Self>;
}

/// The state of an instance as bytes, so that a run can be stopped and continued. "Unsupported" is a legal answer:
/// the run then continues at the next hard reset and says so.
#[allow(unused_variables, reason = "the defaults name their arguments for whoever writes others")]
pub trait Checkpoint: Send {
    /// Appends the full state to `bytes`: with it, an instance made from the same configuration continues bit for bit.
    ///
    /// # Errors
    /// [`ErrorKind::Unsupported`](crate::ErrorKind::Unsupported) by default.
    fn save(&self, bytes: &mut Vec<u8>) -> Result<()> {
        Err(Error::unsupported("saving the state"))
    }

    /// Restores a state that [`save`](Self::save) wrote. On an error the instance is as it was before.
    ///
    /// # Errors
    /// [`ErrorKind::Unsupported`](crate::ErrorKind::Unsupported) by default; bytes that are not such a state.
    fn load(&mut self, bytes: &[u8]) -> Result<()> {
        Err(Error::unsupported("loading a state"))
    }
}

/// What an instance is told when it is made.
#[derive(Debug, Clone)]
pub struct Setup {
    /// Seed of everything random in the instance.
    pub seed: u64,
    /// How many threads the instance may use. The result must not depend on it.
    pub threads: usize,
    /// The host's services.
    pub host: Host,
    spaces: Option<Spaces>,
}

impl Setup {
    /// The setup of an instance that brings its own spaces: an environment.
    pub fn new(seed: u64, threads: usize, host: Host) -> Self {
        Self { seed, threads, host, spaces: None }
    }

    /// The setup of an instance that works in the given spaces: every other kind.
    pub fn with_spaces(seed: u64, threads: usize, host: Host, spaces: Spaces) -> Self {
        Self { seed, threads, host, spaces: Some(spaces) }
    }

    /// The spaces of the environment around which the instance will work.
    ///
    /// # Errors
    /// An environment, which brings its spaces, is given none.
    pub fn spaces(&self) -> Result<&Spaces> {
        self.spaces
            .as_ref()
            .ok_or_else(|| Error::failed("an environment brings its spaces; the host gives none"))
    }
}

/// How much a log line matters.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LogLevel {
    /// The plugin cannot do what it was asked.
    Error,
    /// Something is odd; the run goes on.
    Warn,
    /// Worth knowing once.
    Info,
    /// For whoever writes the plugin.
    Debug,
}

/// What the host offers to a plugin: a log and a place for metrics. Every library has its own standard library, so the
/// host's logger does not reach a plugin by itself. Usable only on the thread that is calling the instance.
#[derive(Debug, Clone, Copy)]
pub struct Host {
    table: Option<&'static abi::HostTable>,
}

impl Host {
    /// A host that drops everything: for tests.
    pub fn silent() -> Self {
        Self { table: None }
    }

    /// A host behind a binary table, for the runtime and the glue.
    #[doc(hidden)]
    pub fn from_table(table: Option<&'static abi::HostTable>) -> Self {
        Self { table }
    }

    /// The binary table, for the runtime.
    #[doc(hidden)]
    pub fn table(&self) -> Option<&'static abi::HostTable> {
        self.table
    }

    /// Writes a line to the host's log.
    pub fn log(&self, level: LogLevel, message: &str) {
        if let Some(table) = self.table {
            table.call_log(level, message);
        }
    }

    /// Reports a figure of the plugin's own, for example `critic_loss`. The host averages it over an episode and writes
    /// it beside the others. Allocates nothing.
    pub fn metric(&self, name: &str, value: f64) {
        if let Some(table) = self.table {
            table.call_metric(name, value);
        }
    }
}
