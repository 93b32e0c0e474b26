//! How many of the steps are the task's, looked at early: a user should not wait for dozens of attempts to hear that they take all the time.

use serde::{Deserialize, Serialize};

use super::{Finding, SETTLED_STEPS};
use crate::experience::AgentRole;

/// Steps that are looked at together. With those before which nothing is judged, they are fewer than 2,000.
const STEPS: u32 = 950;
/// The share of them below which the task gets too few. Where the shield helped in the end, it had a third at this time.
const FEW: f64 = 0.25;
/// Attempts that must have ended meanwhile: of one that takes all the time nothing follows for the next.
const FEWEST_ATTEMPTS: u32 = 3;

/// The present group of steps.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
pub(super) struct ForwardShare {
    steps: u32,
    forward: u32,
    attempts: u32,
    successes: u32,
    ended: u32,
    /// Groups before this one.
    groups: u32,
}

impl ForwardShare {
    /// A step was made, the `number`-th of all. Returns whether the group that it completes had too few steps of the forward agent.
    pub fn step(&mut self, role: AgentRole, number: u64) -> Option<(bool, Finding)> {
        if number <= SETTLED_STEPS {
            return None;
        }
        self.steps += 1;
        self.forward += u32::from(role == AgentRole::Forward);
        if self.steps < STEPS {
            return None;
        }
        let Self { steps, forward, attempts, successes, ended, groups } = *self;
        *self = Self { groups: groups.saturating_add(1), ..Self::default() };
        let holds = f64::from(forward) < FEW * f64::from(steps) && attempts >= FEWEST_ATTEMPTS;
        Some((holds, Finding::FewForwardSteps { forward, steps, attempts, successes, ended }))
    }

    /// An attempt ended, in which the environment did or not.
    pub fn attempt(&mut self, has_reset: bool, is_end: bool) {
        self.attempts += 1;
        self.successes += u32::from(has_reset);
        self.ended += u32::from(is_end);
    }

    /// Whether the group that was completed last was the first one. Later, whole attempts tell more, and a reset agent that learns may need
    /// most of the steps for a while.
    pub fn is_first_look(&self) -> bool {
        self.groups == 1
    }
}
