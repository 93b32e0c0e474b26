//! Success critics: how likely an action can be undone.

use crate::{Checkpoint, Error, Result};

/// What a success critic is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SuccessCriticInfo {
    /// Size of the ensemble, at least 1.
    pub members: usize,
}

/// Transitions of one update, row by row, with what became of the attempts that followed.
#[derive(Debug, Clone, Copy)]
pub struct AttemptBatch<'a> {
    /// How many transitions.
    pub size: usize,
    /// States, `size × observation length`.
    pub observations: &'a [f32],
    /// Executed actions, `size × action length`.
    pub actions: &'a [f32],
    /// States that followed, `size × observation length`.
    pub next_observations: &'a [f32],
    /// What the reset agent does in them, `size × action length`: its greedy action, or 0 where the next state does not count.
    pub next_actions: &'a [f32],
    /// 1 where the next state lies in the reset set, so that the action was undone; `size`.
    pub successes: &'a [f32],
    /// 1 where the estimate in the next state counts, 0 where nothing follows; `size`. A transition with neither success nor
    /// continuation could not be undone.
    pub continuations: &'a [f32],
    /// 1 if the attempt that the transition belongs to, or that followed it directly, reached the reset set, else 0; `size`.
    pub outcomes: &'a [f32],
    /// How much the outcome counts, from 0 (there is none) to 1; `size`.
    pub outcome_weights: &'a [f32],
    /// 1 where the member learns from the transition, else 0; `size × members`.
    pub masks: &'a [f32],
}

/// Estimates the undo probability P(s, a): how likely the reset agent, in charge after `a`, reaches the reset set within its attempt.
/// It judges whatever reset agent there is, learned or given. See `plugins/success-critic` for one.
#[allow(unused_variables, reason = "the defaults name their arguments for authors who write others")]
pub trait SuccessCritic: Checkpoint {
    /// Size of the ensemble.
    fn info(&self) -> SuccessCriticInfo;

    /// Writes P(s, a) in \[0, 1\], one value per member.
    ///
    /// # Errors
    /// A length is wrong, or the estimate failed.
    fn probabilities(&mut self, observation: &[f32], action: &[f32], probabilities: &mut [f32])
    -> Result<()>;

    /// The same, and ∂P/∂action: `members × action length`, row by row.
    ///
    /// # Errors
    /// As above, or it has no gradient.
    fn gradients(
        &mut self,
        observation: &[f32],
        action: &[f32],
        probabilities: &mut [f32],
        gradients: &mut [f32],
    ) -> Result<()> {
        Err(Error::unsupported("the gradient of the undo probability with respect to the action"))
    }

    /// Learns from a batch.
    ///
    /// # Errors
    /// A length is wrong, or the estimates became NaN.
    fn update(&mut self, batch: &AttemptBatch<'_>) -> Result<()>;
}
