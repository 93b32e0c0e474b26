//! Keeping what a cycle remembers between two steps, and going on from it.

use serde::{Deserialize, Serialize};
use shield_api::{AbortRule, Error, Result};

use super::{CycleParts, ResetCycle, attempts::AttemptLengths, undoing::SinceReset};
use crate::{
    agent::{Agent, AgentState, ForwardAgent},
    critic::{Critic, CriticState},
    diagnosis::Diagnosis,
    events::{Counters, Tally},
    experience::{AgentRole, UndoMemoryState},
    plugin_state::PluginState,
    shield::Ladder,
};

/// Where a cycle stands between two steps, within an episode.
#[derive(Serialize, Deserialize)]
pub struct CycleState {
    turn: AgentRole,
    tally: Tally,
    failed_attempts: u32,
    was_irreversible: bool,
    previous: Option<Vec<f32>>,
}

/// What the agents and the rules have learned.
#[derive(Serialize, Deserialize)]
pub struct LearnedState {
    /// The forward agent's, where there is one.
    pub forward: Option<AgentState>,
    /// The reset agent's, where there is one.
    pub reset: Option<AgentState>,
    /// One for each rule.
    pub rules: Vec<PluginState>,
}

/// What belongs to undo probabilities. A state of version 1.0 has none.
#[derive(Default, Serialize, Deserialize)]
pub struct UndoState {
    /// The success critic's.
    pub critic: Option<CriticState>,
    memory: Option<UndoMemoryState>,
    since_reset: SinceReset,
    start_probabilities: Option<Vec<f32>>,
    diagnosis: Diagnosis,
    attempts: AttemptLengths,
}

impl UndoState {
    /// Reads it as the last field of a state; one that was written before there was any ends before it.
    ///
    /// # Errors
    /// None: what cannot be read is taken for missing. A checksum guards what is there.
    pub fn or_none<'de, D: serde::Deserializer<'de>>(reader: D) -> Result<Self, D::Error> {
        Ok(Self::deserialize(reader).unwrap_or_default())
    }
}

impl CycleState {
    /// The action that was executed before; `None` after a hard reset.
    pub fn previous(&self) -> Option<&[f32]> {
        self.previous.as_deref()
    }
}

/// Says which field of the experiment names the plugin that refuses its state.
pub fn of_plugin(field: &str, restored: Result<()>) -> Result<()> {
    restored.map_err(|error| Error::new(error.kind(), format!("`{field}`: {error}")))
}

impl CycleParts {
    /// What the agents and the rules have learned.
    ///
    /// # Errors
    /// A plugin fails to save its state.
    pub fn save(&mut self) -> Result<LearnedState> {
        Ok(LearnedState {
            forward: self.forward.as_ref().map(ForwardAgent::save).transpose()?,
            reset: self.reset.as_ref().map(Agent::save).transpose()?,
            rules: save_rules(self.ladder.as_mut())?,
        })
    }

    /// Gives both agents and the rules what they had learned.
    ///
    /// # Errors
    /// A plugin refuses its state.
    pub fn restore(&mut self, state: &LearnedState) -> Result<()> {
        if let (Some(forward), Some(state)) = (&mut self.forward, &state.forward) {
            of_plugin("forward", forward.restore(state))?;
        }
        if let (Some(reset), Some(state)) = (&mut self.reset, &state.reset) {
            of_plugin("reset", reset.restore(state))?;
        }
        of_plugin("shield.rules", restore_rules(self.ladder.as_mut(), &state.rules))
    }
}

impl ResetCycle {
    /// Where the cycle stands.
    pub fn save(&self) -> CycleState {
        CycleState {
            turn: self.turn,
            tally: self.episode.unwrap_or_default(),
            failed_attempts: self.failed_attempts,
            was_irreversible: self.was_irreversible,
            previous: self.has_previous.then(|| self.previous.clone()),
        }
    }

    /// Goes on within the episode in which `state` was saved, with actions of the same length.
    pub fn go_on(&mut self, state: &CycleState) {
        if let Some(previous) = &state.previous {
            self.previous.copy_from_slice(previous);
        }
        self.has_previous = state.previous.is_some();
        (self.turn, self.episode) = (state.turn, Some(state.tally));
        (self.failed_attempts, self.was_irreversible) = (state.failed_attempts, state.was_irreversible);
        (self.is_placed, self.hard_reset_due) = (true, None);
    }

    /// Goes on from what was counted.
    pub fn restore_counts(&mut self, counters: Counters, reset_successes: u64) {
        (self.counters, self.reset_successes) = (counters, reset_successes);
    }

    /// Who takes part, to be saved or restored.
    pub fn parts_mut(&mut self) -> &mut CycleParts {
        &mut self.parts
    }
}

impl CycleParts {
    /// Gives the success critic and the experience what they had learned.
    ///
    /// # Errors
    /// The plugin refuses its state, or it is that of other spaces.
    pub fn restore_undo(&mut self, state: &UndoState) -> Result<()> {
        if let (Some(success), Some(state)) = (&mut self.success, &state.critic) {
            of_plugin("shield.success_critic", success.restore(state))?;
        }
        match (&mut self.memory, &state.memory) {
            (Some(memory), Some(state)) => memory.experience.restore_undo(state),
            _ => Ok(()),
        }
    }
}

impl ResetCycle {
    /// What belongs to undo probabilities.
    ///
    /// # Errors
    /// The success critic fails to save its state.
    pub fn save_undo(&self) -> Result<UndoState> {
        let CycleParts { success, memory, ladder, .. } = &self.parts;
        Ok(UndoState {
            critic: success.as_ref().map(Critic::save).transpose()?,
            memory: memory.as_ref().and_then(|memory| memory.experience.save_undo()),
            since_reset: self.since_reset,
            start_probabilities: ladder
                .as_ref()
                .and_then(|ladder| ladder.start_probabilities().map(<[f32]>::to_vec)),
            diagnosis: self.diagnosis,
            attempts: self.attempts,
        })
    }

    /// Goes on from what was counted and found: nothing is told twice, and the next attempt is as long as it would have been.
    pub fn restore_diagnosis(&mut self, state: &UndoState) {
        (self.diagnosis, self.attempts) = (state.diagnosis, state.attempts);
    }

    /// Goes on within the episode in which `state` was saved; what was learned is [restored](CycleParts::restore_undo) apart.
    pub fn go_on_undoing(&mut self, state: &UndoState) {
        self.since_reset = state.since_reset;
        self.restore_diagnosis(state);
        if let Some(ladder) = &mut self.parts.ladder {
            ladder.go_on_from(state.start_probabilities.as_deref());
        }
    }
}

/// The states of rules: all that a ladder carries from one decision to the next.
pub fn save_rules(ladder: Option<&mut Ladder>) -> Result<Vec<PluginState>> {
    let rules = ladder.into_iter().flat_map(Ladder::rules);
    rules.map(|rule: &mut dyn AbortRule| PluginState::of(rule)).collect()
}

/// Gives rules their states. There must be one for each.
pub fn restore_rules(ladder: Option<&mut Ladder>, states: &[PluginState]) -> Result<()> {
    let mut rules: Vec<_> = ladder.into_iter().flat_map(Ladder::rules).collect();
    if rules.len() != states.len() {
        let (found, own) = (states.len(), rules.len());
        return Err(Error::invalid_argument(format!(
            "it has the states of {found} rules; here there are {own}"
        )));
    }
    rules.iter_mut().zip(states).try_for_each(|(rule, state)| state.restore(*rule))
}
