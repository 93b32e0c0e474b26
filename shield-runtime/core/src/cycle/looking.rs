//! What can be asked of a cycle.

use shield_api::{Learner, SuccessCritic, metrics::Metrics};

use super::{CycleParts, HardResetDue, ResetCycle};
use crate::{
    agent::{Agent, ForwardAgent},
    critic::Critic,
    decision::Decision,
    events::{Counters, DecisionEvent},
    experience::AgentRole,
    settings::AttemptLength,
    shield::Ladder,
};

/// The last decision, to be reported.
#[derive(Clone, Copy)]
pub struct Deliberation<'a> {
    /// Everything that was counted.
    pub counters: &'a Counters,
    /// In which the action was decided.
    pub observation: &'a [f32],
    /// What was proposed; NaN where the forward agent failed.
    pub proposed: &'a [f32],
    /// The action that was executed before; `None` after a hard reset. Once a step is observed, it is that step's.
    pub previous: Option<&'a [f32]>,
    /// What may be executed.
    pub action: &'a [f32],
    /// What decided; `None` in all modes but `Shielded`.
    pub ladder: Option<&'a Ladder>,
}

impl<'a> Deliberation<'a> {
    /// What is reported of the decision on this agent's action; `None` where nothing decides.
    pub fn event(&self, role: AgentRole, decision: Decision) -> Option<DecisionEvent<'a>> {
        let projected = decision.projection().map(|projection| projection.rejection);
        // A rejected action of the reset agent has given way to another; one of the forward agent ends its episode.
        let is_executed = decision.abort().is_none() || role == AgentRole::Reset;
        Some(DecisionEvent {
            step: self.counters.steps,
            role,
            decision,
            rejection: decision.abort().or(projected),
            observation: self.observation,
            proposed: self.proposed,
            previous: self.previous,
            executed: is_executed.then_some(self.action),
            judgement: self.ladder?.judgement(),
            state: None,
        })
    }
}

/// Who is evaluated, and what decides in training.
#[derive(Default)]
pub struct Evaluated<'a> {
    /// Does the task.
    pub forward: Option<&'a mut ForwardAgent>,
    /// Undoes it.
    pub reset: Option<&'a mut (dyn Learner + 'a)>,
    /// Estimates how likely that succeeds.
    pub success: Option<&'a mut (dyn SuccessCritic + 'a)>,
    /// Its rules have adapted to what happened.
    pub ladder: Option<&'a mut Ladder>,
}

impl CycleParts {
    /// Both agents, the success critic and what decides, to be evaluated.
    pub fn agents(&mut self) -> Evaluated<'_> {
        Evaluated {
            forward: self.forward.as_mut(),
            reset: self.reset.as_mut().map(Agent::learner),
            success: self.success.as_mut().map(Critic::critic),
            ladder: self.ladder.as_mut(),
        }
    }
}

impl ResetCycle {
    /// Whose episode it is, or the next one.
    pub fn turn(&self) -> AgentRole {
        self.turn
    }

    /// Why nothing may move before a hard reset, if that is so.
    pub fn hard_reset_due(&self) -> Option<HardResetDue> {
        self.hard_reset_due
    }

    /// Whether a start was ever observed.
    pub fn is_placed(&self) -> bool {
        self.is_placed
    }

    /// Steps of the present episode.
    pub fn episode_length(&self) -> u64 {
        self.episode.map_or(0, |episode| episode.length)
    }

    /// Steps after which the present attempt, or the next one, is over.
    pub fn attempt_length(&self) -> u64 {
        let most = self.settings.episode_length;
        match self.settings.attempt_length {
            AttemptLength::Episode => most,
            AttemptLength::Steps(steps) => steps,
            AttemptLength::Adaptive => self.attempts.granted(most),
        }
    }

    /// Everything that was counted.
    pub fn counters(&self) -> &Counters {
        &self.counters
    }

    /// Attempts that reached the reset set.
    pub fn reset_successes(&self) -> u64 {
        self.reset_successes
    }

    /// Where the last action was decided on.
    pub fn observation(&self) -> &[f32] {
        &self.observation
    }

    /// What may be executed.
    pub fn action(&self) -> &[f32] {
        &self.action
    }

    /// What decides; `None` in all modes but `Shielded`.
    pub fn ladder(&self) -> Option<&Ladder> {
        self.parts.ladder.as_ref()
    }

    /// Whether a plugin that the shield needs is out of service: from now on everything is aborted.
    pub fn is_broken(&self) -> bool {
        self.parts.ladder.as_ref().is_some_and(Ladder::is_broken)
    }

    /// What the plugins have reported, each name of an agent's preceded by its role, such as `reset/critic_loss`.
    pub fn metrics(&self) -> &Metrics {
        &self.metrics
    }

    /// The last decision, beside the agent that values actions.
    pub fn last(&mut self) -> (Deliberation<'_>, Option<&mut dyn Learner>) {
        let CycleParts { reset, ladder, .. } = &mut self.parts;
        let deliberation = Deliberation {
            counters: &self.counters,
            observation: &self.observation,
            proposed: &self.proposed,
            previous: self.has_previous.then_some(&self.previous),
            action: &self.action,
            ladder: ladder.as_ref(),
        };
        (deliberation, reset.as_mut().map(Agent::learner))
    }

    /// Both agents, the success critic and what decides, to be evaluated.
    pub fn agents(&mut self) -> Evaluated<'_> {
        self.parts.agents()
    }

    /// Who takes part.
    pub fn parts(&self) -> &CycleParts {
        &self.parts
    }

    /// The same, when the cycle has come to its end.
    pub fn into_parts(self) -> CycleParts {
        self.parts
    }
}
