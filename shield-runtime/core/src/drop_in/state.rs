//! What a drop-in has learned and counted, to be kept.

use std::ops::Range;

use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};
use serde_bytes::ByteBuf;
use shield_api::Result;

use super::DropIn;
use crate::{
    agent::AgentState,
    cycle::{HardResetDue, LearnedState, Memory, UndoState},
    events::Counters,
    plugin_state::PluginState,
};

/// Tells the state from that of a run.
const KIND: &str = "shield drop-in 2";

/// Why a state cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum RestoreError {
    /// It belongs to another kind of program, or to other spaces.
    #[error("{0}")]
    Foreign(String),
    /// A plugin refuses its state.
    #[error("{0}")]
    Plugin(shield_api::Error),
}

/// The reset agent, the rules, the reset task, the experience and the counts of a drop-in. Not where the environment stands.
#[derive(Serialize, Deserialize)]
pub struct DropInState {
    kind: String,
    observation_len: usize,
    action_len: usize,
    /// As they are printed: they are only compared.
    spaces: String,
    counters: Counters,
    reset_successes: u64,
    shield: ShieldState,
    task: Option<PluginState>,
    learned: Option<MemoryState>,
    #[serde(deserialize_with = "UndoState::or_none")]
    undo: UndoState,
}

/// The reset agent, the rules, and counts of theirs.
#[derive(Serialize, Deserialize)]
struct ShieldState {
    agent: AgentState,
    rules: Vec<PluginState>,
    steps: u64,
    exploration_replaced: u64,
}

#[derive(Serialize, Deserialize)]
struct MemoryState {
    masks: Pcg64,
    row_bytes: usize,
    kept: Range<u64>,
    rows: ByteBuf,
}

impl MemoryState {
    /// Whether the rows are those that it says it keeps.
    fn is_complete(&self) -> bool {
        let count = self.kept.end.checked_sub(self.kept.start);
        let bytes = count.and_then(|count| usize::try_from(count).ok()?.checked_mul(self.row_bytes));
        bytes == Some(self.rows.len())
    }
}

impl DropIn {
    /// What was learned and counted until now.
    ///
    /// # Errors
    /// A plugin fails to save its state.
    pub fn state(&mut self) -> Result<DropInState> {
        let task = self.task.as_ref().map(|task| PluginState::of(&**task)).transpose()?;
        let (counters, reset_successes) = (*self.cycle.counters(), self.cycle.reset_successes());
        let undo = self.cycle.save_undo()?;
        let LearnedState { reset, rules, .. } = self.cycle.parts_mut().save()?;
        let learned = self.cycle.parts().memory.as_ref().map(|Memory { experience, masks }| {
            let mut rows = Vec::new();
            experience.write_rows(experience.kept(), &mut rows);
            MemoryState {
                masks: masks.clone(),
                row_bytes: experience.row_bytes(),
                kept: experience.kept(),
                rows: rows.into(),
            }
        });
        Ok(DropInState {
            kind: KIND.into(),
            observation_len: self.spaces().observation_len(),
            action_len: self.spaces().action_len(),
            spaces: format!("{:?}", self.spaces()),
            counters,
            reset_successes,
            shield: ShieldState {
                agent: reset.expect("`new` refuses a cycle without a reset agent"),
                rules,
                steps: counters.steps,
                exploration_replaced: counters.exploration_replaced,
            },
            task,
            learned,
            undo,
        })
    }

    /// Goes on from the state of a shield with the same spaces, reset agent, rules and reset task; the settings of the rules may differ, and so may
    /// the capacity of the experience: of more transitions than there is room for, the newest stay. Where the environment stands is not known: a
    /// hard reset is needed.
    ///
    /// # Errors
    /// The state belongs to another shield, or a plugin refuses its own; then a hard reset is needed too, and what was learned may be half of each.
    pub fn restore(&mut self, state: DropInState) -> Result<(), RestoreError> {
        self.require_hard_reset(HardResetDue::Lost);
        let foreign = RestoreError::Foreign;
        if state.kind != KIND {
            return Err(foreign("it is not the state of a drop-in shield".into()));
        }
        let (found, own) = (
            (state.observation_len, state.action_len),
            (self.spaces().observation_len(), self.spaces().action_len()),
        );
        if found != own {
            return Err(foreign(format!(
                "it belongs to observations of {} and actions of {} numbers; here they have {} and {}",
                found.0, found.1, own.0, own.1
            )));
        }
        if state.spaces != format!("{:?}", self.spaces()) {
            return Err(foreign("it belongs to spaces with other bounds".into()));
        }
        for (name, is_there, is_here) in [
            ("a reset task", state.task.is_some(), self.task.is_some()),
            ("a memory", state.learned.is_some(), self.cycle.parts().memory.is_some()),
            ("a success critic", state.undo.critic.is_some(), self.cycle.parts().success.is_some()),
        ] {
            if is_there != is_here {
                let (with, without) = if is_there { ("it", "this shield") } else { ("this shield", "it") };
                return Err(foreign(format!("{with} has {name}, and {without} has none")));
            }
        }
        if let (Some(memory), Some(learned)) = (&self.cycle.parts().memory, &state.learned) {
            let (own, found) = (memory.experience.row_bytes(), learned.row_bytes);
            if own != found {
                let what = "its experience belongs to another ensemble";
                return Err(foreign(format!(
                    "{what}: a transition takes {found} bytes; here it takes {own}"
                )));
            }
            if !learned.is_complete() {
                return Err(foreign("its experience has more or fewer transitions than it says".into()));
            }
        }
        self.take_over(state).map_err(RestoreError::Plugin)
    }

    fn take_over(&mut self, state: DropInState) -> Result<()> {
        // What they would teach is in the task's state.
        self.calibration_resets = 0;
        let ShieldState { agent, rules, exploration_replaced, .. } = state.shield;
        self.cycle.restore_diagnosis(&state.undo);
        let parts = self.cycle.parts_mut();
        let learned = LearnedState { forward: None, reset: Some(agent), rules };
        parts.restore(&learned)?;
        parts.restore_undo(&state.undo)?;
        if let (Some(memory), Some(kept)) = (&mut parts.memory, state.learned) {
            memory.experience.replace(kept.kept, &kept.rows);
            memory.masks = kept.masks;
        }
        if let (Some(task), Some(state)) = (&mut self.task, &state.task) {
            state.restore(&mut **task)?;
        }
        let counters = Counters { exploration_replaced, ..state.counters };
        self.cycle.restore_counts(counters, state.reset_successes);
        self.report_restored(&learned.rules);
        Ok(())
    }
}
