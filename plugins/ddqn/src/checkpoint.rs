//! The full state as bytes.

use actor_critic::{EnsembleState, Error as StateError, Normaliser, read_state, write_state};
use learner_kit::plugin_error;
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};
use shield_api::{Checkpoint, Result};

use crate::Ddqn;

/// How the bytes begin.
pub(crate) const MAGIC: &[u8] = b"shield/ddqn/1\n";

#[derive(Serialize)]
struct StateView<'a> {
    networks: &'a EnsembleState<f32>,
    normaliser: &'a Option<Normaliser>,
    explored: u64,
    rng: &'a Pcg64,
}

#[derive(Deserialize)]
struct State {
    networks: EnsembleState<f32>,
    normaliser: Option<Normaliser>,
    explored: u64,
    rng: Pcg64,
}

impl Checkpoint for Ddqn {
    fn save(&self, bytes: &mut Vec<u8>) -> Result<()> {
        let view = StateView {
            networks: self.networks.state(),
            normaliser: &self.normaliser,
            explored: self.explored,
            rng: &self.rng,
        };
        write_state(MAGIC, &view, bytes).map_err(plugin_error)
    }

    fn load(&mut self, bytes: &[u8]) -> Result<()> {
        self.restore(bytes).map_err(plugin_error)
    }
}

impl Ddqn {
    fn restore(&mut self, bytes: &[u8]) -> Result<(), StateError> {
        let state: State = read_state(MAGIC, bytes)?;
        Normaliser::check_alike(self.normaliser.as_ref(), state.normaliser.as_ref())?;
        self.networks.restore(state.networks)?;
        self.normaliser = state.normaliser;
        self.explored = state.explored;
        self.rng = state.rng;
        Ok(())
    }
}
