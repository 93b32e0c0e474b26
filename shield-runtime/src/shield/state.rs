//! Keeping what a shield has learned and counted.

use serde::{Deserialize, Serialize};
use shield_api::Result;

use super::Shield;
use crate::{
    agent::AgentState,
    checkpoint::{PluginState, restore_rules, save_rules},
};

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

    /// Goes on from what was saved, in a world whose state is not known: a hard reset is needed.
    pub(crate) fn restore(&mut self, state: &ShieldState) -> Result<()> {
        self.reset_agent.restore(&state.agent)?;
        restore_rules(Some(&mut self.ladder), &state.rules)?;
        (self.steps, self.exploration_replaced) = (state.steps, state.exploration_replaced);
        self.require_hard_reset();
        Ok(())
    }
}
