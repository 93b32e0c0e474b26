//! A shield around somebody's own policy and environment.

use indexmap::IndexMap;
use serde::{Deserialize, Serialize};
use shield_api::{Space, Spaces};

use super::{ExperienceConfig, PluginChoice, Reset, RuleConfig, ShieldConfig, one, one_thread};
use shield_host::plugin::Kind;

/// A shield with its reset agent; who acts and in what world is the caller's affair. The fields are those of an
/// [`Experiment`](super::Experiment).
#[derive(Debug, Clone, Deserialize, Serialize)]
#[serde(rename = "DropIn", deny_unknown_fields)]
pub struct DropInConfig {
    /// The agent or policy that undoes what was done. `None`: the program around the shield gives it.
    #[serde(default)]
    pub reset: Option<Reset>,
    /// What must not happen.
    pub shield: ShieldConfig,
    /// What "undone" means. `None`: the caller says so at every step.
    #[serde(default)]
    pub reset_task: Option<PluginChoice>,
    /// How many further starts the caller shows to the reset task before the first step. They are not counted as hard resets.
    #[serde(default)]
    pub calibration_resets: u32,
    /// What the reset agent learns from.
    #[serde(default)]
    pub experience: ExperienceConfig,
    /// Steps after which a reset episode that has not succeeded has failed.
    #[serde(default = "five_hundred")]
    pub episode_length: u64,
    /// What one hard reset costs.
    #[serde(default = "one")]
    pub hard_reset_cost: f64,
    /// Of every random number.
    #[serde(default)]
    pub seed: u64,
    /// Threads that the shield may use. Results do not depend on it.
    #[serde(default = "one_thread")]
    pub threads: usize,
    /// What the agent sees and does, where the caller does not say it.
    #[serde(default)]
    pub spaces: Option<SpacesConfig>,
    /// SHA-256 by plugin id.
    #[serde(default, skip_serializing_if = "IndexMap::is_empty")]
    pub pins: IndexMap<String, String>,
}

fn five_hundred() -> u64 {
    500
}

impl DropInConfig {
    /// The rules in the order in which the shield counts them, whatever way they are composed.
    pub fn rules(&self) -> impl Iterator<Item = &PluginChoice> {
        let mut found = Vec::new();
        RuleConfig::collect(&self.shield.rules, "shield.rules", &mut found);
        found.into_iter().map(|(_, choice)| choice)
    }

    /// Every plugin that is named: the path of its field, its kind, and the choice.
    pub fn plugins(&self) -> Vec<(String, Kind, &PluginChoice)> {
        let mut found: Vec<_> = self.reset.iter().map(Reset::plugin).collect();
        found.extend(self.shield.plugins());
        found.extend(self.reset_task.iter().map(|choice| ("reset_task".into(), Kind::ResetTask, choice)));
        found
    }

    pub(in crate::experiment) fn plugins_mut(&mut self) -> impl Iterator<Item = &mut PluginChoice> {
        let reset = self.reset.iter_mut().map(Reset::choice_mut);
        reset.chain(self.shield.plugins_mut()).chain(&mut self.reset_task)
    }
}

/// Observation and action space.
#[derive(Debug, Clone, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct SpacesConfig {
    /// What the agent sees.
    pub observation: SpaceConfig,
    /// What the agent does.
    pub action: SpaceConfig,
}

impl SpacesConfig {
    pub(in crate::experiment) fn named(&self) -> [(&'static str, &SpaceConfig); 2] {
        [("observation", &self.observation), ("action", &self.action)]
    }

    /// Those that the interface has, to be written.
    pub fn of(spaces: &Spaces) -> Self {
        Self { observation: SpaceConfig::of(&spaces.observation), action: SpaceConfig::of(&spaces.action) }
    }

    /// As the interface has them.
    pub fn into_spaces(self) -> Spaces {
        Spaces { observation: self.observation.into_space(), action: self.action.into_space() }
    }
}

/// One space.
#[derive(Debug, Clone, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub enum SpaceConfig {
    /// A vector with bounds.
    Box {
        /// Lower bounds.
        low: Vec<f32>,
        /// Upper bounds.
        high: Vec<f32>,
    },
    /// So many numbers without bounds.
    Unbounded(usize),
    /// One of so many alternatives.
    Discrete(usize),
}

impl SpaceConfig {
    fn of(space: &Space) -> Self {
        match space {
            Space::Discrete { n } => Self::Discrete(*n),
            Space::Box { low, high } if *space == Space::unbounded(low.len()) => Self::Unbounded(high.len()),
            Space::Box { low, high } => Self::Box { low: low.clone(), high: high.clone() },
        }
    }

    /// As the interface has it.
    pub fn into_space(self) -> Space {
        match self {
            Self::Box { low, high } => Space::Box { low, high },
            Self::Unbounded(dimensions) => Space::unbounded(dimensions),
            Self::Discrete(n) => Space::Discrete { n },
        }
    }
}
