//! The shield: what is tried with a rejected action, and what follows its decisions.

use std::sync::LazyLock;

use serde::{Deserialize, Serialize};

use super::{
    AttemptLength, BetweenAttempts, ExperienceConfig, OnAbort, PluginChoice, ProjectionConfig, ResetTest,
    RuleConfig,
};
use shield_core::cycle::CycleSettings;
use shield_host::plugin::Kind;

/// The shield, and what follows its decisions.
#[derive(Debug, Clone, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct ShieldConfig {
    /// An action is executed only if every rule allows it.
    pub rules: Vec<RuleConfig>,
    /// Estimates how likely an action can be undone. `None`: `success-critic` where `undo-probability` is among the rules, else none.
    pub success_critic: Option<PluginChoice>,
    /// What is tried with a rejected action before it is aborted. `None`: nothing, as in the paper.
    pub projection: Option<ProjectionConfig>,
    /// A decision that takes longer, in microseconds of a monotonic clock, is an abort. It makes a run non-deterministic.
    pub deadline_us: Option<u64>,
    /// N of the paper: failed reset episodes in a row before a hard reset. Paper, appendix C: 1.
    pub reset_attempts: ResetAttempts,
    /// Which states of a reset episode count for its success.
    pub reset_test: ResetTest,
    /// What lies between two attempts.
    pub between_attempts: BetweenAttempts,
    /// A reset episode ends as soon as the reset set is reached.
    pub stop_on_reset: bool,
    /// Steps after which a reset episode that has not succeeded has failed.
    pub attempt_length: AttemptLength,
    /// Steps at the beginning during which rules that need learned values are not asked: untrained values would abort everything for ever.
    pub warm_up_steps: u64,
    /// The rules judge the reset agent's exploratory actions too; a rejected one is replaced by its greedy action.
    pub shield_exploration: bool,
    /// What the forward agent learns from an abort.
    pub on_abort: OnAbort,
    /// What a caller's buffer holds after an abort where the reset agent's action is not usable. `None`: the action of the space
    /// that is nearest to zero.
    pub fallback_action: Option<Vec<f32>>,
}

impl Default for ShieldConfig {
    fn default() -> Self {
        Self {
            rules: vec![RuleConfig::Rule(PluginChoice::of(UNDO_PROBABILITY))],
            success_critic: None,
            projection: None,
            deadline_us: None,
            reset_attempts: ResetAttempts::After(1),
            reset_test: ResetTest::default(),
            between_attempts: BetweenAttempts::default(),
            stop_on_reset: true,
            attempt_length: AttemptLength::default(),
            warm_up_steps: 1_000,
            shield_exploration: false,
            on_abort: OnAbort::default(),
            fallback_action: None,
        }
    }
}

/// The rule that an experiment has which names none.
const UNDO_PROBABILITY: &str = "undo-probability";

static USUAL_CRITIC: LazyLock<PluginChoice> = LazyLock::new(|| PluginChoice::of("success-critic"));

impl ShieldConfig {
    /// The success critic, if there is one.
    pub fn critic(&self) -> Option<&PluginChoice> {
        let mut rules = Vec::new();
        RuleConfig::collect(&self.rules, "", &mut rules);
        let is_usual = || rules.iter().any(|(_, rule)| rule.plugin == UNDO_PROBABILITY);
        self.success_critic.as_ref().or_else(|| is_usual().then(|| &*USUAL_CRITIC))
    }

    /// The rules and the success critic: the path of each field, its kind, and the choice.
    pub(in crate::experiment) fn plugins(&self) -> impl Iterator<Item = (String, Kind, &PluginChoice)> {
        let mut rules = Vec::new();
        RuleConfig::collect(&self.rules, "shield.rules", &mut rules);
        let critic =
            self.critic().map(|choice| ("shield.success_critic".into(), Kind::SuccessCritic, choice));
        rules.into_iter().map(|(path, choice)| (path, Kind::AbortRule, choice)).chain(critic)
    }
}

impl ShieldConfig {
    /// The rules and the success critic that is written.
    pub(super) fn plugins_mut(&mut self) -> impl Iterator<Item = &mut PluginChoice> {
        self.rules.iter_mut().flat_map(RuleConfig::plugins_mut).chain(&mut self.success_critic)
    }
}

/// What an experiment or a drop-in says of the reset cycle; the rest has its defaults.
pub fn cycle_settings(shield: &ShieldConfig, experience: &ExperienceConfig) -> CycleSettings {
    CycleSettings {
        reset_attempts: shield.reset_attempts.limit(),
        reset_test: shield.reset_test,
        between_attempts: shield.between_attempts,
        stop_on_reset: shield.stop_on_reset,
        attempt_length: shield.attempt_length,
        shield_exploration: shield.shield_exploration,
        on_abort: shield.on_abort,
        endings: experience.endings(),
        updates: experience.updates,
        updates_per_step: experience.updates_per_step,
        reset_updates_per_step: experience.reset_updates_per_step,
        update_every: experience.update_every,
        cost_weight: experience.cost_weight,
        ..CycleSettings::default()
    }
}

/// N, the number of failed reset episodes in a row after which a hard reset follows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Serialize)]
#[serde(untagged, expecting = "expected a number of attempts or `Unlimited`")]
pub enum ResetAttempts {
    /// A hard reset after that many failures.
    After(u32),
    /// `Unlimited`: never a hard reset.
    Never(Unlimited),
}

impl ResetAttempts {
    /// N, or `None` where there is no limit.
    pub fn limit(self) -> Option<u32> {
        match self {
            Self::After(limit) => Some(limit),
            Self::Never(_) => None,
        }
    }
}

/// The word `Unlimited`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Serialize)]
pub enum Unlimited {
    /// No limit.
    Unlimited,
}
