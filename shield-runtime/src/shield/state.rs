//! Keeping what a shield has learned and counted.

use serde::{Deserialize, Serialize};
use shield_api::{AbortRule, Error, Result};

use super::{Ladder, Shield};
use crate::{agent::AgentState, plugin_state::PluginState};

/// What outlives a program: the reset agent, the rules and the counts. Not where the robot stands.
#[derive(Serialize, Deserialize)]
pub(crate) struct ShieldState {
    agent: AgentState,
    rules: Vec<PluginState>,
    steps: u64,
    exploration_replaced: u64,
}

impl Shield {
    pub(crate) fn save(&mut self) -> Result<ShieldState> {
        Ok(ShieldState {
            agent: self.reset_agent.save()?,
            rules: save_rules(Some(&mut self.ladder))?,
            steps: self.steps,
            exploration_replaced: self.exploration_replaced,
        })
    }

    /// Goes on from what was saved. Who calls it requires a hard reset before: where the world stands is not known.
    pub(crate) fn restore(&mut self, state: &ShieldState) -> Result<()> {
        self.reset_agent.restore(&state.agent)?;
        restore_rules(Some(&mut self.ladder), &state.rules)?;
        (self.steps, self.exploration_replaced) = (state.steps, state.exploration_replaced);
        Ok(())
    }
}

/// The states of rules: all that a shield's ladder carries from one decision to the next.
pub(crate) fn save_rules(shield: Option<&mut Ladder>) -> Result<Vec<PluginState>> {
    let rules = shield.into_iter().flat_map(Ladder::rules);
    rules.map(|rule: &mut dyn AbortRule| PluginState::of(rule)).collect()
}

/// Gives rules their states. There must be one for each.
pub(crate) fn restore_rules(shield: Option<&mut Ladder>, states: &[PluginState]) -> Result<()> {
    let mut rules: Vec<_> = shield.into_iter().flat_map(Ladder::rules).collect();
    if rules.len() != states.len() {
        let (found, own) = (states.len(), rules.len());
        return Err(Error::invalid_argument(format!(
            "it has the states of {found} rules; here there are {own}"
        )));
    }
    rules.iter_mut().zip(states).try_for_each(|(rule, state)| state.restore(*rule))
}
