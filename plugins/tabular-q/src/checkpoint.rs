//! The full state as bytes.

use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};
use shield_api::{Checkpoint, Error, Result};

use crate::TabularQ;

/// How the bytes begin.
const MAGIC: &[u8] = b"shield/tabular-q/1\n";

#[derive(Serialize, Deserialize)]
struct State {
    members: usize,
    states: usize,
    actions: usize,
    tables: Vec<f32>,
    explored: u64,
    rng: Pcg64,
}

impl Checkpoint for TabularQ {
    fn save(&self, bytes: &mut Vec<u8>) -> Result<()> {
        let state = State {
            members: self.config.members,
            states: self.states,
            actions: self.actions,
            tables: self.tables.clone(),
            explored: self.explored,
            rng: self.rng.clone(),
        };
        let state = postcard::to_stdvec(&state).map_err(|error| Error::failed(error.to_string()))?;
        bytes.extend_from_slice(MAGIC);
        bytes.extend_from_slice(&state);
        Ok(())
    }

    fn load(&mut self, bytes: &[u8]) -> Result<()> {
        let refused =
            |reason: &str| Error::invalid_argument(format!("not a state of this learner: {reason}"));
        let body = bytes.strip_prefix(MAGIC).ok_or_else(|| refused("it begins differently"))?;
        let (state, rest) =
            postcard::take_from_bytes::<State>(body).map_err(|error| refused(&error.to_string()))?;
        let found = (state.members, state.states, state.actions, state.tables.len());
        let expected = (self.config.members, self.states, self.actions, self.tables.len());
        if found != expected {
            return Err(refused(&format!(
                "its members, states, actions and values are {found:?}, expected {expected:?}"
            )));
        }
        if !rest.is_empty() || !state.tables.iter().all(|value| value.is_finite()) {
            return Err(refused("it is too long, or a value is not finite"));
        }
        self.tables = state.tables;
        self.explored = state.explored;
        self.rng = state.rng;
        Ok(())
    }
}
