//! What an experiment says, field by field. Defaults cite their source.

mod drop_in;
mod experience;
mod output;
mod plugin_choice;
mod reset;
mod rules;
mod shield;

use indexmap::IndexMap;
use serde::{Deserialize, Serialize};

use super::ron_text::RonText;
pub use shield_core::settings::{
    AttemptLength, BetweenAttempts, Endings, EvaluatedAgent, Mode, OnAbort, OnResetFailure, OnResetSuccess,
    ProjectionConfig, QpConfig, RecordConfig, ResetTest, Updates,
};
use shield_host::plugin::Kind;

pub use drop_in::{DropInConfig, SpaceConfig, SpacesConfig};
pub use experience::ExperienceConfig;
pub use output::{CheckpointConfig, EvaluationConfig};
pub use plugin_choice::{Forward, OnWorkerFailure, PluginChoice, WorkerConfig};
pub use reset::Reset;
pub use rules::RuleConfig;
pub use shield::{ResetAttempts, ShieldConfig, Unlimited, cycle_settings};

/// A whole experiment: one environment, two agents, a shield, several seeds and variants.
#[derive(Debug, Clone, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Experiment {
    /// Names the folder of the runs.
    pub name: String,
    /// Environment steps of a run, both phases together.
    pub steps: u64,
    /// One run per seed.
    pub seeds: Vec<u64>,
    /// Who acts, and when the world is reset.
    #[serde(default)]
    pub mode: Mode,
    /// The world.
    pub environment: PluginChoice,
    /// The agent or policy that does the task.
    pub forward: Forward,
    /// The agent or policy that undoes it. Needed by `Shielded` and `ResetOnly`.
    #[serde(default)]
    pub reset: Option<Reset>,
    /// What must not happen.
    #[serde(default)]
    pub shield: ShieldConfig,
    /// Replaces the environment's own reset reward and reset set.
    #[serde(default)]
    pub reset_task: Option<PluginChoice>,
    /// How many further starts are shown to the reset task before the first step. They are not counted as hard resets.
    #[serde(default)]
    pub calibration_resets: u32,
    /// The transitions that both agents share, and what they learn from them.
    #[serde(default)]
    pub experience: ExperienceConfig,
    /// Greedy episodes in a second instance of the environment, at fixed intervals.
    #[serde(default)]
    pub evaluation: Option<EvaluationConfig>,
    /// Keeping the state of a run, so that it can be continued and its agents be used. `None`: nothing is kept.
    #[serde(default = "usual_checkpoints")]
    pub checkpoint: Option<CheckpointConfig>,
    /// What is kept of the shield's decisions.
    #[serde(default)]
    pub record: RecordConfig,
    /// What one hard reset costs, or a factor to the costs that the environment names; the summary's `hard_reset_cost` is the sum.
    #[serde(default = "one")]
    pub hard_reset_cost: f64,
    /// Threads that one run may use. Results do not depend on it.
    #[serde(default = "one_thread")]
    pub threads: usize,
    /// SHA-256 by plugin id; another file is refused before anything of it is executed. `shield plugin lock` writes them.
    #[serde(default, skip_serializing_if = "IndexMap::is_empty")]
    pub pins: IndexMap<String, String>,
    /// Named lists of overrides, `"name": [("path.to.field", value)]`. Without any, there is one variant, `default`.
    #[serde(default, skip_serializing_if = "IndexMap::is_empty")]
    pub variants: IndexMap<String, Vec<(String, RonText)>>,
}

impl Experiment {
    /// Every plugin that the experiment names: the path of its field, such as `shield.rules[0]`, its kind, and the choice.
    pub fn plugins(&self) -> Vec<(String, Kind, &PluginChoice)> {
        let mut found = vec![("environment".to_owned(), Kind::Environment, &self.environment)];
        found.push(match &self.forward {
            Forward::Learner(choice) => ("forward".into(), Kind::Learner, choice),
            Forward::Policy(choice) => ("forward".into(), Kind::Policy, choice),
        });
        found.extend(self.reset.iter().map(Reset::plugin));
        found.extend(self.shield.plugins());
        found.extend(self.reset_task.iter().map(|choice| ("reset_task".into(), Kind::ResetTask, choice)));
        found
    }

    /// The rules in the order in which the shield counts them, whatever way they are composed.
    pub fn rules(&self) -> impl Iterator<Item = &PluginChoice> {
        let mut found = Vec::new();
        RuleConfig::collect(&self.shield.rules, "shield.rules", &mut found);
        found.into_iter().map(|(_, choice)| choice)
    }

    /// Whether evaluations come in pairs: with the shield, and without it.
    pub fn is_evaluated_with_shield(&self) -> bool {
        let has_shield = self.mode == Mode::Shielded;
        let asks =
            |settings: &EvaluationConfig| settings.shielded && settings.agent == EvaluatedAgent::Forward;
        has_shield && self.evaluation.as_ref().is_some_and(asks)
    }

    /// Whether there is a shield that evaluations of the forward agent leave out.
    pub fn is_evaluated_without_its_shield(&self) -> bool {
        let leaves_out =
            |settings: &EvaluationConfig| !settings.shielded && settings.agent == EvaluatedAgent::Forward;
        self.mode == Mode::Shielded && self.evaluation.as_ref().is_some_and(leaves_out)
    }

    pub(super) fn plugins_mut(&mut self) -> impl Iterator<Item = &mut PluginChoice> {
        let (Forward::Learner(forward) | Forward::Policy(forward)) = &mut self.forward;
        [&mut self.environment, forward]
            .into_iter()
            .chain(self.reset.iter_mut().map(Reset::choice_mut))
            .chain(self.shield.plugins_mut())
            .chain(&mut self.reset_task)
    }
}

fn usual_checkpoints() -> Option<CheckpointConfig> {
    Some(CheckpointConfig::default())
}

fn one() -> f64 {
    1.0
}

fn one_thread() -> usize {
    1
}
