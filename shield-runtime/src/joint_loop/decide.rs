//! Where the loop asks the shield, and what it tells of the answer.

use std::time::Instant;

use shield_api::{ActMode, Error, ErrorKind};

use super::JointLoop;
use crate::{
    agent::ForwardAgent,
    decision::{Abort, Cause, Decision},
    experience::{AgentRole, AgentShare, Transition},
    record::{DecisionRecord, Intervention},
    shield::{Agents, Moment},
};

impl JointLoop<'_> {
    /// The mean of the reset ensemble's values of its greedy action in the present state.
    pub(super) fn reset_value(&mut self) -> anyhow::Result<f32> {
        let reset = self.reset.as_mut().expect("modes with reset episodes have a reset agent");
        let observation = self.world.observation();
        self.values.resize(reset.info().members, 0.0);
        reset.learner().act(observation, ActMode::Greedy, &mut self.action)?;
        reset.learner().q_values(observation, &self.action, &mut self.values)?;
        Ok(self.values.iter().sum::<f32>() / self.values.len() as f32)
    }

    /// Lets the forward agent propose and the shield decide; afterwards `action` may be executed, unless there was an abort.
    pub(super) fn propose(&mut self) -> anyhow::Result<Option<Abort>> {
        let forward = self.forward.as_mut().expect("modes with forward episodes have a forward agent");
        let observation = self.world.observation();
        let acted = forward.act(observation, ActMode::Explore, &mut self.action);
        let (Some(shield), Some(reset)) = (&mut self.shield, &mut self.reset) else {
            return acted.map(|()| None).map_err(Into::into);
        };
        let failure = acted.err();
        if let Some(error) = &failure {
            // A panicked plugin never acts again; any other failure may pass, and must not be executed meanwhile.
            if error.kind() == ErrorKind::Panicked {
                return Err(error.clone().into());
            }
            self.action.fill(f32::NAN);
        }
        self.proposed.copy_from_slice(&self.action);
        let start = Instant::now();
        let moment = Moment {
            step: self.counters.steps,
            observation,
            previous: self.has_previous.then_some(&self.previous),
        };
        let agents = Agents { reset: reset.learner(), forward: forward.learner() };
        let decision = shield.filter(agents, &moment, &mut self.action);
        self.observer.on_decision_time(start.elapsed());
        self.state.clear();
        if self.settings.record.takes_state(moment.step) {
            self.world.save_environment(&mut self.state)?;
        }
        self.counters.warm_up_decisions += u64::from(decision == Decision::WarmUp);
        let projection = decision.projection();
        let failure = failure.as_ref().map(Error::message);
        let mut rejection = decision.abort().or(projection.map(|projection| projection.rejection));
        if let (Some(rejection), Some(_)) = (&mut rejection, failure) {
            rejection.cause = Cause::ForwardFailed;
        }
        if self.settings.record.takes(moment.step, rejection.is_some()) {
            self.observer.on_decision(&DecisionRecord {
                step: moment.step,
                role: AgentRole::Forward,
                decision,
                rejection,
                observation,
                proposed: &self.proposed,
                previous: moment.previous,
                executed: decision.abort().is_none().then_some(&self.action),
                judgement: shield.judgement(),
                state: (!self.state.is_empty()).then_some(&self.state),
            })?;
        }
        let Some(rejection) = rejection else { return Ok(None) };
        self.counters.projections += u64::from(projection.is_some());
        self.observer.on_intervention(&Intervention {
            step: self.counters.steps,
            role: AgentRole::Forward,
            proposed: &self.proposed,
            executed: projection.map(|_| self.action.as_slice()),
            abort: rejection,
            projection,
            reason: failure.unwrap_or(shield.reason()),
        })?;
        anyhow::ensure!(!shield.is_broken(), "the shield cannot decide any more: {}", shield.reason());
        Ok(projection.is_none().then_some(rejection))
    }

    /// Lets the reset agent act; where its exploration is shielded, a rejected action gives way to its greedy one.
    pub(super) fn act_to_reset(&mut self) -> anyhow::Result<()> {
        let reset = self.reset.as_mut().expect("modes with reset episodes have a reset agent");
        let observation = self.world.observation();
        reset.learner().act(observation, ActMode::Explore, &mut self.action)?;
        let (Some(shield), true) = (&mut self.shield, self.settings.shield_exploration) else {
            return Ok(());
        };
        self.proposed.copy_from_slice(&self.action);
        let moment = Moment {
            step: self.counters.steps,
            observation,
            previous: self.has_previous.then_some(&self.previous),
        };
        let forward = self.forward.as_mut().and_then(ForwardAgent::learner);
        let agents = Agents { reset: reset.learner(), forward };
        let decision = shield.guard(agents, &moment, &mut self.action);
        if self.settings.record.takes(moment.step, decision.abort().is_some()) {
            self.observer.on_decision(&DecisionRecord {
                step: moment.step,
                role: AgentRole::Reset,
                decision,
                rejection: decision.abort(),
                observation,
                proposed: &self.proposed,
                previous: moment.previous,
                executed: Some(&self.action),
                judgement: shield.judgement(),
                state: None,
            })?;
        }
        if let Some(abort) = decision.abort() {
            self.counters.exploration_replaced += 1;
            self.observer.on_intervention(&Intervention {
                step: self.counters.steps,
                role: AgentRole::Reset,
                proposed: &self.proposed,
                executed: Some(&self.action),
                abort,
                projection: None,
                reason: shield.reason(),
            })?;
        }
        Ok(())
    }

    /// Lets the forward agent learn from the action that a rule rejected. What failed is not the fault of its action.
    pub(super) fn tell_of_abort(&mut self, abort: Abort) {
        let Some(reward) = self.settings.on_abort.reward().filter(|_| !abort.cause.is_failure()) else {
            return;
        };
        let observation = self.world.observation();
        let transition = Transition {
            observation,
            action: &self.proposed,
            next_observation: observation,
            forward: Some(AgentShare { reward, continues: false }),
            reset: None,
        };
        self.experience.push(&transition, &mut self.randomness.masks);
    }
}
