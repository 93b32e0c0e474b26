//! What the shield can decide, and why.

use std::fmt;

/// The shield's word on a proposed action.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Decision {
    /// Every rule allows it: execute it.
    Allow,
    /// Nothing is aborted yet (`warm_up_steps`): execute it.
    WarmUp,
    /// It must not be executed; the caller's buffer holds the reset agent's action instead.
    Abort(Abort),
}

impl Decision {
    /// The abort, if it is one.
    pub fn abort(&self) -> Option<Abort> {
        match self {
            Self::Abort(abort) => Some(*abort),
            Self::Allow | Self::WarmUp => None,
        }
    }
}

/// Why an action was rejected.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Abort {
    /// The class of the reason.
    pub cause: Cause,
    /// Which rule rejected or failed, as an index into the experiment's list.
    pub rule: Option<usize>,
    /// The figure that the rule compared; NaN where there is none.
    pub score: f32,
}

impl Abort {
    pub(crate) fn without_rule(cause: Cause) -> Self {
        Self { cause, rule: None, score: f32::NAN }
    }
}

/// The classes of reasons for an abort. Only the first is the method at work; the others are the shield failing closed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Cause {
    /// A rule rejected the action.
    Rejected,
    /// The observation has the wrong length or is not finite.
    InvalidObservation,
    /// The action has the wrong length, is not finite, or is outside the action space.
    InvalidAction,
    /// The forward agent gave no action.
    ForwardFailed,
    /// The reset or the forward ensemble gave no values, or values that are not finite.
    ValuesFailed,
    /// A rule failed, or its score is NaN.
    RuleFailed,
}

impl fmt::Display for Cause {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(match self {
            Self::Rejected => "rejected",
            Self::InvalidObservation => "invalid_observation",
            Self::InvalidAction => "invalid_action",
            Self::ForwardFailed => "forward_failed",
            Self::ValuesFailed => "values_failed",
            Self::RuleFailed => "rule_failed",
        })
    }
}
