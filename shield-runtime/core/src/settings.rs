//! The choices of the shield and of the loops around it. Configuration files name them as they are named here.

use serde::{Deserialize, Serialize};

/// Who acts, and when the world is reset.
#[derive(Debug, Clone, PartialEq, Eq, Default, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub enum Mode {
    /// The paper's method: both agents alternate, the shield decides, hard resets after failed attempts only.
    #[default]
    Shielded,
    /// The usual way: a counted hard reset after every forward episode; no reset agent, no shield.
    StatusQuo,
    /// Forward episodes without any reset.
    ForwardOnly,
    /// Only the reset agent acts and learns; every episode begins with a counted hard reset (the paper's "insert-only").
    ResetOnly {
        /// The named start of each episode; the environment's usual start if `None`.
        #[serde(default)]
        start: Option<String>,
    },
}

/// After how many steps an attempt has failed that did not reach the reset set.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, Serialize)]
pub enum AttemptLength {
    /// As many as an episode has.
    #[default]
    Episode,
    /// So many.
    Steps(u64),
    /// Three times as many as recent successes took, half as many more after each time-out, and never more than an episode has.
    Adaptive,
}

/// Who learns after a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, Serialize)]
pub enum Updates {
    /// The agent in charge (Algorithm 1).
    #[default]
    Active,
    /// Both agents, from the shared experience.
    Both,
}

/// How reset episodes end for the reset agent's values.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Endings {
    /// In the reset set.
    pub on_success: OnResetSuccess,
    /// At the end of a failed reset episode.
    pub on_failure: OnResetFailure,
}

impl Endings {
    /// Whether the value of the state after a step counts for the reset agent. `has_failed`: it was the last step of a failed reset episode.
    pub fn reset_continues(self, in_reset_set: bool, terminated: bool, has_failed: bool) -> bool {
        let is_done = in_reset_set && self.on_success == OnResetSuccess::Terminal;
        let is_lost = has_failed && self.on_failure == OnResetFailure::Zero;
        !terminated && !is_done && !is_lost
    }
}

/// What the reset set means for the reset agent's values.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, Serialize)]
pub enum OnResetSuccess {
    /// The task ends there: with a reset reward of 1 in the reset set and 0 elsewhere, the value is the probability to get there.
    Terminal,
    /// It goes on: values lie in [0, 1/(1 − γ)), as the paper's robots have it.
    #[default]
    Bootstrap,
}

/// What the last step of a failed reset episode means for the reset agent's values.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, Serialize)]
pub enum OnResetFailure {
    /// The value beyond it is 0, so that irreversible states do not live on their own estimate.
    Zero,
    /// A time-out like any other.
    #[default]
    Bootstrap,
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

/// Who is evaluated.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize, Serialize)]
pub enum EvaluatedAgent {
    /// The forward agent or policy.
    #[default]
    Forward,
    /// The reset agent; returns are reset rewards, and success is reaching the reset set.
    Reset,
}

/// What is kept of the shield's decisions, to explain and replay them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, Serialize)]
#[serde(default, deny_unknown_fields)]
pub struct RecordConfig {
    /// The decisions of every n-th step are recorded, and every rejection; 0: none at all.
    pub decisions: u64,
    /// With the forward decision of every n-th step, the environment's state; 0: never.
    pub states_every: u64,
}

impl RecordConfig {
    /// Whether the decision at `step` is recorded.
    pub fn takes(&self, step: u64, is_rejection: bool) -> bool {
        self.decisions > 0 && (is_rejection || step.is_multiple_of(self.decisions) || self.takes_state(step))
    }

    /// Whether the state at `step` is.
    pub fn takes_state(&self, step: u64) -> bool {
        self.states_every > 0 && step.is_multiple_of(self.states_every)
    }
}

impl Default for RecordConfig {
    fn default() -> Self {
        Self { decisions: 1, states_every: 0 }
    }
}
