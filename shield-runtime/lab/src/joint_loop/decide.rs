//! Where the loop asks the shield, and what it reports of the answer.

use std::time::Instant;

use super::JointLoop;
use crate::observer::Scene;
use shield_core::{
    decision::{Abort, Decision},
    events::DecisionEvent,
    experience::AgentRole,
};

impl JointLoop<'_> {
    /// Lets the forward agent propose and the shield decide. Returns why the proposed action must not be executed, if so.
    pub(super) fn propose(&mut self) -> anyhow::Result<Option<Abort>> {
        let observation = self.world.observation();
        self.cycle.propose(observation)?;
        if self.cycle.ladder().is_none() {
            self.cycle.decide(observation);
            return Ok(None);
        }
        let start = Instant::now();
        let decision = self.cycle.decide(observation);
        self.observer.on_decision_time(start.elapsed());
        self.state.clear();
        if self.settings.record.takes_state(self.cycle.counters().steps) {
            self.world.save_environment(&mut self.state)?;
        }
        self.report(AgentRole::Forward, decision)?;
        if self.cycle.is_broken() {
            let reason = self.cycle.ladder().map_or("", |ladder| ladder.reason());
            anyhow::bail!("the shield cannot decide any more: {reason}");
        }
        Ok(decision.abort())
    }

    /// Lets the reset agent act; where its exploration is shielded, a rejected action gives way to its greedy one.
    pub(super) fn act_to_reset(&mut self) -> anyhow::Result<Option<Abort>> {
        if let Some(decision) = self.cycle.act_to_reset(self.world.observation())? {
            self.state.clear();
            self.report(AgentRole::Reset, decision)?;
        }
        Ok(None)
    }

    /// Reports a decision, and the intervention that it is.
    fn report(&mut self, role: AgentRole, decision: Decision) -> anyhow::Result<()> {
        let (last, reset) = self.cycle.last();
        let (Some(event), Some(ladder)) = (last.event(role, decision), last.ladder) else { return Ok(()) };
        if self.settings.record.takes(event.step, event.rejection.is_some()) {
            let state = (!self.state.is_empty()).then_some(self.state.as_slice());
            self.observer.on_decision(&DecisionEvent { state, ..event })?;
        }
        let Some(intervention) = event.intervention(ladder.reason()) else { return Ok(()) };
        self.observer.on_intervention(&intervention, &mut Scene { world: &mut self.world, reset })
    }
}
