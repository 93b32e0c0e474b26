//! A rejected action, in whose place another one is looked for.

use super::{Agents, Moment, clock::Clock, jury::Jury};
use crate::decision::{Abort, Cause};

/// A rejected action and whom to ask about another one.
pub(super) struct Rejected<'a, 'b> {
    pub jury: &'a mut Jury,
    pub agents: &'a mut Agents<'b>,
    pub moment: &'a Moment<'a>,
    pub proposed: &'a [f32],
    pub rejection: Abort,
    pub clock: Clock,
}

/// Why there is no other action: the cause, and what there is to say about it.
pub(super) type Failure = (Cause, String);
