//! Abort rules: what decides that an action must not be executed.

use std::fmt;

use crate::{Checkpoint, Error, Result};

/// What a rule wants to be computed before it is asked. What no rule needs is not computed, and its slice is empty.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Needs {
    /// The reset ensemble's values of the proposed action.
    pub values: bool,
    /// The reset ensemble's values of the reset agent's own greedy action: V(s).
    pub greedy_values: bool,
    /// The forward ensemble's values of the proposed action.
    pub forward_values: bool,
    /// The success critic's estimates for the proposed action.
    pub probabilities: bool,
    /// The success critic's estimates for the reset agent's greedy action, here and where the last reset ended.
    pub greedy_probabilities: bool,
    /// The same, but here only once the rule has rejected the action: it is asked without them first, and then again. Saves a valuation for
    /// every action that is allowed.
    pub greedy_on_rejection: bool,
}

impl Needs {
    /// Whether it needs anything that is learned. A rule that does not, applies from the first step and to every agent's actions.
    pub fn anything_learned(&self) -> bool {
        self.values || self.greedy_values || self.forward_values || self.undo_probabilities()
    }

    /// Whether it needs a success critic.
    pub fn undo_probabilities(&self) -> bool {
        self.probabilities || self.any_greedy_probabilities()
    }

    /// Whether it needs the success critic's estimates for the reset agent's greedy action, always or after a rejection.
    pub fn any_greedy_probabilities(&self) -> bool {
        self.greedy_probabilities || self.greedy_on_rejection
    }

    /// What either of both needs.
    #[must_use]
    pub fn union(self, other: Self) -> Self {
        Self {
            values: self.values || other.values,
            greedy_values: self.greedy_values || other.greedy_values,
            forward_values: self.forward_values || other.forward_values,
            probabilities: self.probabilities || other.probabilities,
            greedy_probabilities: self.greedy_probabilities || other.greedy_probabilities,
            greedy_on_rejection: self.greedy_on_rejection || other.greedy_on_rejection,
        }
    }
}

/// Whose action is judged.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Phase {
    /// The forward agent's, which does the task.
    #[default]
    Forward,
    /// The reset agent's, which undoes it.
    Reset,
}

/// Everything that a rule may look at. Empty by default, so that a test names only what it is about.
#[derive(Debug, Clone, Copy, Default)]
pub struct RuleContext<'a> {
    /// Environment steps so far, both phases.
    pub step: u64,
    /// The state in which the action would be executed.
    pub observation: &'a [f32],
    /// The proposed action.
    pub proposed: &'a [f32],
    /// The action executed before it; `None` after a hard reset.
    pub previous: Option<&'a [f32]>,
    /// Q_reset(s, a) of each member at the proposed action, if [`Needs::values`].
    pub values: &'a [f32],
    /// Q_reset(s, π_reset(s)) of each member, if [`Needs::greedy_values`].
    pub greedy_values: &'a [f32],
    /// Q_forward(s, a) of each member, if [`Needs::forward_values`]; empty where the forward agent is a policy.
    pub forward_values: &'a [f32],
    /// P(s, a) of each member of the success critic at the proposed action, if [`Needs::probabilities`].
    pub probabilities: &'a [f32],
    /// P(s, π_reset(s)) of each member, if [`Needs::greedy_probabilities`]. With [`Needs::greedy_on_rejection`] empty until the rule has
    /// rejected the action.
    pub greedy_probabilities: &'a [f32],
    /// The same in the state in which the last reset ended, where nothing had to be undone yet, if one of the two is needed.
    pub start_probabilities: &'a [f32],
    /// γ of the reset agent.
    pub discount: f32,
    /// Whose action it is. A rejected action of the reset agent gives way to its greedy one.
    pub phase: Phase,
}

/// What a rule says of an action.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// It may be executed, as far as this rule is concerned.
    Allow,
    /// It must not be executed.
    Reject,
}

/// A verdict with the figure behind it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RuleVerdict {
    /// Allow or reject.
    pub verdict: Verdict,
    /// The figure that the rule compared, for example the smallest member's value. The host rejects if it is NaN.
    pub score: f32,
}

impl RuleVerdict {
    /// The verdict of `is_safe`. Write `let is_safe = value >= threshold;`, so that NaN rejects.
    pub fn from_safe(is_safe: bool, score: f32) -> Self {
        Self { verdict: if is_safe { Verdict::Allow } else { Verdict::Reject }, score }
    }
}

/// A buffer of the host for the sentence that explains a verdict. Use it with `write!`; what does not fit is cut.
#[derive(Debug)]
pub struct Reason<'a> {
    buffer: &'a mut [u8],
    length: usize,
}

impl<'a> Reason<'a> {
    /// An empty reason over `buffer`.
    pub fn new(buffer: &'a mut [u8]) -> Self {
        Self { buffer, length: 0 }
    }

    /// How many bytes were written; always a boundary between characters.
    pub fn len(&self) -> usize {
        self.length
    }

    /// Whether nothing was written.
    pub fn is_empty(&self) -> bool {
        self.length == 0
    }
}

impl fmt::Write for Reason<'_> {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        let room = self.buffer.len() - self.length;
        let take = text.floor_char_boundary(room.min(text.len()));
        self.buffer[self.length..self.length + take].copy_from_slice(&text.as_bytes()[..take]);
        self.length += take;
        Ok(())
    }
}

