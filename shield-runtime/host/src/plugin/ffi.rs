//! The wrappers around loaded instances. Each implements the trait of its kind, so that the rest of the runtime cannot tell a
//! loaded plugin from a Rust type.
//!
//! What every wrapper does, whatever the plugin does: it checks lengths before the call, so that no buffer is overrun; it fills
//! outputs with NaN before the call and refuses NaN and infinities after it, so that a value that the plugin forgot is not
//! mistaken for one that it computed; and after a panic it answers every call with an error, without touching the instance.
//! On success nothing is allocated.

mod abort_rule;
mod environment;
mod handle;
mod host;
mod learner;
mod policy;
mod reset_task;
mod success_critic;

pub(super) use handle::{spaces, while_creating};

pub use abort_rule::LoadedAbortRule;
pub use environment::LoadedEnvironment;
pub use host::{host, host_without_metrics};
pub use learner::LoadedLearner;
pub use policy::LoadedPolicy;
pub use reset_task::LoadedResetTask;
pub use success_critic::LoadedSuccessCritic;
