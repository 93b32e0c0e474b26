//! The full state as bytes.

use std::borrow::Cow;

use actor_critic::{EnsembleState, Error as StateError, Normaliser, read_state, write_state};
use learner_kit::plugin_error;
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};
use shield_api::{Checkpoint, Result};

use crate::Ddqn;

/// How the bytes begin.
pub(crate) const MAGIC: &[u8] = b"shield/ddqn/1\n";

#[derive(Serialize, Deserialize)]
struct State<'a> {
    networks: Cow<'a, EnsembleState<f32>>,
    normaliser: Cow<'a, Option<Normaliser>>,
    explored: u64,
    rng: Cow<'a, Pcg64>,
}

impl Checkpoint for Ddqn {
    fn save(&self, bytes: &mut Vec<u8>) -> Result<()> {
        let state = State {
            networks: Cow::Borrowed(self.networks.state()),
            normaliser: Cow::Borrowed(&self.normaliser),
            explored: self.explored,
            rng: Cow::Borrowed(&self.rng),
        };
        write_state(MAGIC, &state, bytes).map_err(plugin_error)
    }

    fn load(&mut self, bytes: &[u8]) -> Result<()> {
        self.restore(bytes).map_err(plugin_error)
    }
}

impl Ddqn {
    fn restore(&mut self, bytes: &[u8]) -> Result<(), StateError> {
        let state: State<'static> = read_state(MAGIC, bytes)?;
        let normaliser = state.normaliser.into_owned();
        Normaliser::check_alike(self.normaliser.as_ref(), normaliser.as_ref())?;
        self.networks.restore(state.networks.into_owned())?;
        self.normaliser = normaliser;
        self.explored = state.explored;
        self.rng = state.rng.into_owned();
        Ok(())
    }
}
