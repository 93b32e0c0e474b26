//! Which plugins, and how they are run.

use std::time::Duration;

use serde::{Deserialize, Serialize};

use crate::experiment::ron_text::RonText;
use shield_host::plugin::{
    Selection,
    isolated::{Isolation, OnFailure},
};

/// A plugin and its configuration.
#[derive(Debug, Clone, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct PluginChoice {
    /// The plugin's id.
    pub plugin: String,
    /// A file to load it from, instead of the search path.
    #[serde(default)]
    pub path: Option<std::path::PathBuf>,
    /// RON text that only the plugin understands.
    #[serde(default)]
    pub config: RonText,
    /// In a process of its own, so that a crash, an exit or a hang in it is an error. For environments and policies.
    #[serde(default, skip_serializing_if = "is_default")]
    pub isolate: bool,
    /// How that process is treated.
    #[serde(default, skip_serializing_if = "is_default")]
    pub worker: WorkerConfig,
}

impl PluginChoice {
    /// A plugin with its defaults.
    pub(in crate::experiment) fn of(id: &str) -> Self {
        let (path, config, worker) = (None, RonText::default(), WorkerConfig::default());
        Self { plugin: id.to_owned(), path, config, isolate: false, worker }
    }

    /// What it names, whatever the experiment pins.
    pub fn selection(&self) -> Selection {
        Selection { path: self.path.clone(), ..Selection::new(&self.plugin) }
    }

    /// How the plugin is isolated, if it is. The time limits were checked with the file.
    pub fn isolation(&self) -> Option<Isolation> {
        let WorkerConfig { on_failure, start_timeout_s, step_timeout_s } = self.worker;
        self.isolate.then(|| Isolation {
            on_failure: match on_failure {
                OnWorkerFailure::Error => OnFailure::Error,
                OnWorkerFailure::Restart => OnFailure::Restart,
            },
            start_timeout: Duration::from_secs_f64(start_timeout_s),
            step_timeout: Duration::from_secs_f64(step_timeout_s),
        })
    }
}

/// How the process of an isolated plugin is treated.
#[derive(Debug, Clone, PartialEq, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct WorkerConfig {
    /// What follows when it dies or gives no answer, or the plugin panics.
    pub on_failure: OnWorkerFailure,
    /// How long the plugin may take to be made, in seconds.
    pub start_timeout_s: f64,
    /// How long any later call may take, in seconds.
    pub step_timeout_s: f64,
}

impl Default for WorkerConfig {
    fn default() -> Self {
        Self { on_failure: OnWorkerFailure::Error, start_timeout_s: 60.0, step_timeout_s: 10.0 }
    }
}

/// What follows the failure of an isolated plugin's process.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Serialize)]
pub enum OnWorkerFailure {
    /// The run ends with the reason.
    Error,
    /// A new process takes its place. An environment's episode ends there, and a counted hard reset follows; a policy is asked again.
    Restart,
}

fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

/// Who does the task.
#[derive(Debug, Clone, Deserialize, Serialize)]
pub enum Forward {
    /// An agent that learns.
    Learner(PluginChoice),
    /// A finished policy.
    Policy(PluginChoice),
}

impl Forward {
    /// The plugin behind it.
    pub fn choice(&self) -> &PluginChoice {
        match self {
            Self::Learner(choice) | Self::Policy(choice) => choice,
        }
    }
}
