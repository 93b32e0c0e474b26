//! The shield: what is tried with a rejected action, and what follows its decisions.

use serde::{Deserialize, Serialize};

use super::{ExperienceConfig, RuleConfig};
use crate::cycle::CycleSettings;

/// The shield, and what follows its decisions.
#[derive(Debug, Clone, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct ShieldConfig {
    /// An action is executed only if every rule allows it.
    pub rules: Vec<RuleConfig>,
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
    /// Steps at the beginning during which nothing is aborted: untrained values would abort everything for ever.
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
            rules: Vec::new(),
            projection: None,
            deadline_us: None,
            reset_attempts: ResetAttempts::After(1),
            reset_test: ResetTest::default(),
            between_attempts: BetweenAttempts::default(),
            stop_on_reset: true,
            warm_up_steps: 1_000,
            shield_exploration: false,
            on_abort: OnAbort::default(),
            fallback_action: None,
        }
    }
}

/// What an experiment or a drop-in says of the reset cycle; the rest has its defaults.
pub fn cycle_settings(shield: &ShieldConfig, experience: &ExperienceConfig) -> CycleSettings {
    CycleSettings {
        reset_attempts: shield.reset_attempts.limit(),
        reset_test: shield.reset_test,
        between_attempts: shield.between_attempts,
        stop_on_reset: shield.stop_on_reset,
        shield_exploration: shield.shield_exploration,
        on_abort: shield.on_abort,
        endings: experience.endings(),
        updates: experience.updates,
        updates_per_step: experience.updates_per_step,
        cost_weight: experience.cost_weight,
        ..CycleSettings::default()
    }
}

/// What the forward agent learns from an abort.
#[derive(Debug, Clone, Copy, PartialEq, Default, Deserialize, Serialize)]
pub enum OnAbort {
    /// Nothing, as in the paper: the rejected action was never executed, and the step before it bootstraps.
    #[default]
    Nothing,
    /// The rejected action ends its task: a transition from which nothing more is to be had.
    Truncate,
    /// The same, and its reward is −x.
    Penalise(f32),
}

impl OnAbort {
    /// The reward of a rejected action, which is the last of its episode; `None` if it is not learned from.
    pub fn reward(self) -> Option<f32> {
        match self {
            Self::Nothing => None,
            Self::Truncate => Some(0.0),
            Self::Penalise(penalty) => Some(-penalty),
        }
    }
}

/// What is tried with an action that a rule rejects, before it is aborted.
#[derive(Debug, Clone, PartialEq, Deserialize, Serialize)]
pub enum ProjectionConfig {
    /// The nearest action that keeps the rules' linear rows, by a quadratic program.
    Qp(QpConfig),
    /// The reset agent's greedy action, for one step.
    Replace,
    /// Of discrete actions, the allowed one of the highest forward value.
    Best,
}

/// How the nearest allowed action is looked for.
#[derive(Debug, Clone, PartialEq, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct QpConfig {
    /// By how much each row `A a ≤ b` is tightened, in the unit of its rule: for values, reset value above the threshold.
    pub margin: f32,
    /// How often the rules may be linearised in one decision.
    pub max_iterations: u32,
    /// How far each dimension may move from the proposed action, as a share of half its range. `None`: as far as the space goes.
    pub trust_region: Option<f32>,
    /// What moving each dimension costs: distance² = Σ weight · movement². `None`: 1 each.
    pub weights: Option<Vec<f32>>,
}

impl Default for QpConfig {
    fn default() -> Self {
        Self { margin: 0.0, max_iterations: 3, trust_region: None, weights: None }
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

/// When a reset episode has succeeded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, Serialize)]
pub enum ResetTest {
    /// Some state that it visited is in the reset set (§4.2).
    #[default]
    AnyVisited,
    /// Its final state is in the reset set (Algorithm 1).
    FinalState,
}

impl ResetTest {
    /// Of an episode that has visited the reset set or not, and is there now or not.
    pub fn is_passed(self, has_visited: bool, is_there: bool) -> bool {
        match self {
            Self::AnyVisited => has_visited,
            Self::FinalState => is_there,
        }
    }
}

/// What lies between two attempts to reset.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, Serialize)]
pub enum BetweenAttempts {
    /// A forward episode (Algorithm 1).
    #[default]
    Forward,
    /// Nothing: the reset agent tries again at once.
    Reset,
}