/// Where a rule puts its linear constraints, rows `A a ≤ b` on the action.
pub trait Rows {
    /// Adds one row: `coefficients · a ≤ bound`.
    ///
    /// # Errors
    /// The host refuses a row of the wrong length or with a value that is not finite.
    fn push(&mut self, coefficients: &[f32], bound: f32) -> Result<()>;
}

/// The accepted risk where a user names none: the share of attempts to reset that may fail. The rule `undo-probability` keeps it, and
/// programs compare with it what became of a run.
pub const USUAL_ACCEPTED_RISK: f64 = 0.2;

/// How an attempt to reset ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ObservedAttempt {
    /// Environment steps so far, both phases.
    pub step: u64,
    /// Whether the reset set was reached. Also true where an action was rejected before anything had been executed since the last reset: there
    /// was nothing to undo. False also where the environment ended in a forward episode.
    pub succeeded: bool,
}

/// What became of a decision, told to every rule once per step.
#[derive(Debug, Clone, Copy)]
pub struct ObservedDecision<'a> {
    /// Environment steps so far, both phases.
    pub step: u64,
    /// Whether the proposed action was replaced by the reset agent.
    pub aborted: bool,
    /// What will be executed in its place or as it was; on an abort, the reset agent's action.
    pub action: &'a [f32],
}

/// A rule that can forbid an action. Several can be combined; an action is executed only if all of them allow it.
///
/// ```standalone_crate
/// use shield_api::*;
/// use std::fmt::Write;
///
/// shield_api::config! {
///     /// Forbids pushing hard.
///     pub struct GentleConfig {
///         /// The largest magnitude allowed.
///         limit: f32 = 0.5,
///     }
/// }
///
/// struct Gentle(f32);
///
/// impl Checkpoint for Gentle {}
///
/// impl Plugin for Gentle {
///     type Config = GentleConfig;
///
///     fn create(config: GentleConfig, _setup: &Setup) -> Result<Self> {
///         Ok(Self(config.limit))
///     }
/// }
///
/// impl AbortRule for Gentle {
///     fn needs(&self) -> Needs {
///         Needs::default()
///     }
///
///     fn evaluate(&self, context: &RuleContext<'_>, reason: &mut Reason<'_>) -> Result<RuleVerdict> {
///         let largest = context.proposed.iter().fold(0.0f32, |largest, value| largest.max(value.abs()));
///         let is_safe = largest <= self.0;
///         if !is_safe {
///             write!(reason, "the action reaches {largest}, more than {}", self.0).ok();
///         }
///         Ok(RuleVerdict::from_safe(is_safe, largest))
///     }
///
///     fn linearise(&self, context: &RuleContext<'_>, _gradients: &[f32], rows: &mut dyn Rows) -> Result<()> {
///         let mut row = vec![0.0; context.proposed.len()];
///         for dimension in 0..row.len() {
///             for sign in [1.0, -1.0] {
///                 row[dimension] = sign;
///                 rows.push(&row, self.0)?;
///             }
///             row[dimension] = 0.0;
///         }
///         Ok(())
///     }
/// }
///
/// shield_api::export_plugin! {
///     abort_rule "acme/gentle" => Gentle { description: "Forbids pushing hard", deterministic: true }
/// }
/// # let context = RuleContext { step: 0, observation: &[], proposed: &[0.7], previous: None, values: &[],
/// #     greedy_values: &[], forward_values: &[], discount: 0.99, ..RuleContext::default() };
/// # let mut buffer = [0; 80];
/// # let verdict = Gentle(0.5).evaluate(&context, &mut Reason::new(&mut buffer)).unwrap();
/// # assert_eq!(verdict.verdict, Verdict::Reject);
/// ```
#[allow(unused_variables, reason = "the defaults name their arguments for whoever writes others")]
pub trait AbortRule: Checkpoint {
    /// What must be computed before the rule is asked. Called once; the answer must not change.
    fn needs(&self) -> Needs;

    /// Judges the proposed action, and writes into `reason` why it is rejected. Pure: the same context gives the same
    /// verdict. Allocates nothing.
    ///
    /// # Errors
    /// Anything that keeps the rule from judging; the host then rejects the action.
    fn evaluate(&self, context: &RuleContext<'_>, reason: &mut Reason<'_>) -> Result<RuleVerdict>;

    /// The rule near the proposed action as rows `A a ≤ b`, so that an action can be found that it allows. `gradients` holds
    /// ∂P/∂action of each member where the rule needs probabilities, else ∂Q_reset/∂action of each member, `members × action_len`,
    /// row-major; empty if the rule needs neither.
    ///
    /// # Errors
    /// [`ErrorKind::Unsupported`](crate::ErrorKind::Unsupported) by default: the action is then aborted, not altered.
    fn linearise(&self, context: &RuleContext<'_>, gradients: &[f32], rows: &mut dyn Rows) -> Result<()> {
        Err(Error::unsupported("linearising the rule"))
    }

    /// What became of the step's decision. Called once per forward step, after the decision. Here and in
    /// [`observe_attempt`](Self::observe_attempt) a rule changes its state, and nowhere else.
    ///
    /// # Errors
    /// Anything that keeps the rule from going on; the run ends.
    fn observe(&mut self, decision: &ObservedDecision<'_>) -> Result<()> {
        Ok(())
    }

    /// How an attempt to reset ended. Called once after each attempt that has an outcome: not after one that was cut short.
    ///
    /// # Errors
    /// Anything that keeps the rule from going on; the run ends.
    fn observe_attempt(&mut self, attempt: &ObservedAttempt) -> Result<()> {
        Ok(())
    }
}
