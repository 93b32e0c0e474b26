//! The full state as bytes.

use actor_critic::{EnsembleState, Noise, Normaliser};
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};
use shield_api::{Checkpoint, Error, Result};

use crate::Ddpg;

/// How the bytes begin.
const MAGIC: &[u8] = b"shield/ddpg/1\n";

#[derive(Serialize)]
struct StateView<'a> {
    actor: &'a EnsembleState<f32>,
    critics: &'a EnsembleState<f32>,
    noise: &'a Noise,
    normaliser: &'a Option<Normaliser>,
    rng: &'a Pcg64,
}

#[derive(Deserialize)]
struct State {
    actor: EnsembleState<f32>,
    critics: EnsembleState<f32>,
    noise: Noise,
    normaliser: Option<Normaliser>,
    rng: Pcg64,
}

impl Checkpoint for Ddpg {
    fn save(&self, bytes: &mut Vec<u8>) -> Result<()> {
        let view = StateView {
            actor: self.actor.state(),
            critics: self.critics.state(),
            noise: &self.noise,
            normaliser: &self.normaliser,
            rng: &self.rng,
        };
        let state = postcard::to_stdvec(&view).map_err(|error| Error::failed(error.to_string()))?;
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
        if !rest.is_empty() {
            return Err(refused("it is too long"));
        }
        if state.noise.dimensions() != self.noise.dimensions() {
            return Err(refused("its noise has another number of dimensions"));
        }
        let dimensions = |normaliser: &Option<Normaliser>| normaliser.as_ref().map(Normaliser::dimensions);
        if dimensions(&state.normaliser) != dimensions(&self.normaliser) {
            return Err(refused("its observations are normalised otherwise"));
        }
        self.actor.check_state(&state.actor).map_err(|error| refused(&error.to_string()))?;
        self.critics.restore(state.critics).map_err(|error| refused(&error.to_string()))?;
        self.actor.restore(state.actor).map_err(|error| refused(&error.to_string()))?;
        self.noise.continue_from(state.noise);
        self.normaliser = state.normaliser;
        self.rng = state.rng;
        Ok(())
    }
}
