//! The full state as bytes.

use std::borrow::Cow;

use actor_critic::{Error as StateError, check_unit, read_state, write_state};
use learner_kit::plugin_error;
use serde::{Deserialize, Serialize};
use shield_api::{Checkpoint, Result};

use crate::SuccessTables;

/// How the bytes begin.
const MAGIC: &[u8] = b"shield/tabular-success/1\n";

#[derive(Serialize, Deserialize)]
struct State<'a> {
    members: usize,
    states: usize,
    actions: usize,
    tables: Cow<'a, [f32]>,
    visits: Cow<'a, [f32]>,
}

impl Checkpoint for SuccessTables {
    fn save(&self, bytes: &mut Vec<u8>) -> Result<()> {
        let state = State {
            members: self.config.members,
            states: self.states,
            actions: self.actions,
            tables: Cow::Borrowed(&self.tables),
            visits: Cow::Borrowed(&self.visits),
        };
        write_state(MAGIC, &state, bytes).map_err(plugin_error)
    }

    fn load(&mut self, bytes: &[u8]) -> Result<()> {
        self.restore(bytes).map_err(plugin_error)
    }
}

impl SuccessTables {
    fn restore(&mut self, bytes: &[u8]) -> Result<(), StateError> {
        let state: State<'static> = read_state(MAGIC, bytes)?;
        let (found, expected) =
            ((state.members, state.states, state.actions), (self.config.members, self.states, self.actions));
        if found != expected {
            return Err(StateError::ForeignState(format!(
                "its members, states and actions are {found:?}, expected {expected:?}"
            )));
        }
        check_unit("the saved probabilities", &state.tables, self.tables.len())?;
        if state.visits.len() != self.visits.len() {
            let (found, expected) = (state.visits.len(), self.visits.len());
            return Err(StateError::StateLength { found, expected });
        }
        if !state.visits.iter().all(|count| count.is_finite() && *count >= 0.0) {
            return Err(StateError::ForeignState("a number of visits is negative or not finite".into()));
        }
        self.tables = state.tables.into_owned();
        self.visits = state.visits.into_owned();
        Ok(())
    }
}
