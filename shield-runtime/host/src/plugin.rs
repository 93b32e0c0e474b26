//! Loading plugins: reading what a file says of itself, finding an id among the folders, passing the doors of a library, and
//! using its instances as if they were Rust types.
//!
//! - `manifest` reads manifests without executing anything.
//! - [`Library`] loads one file and checks every table of it before the first call.
//! - [`Registry`] scans folders, finds ids, and makes instances.
//! - `trust` asks, before that, who could have put the file there; `file` holds it open, so that what is hashed is what is loaded.
//! - `ffi` holds the wrappers: they implement the traits of `shield_api` and let nothing through that is not a number.
//! - `isolated` does the same for plugins in a process of their own.

mod entry;
mod error;
mod ffi;
mod file;
pub mod isolated;
mod library;
mod manifest;
mod registry;
mod search_path;
mod trust;

pub use entry::{Entry, Identity, Selection, Skipped};
pub use error::PluginError;
pub use ffi::{
    LoadedAbortRule, LoadedEnvironment, LoadedLearner, LoadedPolicy, LoadedResetTask, LoadedSuccessCritic,
    host, host_without_metrics,
};
pub use file::fingerprint;
pub use library::Library;
pub use manifest::read_manifests;
pub use registry::Registry;
pub use search_path::SearchPath;
pub use trust::{Distrust, Stranger};

use std::fmt;

use shield_api::abi::kind;

/// The six kinds of plugin.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Kind {
    /// A world in which the agents act.
    Environment,
    /// An agent that learns.
    Learner,
    /// A finished policy.
    Policy,
    /// What forbids actions.
    AbortRule,
    /// What "undone" means.
    ResetTask,
    /// How likely an action can be undone.
    SuccessCritic,
}

impl Kind {
    /// Every kind.
    pub const ALL: [Self; 6] = [
        Self::Environment,
        Self::Learner,
        Self::Policy,
        Self::AbortRule,
        Self::ResetTask,
        Self::SuccessCritic,
    ];

    /// The name in a manifest, for example `abort-rule`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Environment => "environment",
            Self::Learner => "learner",
            Self::Policy => "policy",
            Self::AbortRule => "abort-rule",
            Self::ResetTask => "reset-task",
            Self::SuccessCritic => "success-critic",
        }
    }

    /// The kind of that name in a manifest.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }

    /// The number in a descriptor.
    fn code(self) -> u32 {
        match self {
            Self::Environment => kind::ENVIRONMENT,
            Self::Learner => kind::LEARNER,
            Self::Policy => kind::POLICY,
            Self::AbortRule => kind::ABORT_RULE,
            Self::ResetTask => kind::RESET_TASK,
            Self::SuccessCritic => kind::SUCCESS_CRITIC,
        }
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.name())
    }
}
