//! Plugins in a process of their own: whatever one does there, crash, exit or hang, is an error here.
//!
//! The process is the program `shield` itself, started as `shield worker`. It loads the library and serves one instance; numbers
//! travel through shared memory, a call costs a few microseconds. [`IsolatedEnvironment`] and [`IsolatedPolicy`] implement the
//! traits of `shield_api` like the wrappers of `ffi`.

mod environment;
mod guest;
mod host;
mod policy;
mod program;
mod protocol;

use std::time::Duration;

pub use environment::IsolatedEnvironment;
pub use guest::serve;
pub use policy::IsolatedPolicy;
pub use program::VARIABLE as WORKER_VARIABLE;

/// How an isolated plugin is run.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Isolation {
    /// What follows when its process dies or gives no answer, or the plugin panics.
    pub on_failure: OnFailure,
    /// How long the instance may take to be made.
    pub start_timeout: Duration,
    /// How long any later call may take.
    pub step_timeout: Duration,
}

/// What follows when an isolated plugin fails so that it cannot be called again.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum OnFailure {
    /// The error ends the run.
    #[default]
    Error,
    /// A new process takes its place, up to [`MOST_FAILURES`] times in a row. An environment then needs a hard reset; a policy is
    /// asked again.
    Restart,
}

/// After so many failures without a success between them, a plugin is not started again.
pub const MOST_FAILURES: u32 = 3;
