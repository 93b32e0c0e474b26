//! Where the loop asks the shield, and what it reports of the answer.

use std::time::Instant;

use super::JointLoop;
use crate::observer::Scene;
use shield_core::{
    cycle::Deliberation,
    decision::{Abort, Decision},
    events::{DecisionEvent, Intervention},
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
        let projection = decision.projection();
        let rejection = decision.abort().or(projection.map(|projection| projection.rejection));
        let (last, reset) = self.cycle.last();
        let Deliberation { observation, proposed, previous, action, .. } = last;
        let Some(ladder) = last.ladder else { return Ok(()) };
        let step = last.counters.steps;
        // A rejected action of the reset agent has given way to another; one of the forward agent ends its episode.
        let is_executed = decision.abort().is_none() || role == AgentRole::Reset;
        if self.settings.record.takes(step, rejection.is_some()) {
            self.observer.on_decision(&DecisionEvent {
                step,
                role,
                decision,
                rejection,
                observation,
                proposed,
                previous,
                executed: is_executed.then_some(action),
                judgement: ladder.judgement(),
                state: (!self.state.is_empty()).then_some(&self.state),
            })?;
        }
        let Some(abort) = rejection else { return Ok(()) };
        let intervention = Intervention {
            step,
            role,
            proposed,
            executed: is_executed.then_some(action),
            abort,
            projection,
            reason: ladder.reason(),
        };
        self.observer.on_intervention(&intervention, &mut Scene { world: &mut self.world, reset })
    }
}
