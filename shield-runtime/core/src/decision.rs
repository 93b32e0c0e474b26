//! What the shield can decide, and why.

use std::fmt;

/// The shield's word on a proposed action.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Decision {
    /// Every rule allows it: execute it.
    Allow,
    /// Only rules that need nothing learned were asked (`warm_up_steps`): execute it.
    WarmUp,
    /// A rule rejects it; the caller's buffer holds another action, which every rule allows: execute that one.
    Project(Projection),
    /// It must not be executed; the caller's buffer holds the reset agent's action instead.
    Abort(Abort),
    /// The reset agent is in charge: nothing was decided, the caller's buffer holds its action. Only of a [`Shield`](crate::shield::Shield).
    Resetting,
}

impl Decision {
    /// The abort, if it is one.
    pub fn abort(&self) -> Option<Abort> {
        match self {
            Self::Abort(abort) => Some(*abort),
            Self::Allow | Self::WarmUp | Self::Project(_) | Self::Resetting => None,
        }
    }

    /// The projection, if it is one.
    pub fn projection(&self) -> Option<Projection> {
        match self {
            Self::Project(projection) => Some(*projection),
            Self::Allow | Self::WarmUp | Self::Abort(_) | Self::Resetting => None,
        }
    }
}

/// How a rejected action became one that every rule allows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Projection {
    /// Where the other action comes from.
    pub kind: ProjectionKind,
    /// How often the rules were linearised; 0 without a program.
    pub iterations: u32,
    /// How far it lies from the proposed one: √ Σ weight · movement²; 0 between discrete actions.
    pub distance: f32,
    /// Why the proposed action was rejected.
    pub rejection: Abort,
}

/// Where a projected action comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ProjectionKind {
    /// The solution of a quadratic program.
    Qp,
    /// The reset agent's greedy action.
    Replace,
    /// The allowed discrete action of the highest forward value.
    Best,
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
    /// An abort that is not the doing of a rule.
    pub fn without_rule(cause: Cause) -> Self {
        Self { cause, rule: None, score: f32::NAN }
    }
}

/// The classes of reasons for an abort. Where [`is_failure`](Self::is_failure) says so, it is not the method at work but the shield failing
/// closed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Cause {
    /// A rule rejected the action.
    Rejected,
    /// A rule rejected the action, and no action keeps all rows.
    Infeasible,
    /// A rule rejected the action, and every action that was found instead.
    StillRejected,
    /// A rule rejected the action, and some rule cannot be linearised.
    NotLinearisable,
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
    /// The reset ensemble gave no gradients, or gradients that are not finite.
    GradientsFailed,
    /// A rule gave no rows, or rows that are not finite or of the wrong length.
    RowsFailed,
    /// The solver found no solution, or one that does not keep the rows.
    NotConverged,
    /// The solver panicked.
    SolverPanicked,
    /// The decision took longer than its deadline.
    Deadline,
    /// The reset agent, which is in charge, gave no action.
    ResetFailed,
    /// The reset agent has given up, and nobody has put everything back yet.
    AwaitsHardReset,
}

impl Cause {
    /// Whether something failed, rather than a rule having its way.
    pub fn is_failure(self) -> bool {
        !matches!(self, Self::Rejected | Self::Infeasible | Self::StillRejected | Self::NotLinearisable)
    }

    /// What the solver said of the last program of an abort; `None` if it was not asked or its word is not known.
    pub fn solver_status(self) -> Option<&'static str> {
        match self {
            Self::Infeasible => Some("infeasible"),
            Self::NotConverged => Some("not_converged"),
            Self::SolverPanicked => Some("panicked"),
            _ => None,
        }
    }

    /// Its name in records and in other languages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Rejected => "rejected",
            Self::Infeasible => "infeasible",
            Self::StillRejected => "still_rejected",
            Self::NotLinearisable => "not_linearisable",
            Self::InvalidObservation => "invalid_observation",
            Self::InvalidAction => "invalid_action",
            Self::ForwardFailed => "forward_failed",
            Self::ValuesFailed => "values_failed",
            Self::RuleFailed => "rule_failed",
            Self::GradientsFailed => "gradients_failed",
            Self::RowsFailed => "rows_failed",
            Self::NotConverged => "not_converged",
            Self::SolverPanicked => "solver_panicked",
            Self::Deadline => "deadline",
            Self::ResetFailed => "reset_failed",
            Self::AwaitsHardReset => "awaits_hard_reset",
        }
    }
}

impl fmt::Display for Cause {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(self.name())
    }
}
