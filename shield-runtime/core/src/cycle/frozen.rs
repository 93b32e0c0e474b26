//! A second cycle by the same shield, in which nothing learns.

use shield_api::Spaces;

use super::{CycleParts, CycleSettings, ResetCycle};
use crate::shield::Ladder;

impl ResetCycle {
    /// A cycle before its first start that acts as this one, without exploring. It can decide once it has [what decides](Self::take_deciders).
    pub(crate) fn without_parts(&self, spaces: &Spaces) -> Self {
        let settings = CycleSettings { explores: false, values_attempts: false, ..self.settings.clone() };
        Self::new(settings, CycleParts::default(), [spaces.observation_len(), spaces.action_len()])
    }

    /// Takes over what decides and who undoes; each keeps its own experience.
    pub(crate) fn take_deciders(&mut self, of: &mut Self) {
        let (own, other) = (&mut self.parts, &mut of.parts);
        std::mem::swap(&mut own.ladder, &mut other.ladder);
        std::mem::swap(&mut own.reset, &mut other.reset);
        std::mem::swap(&mut own.success, &mut other.success);
    }

    /// Stands where another cycle does in training: its counts decide whether a warm-up is over, its attempts how long one may be.
    pub(crate) fn follow(&mut self, of: &Self) {
        (self.counters, self.reset_successes, self.attempts) = (of.counters, of.reset_successes, of.attempts);
    }

    /// What decides.
    pub(crate) fn ladder_mut(&mut self) -> Option<&mut Ladder> {
        self.parts.ladder.as_mut()
    }
}
