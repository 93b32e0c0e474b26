#![doc = include_str!("../README.md")]

extern crate self as shield_api;

pub mod abi;
mod abort_rule;
mod config;
mod environment;
mod error;
pub mod export;
mod frame;
mod learner;
pub mod manifest;
pub mod metrics;
pub mod notation;
mod plugin;
mod policy;
pub mod regular_file;
mod reset_task;
mod space;
mod success_critic;

pub use abort_rule::{
    AbortRule, Needs, ObservedAttempt, ObservedDecision, Phase, Reason, Rows, RuleContext, RuleVerdict,
    USUAL_ACCEPTED_RISK, Verdict,
};
#[allow(deprecated, reason = "source that was written for 1.0 may use it")]
pub use config::ron_options;
pub use config::{Field, PluginConfig};
pub use environment::{Environment, EnvironmentSpec, ResetKind, StepOutcome};
pub use error::{Error, ErrorKind, Position, Result, check_finite, check_length};
pub use frame::Frame;
pub use learner::{ActMode, Batch, Learner, LearnerInfo};
pub use plugin::{Checkpoint, Host, LogLevel, Plugin, Setup};
pub use policy::Policy;
pub use reset_task::{ResetSignal, ResetTask};
pub use space::{Space, Spaces};
pub use success_critic::{AttemptBatch, SuccessCritic, SuccessCriticInfo};

#[doc(hidden)]
pub mod reexports {
    pub use abi_stable;
    pub use serde;
}
