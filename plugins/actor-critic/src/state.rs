//! What must be kept of an agent. Whoever computes the networks, this is the same.

use std::borrow::Cow;

use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};

use crate::{Body, EnsembleState, Error, Noise, Normaliser, read_state, write_state};

/// Everything that must be kept of an agent to continue exactly.
#[derive(Serialize, Deserialize)]
pub struct AgentState<'a> {
    /// The policy's network.
    pub actor: Cow<'a, EnsembleState<f32>>,
    /// The critics' networks.
    pub critics: Cow<'a, EnsembleState<f32>>,
    /// Everything else.
    pub body: BodyState<'a>,
}

/// What a [`Body`] remembers beside the last batch.
#[derive(Serialize, Deserialize)]
pub struct BodyState<'a> {
    noise: Cow<'a, Noise>,
    normaliser: Cow<'a, Option<Normaliser>>,
    rng: Cow<'a, Pcg64>,
}

impl Body {
    /// The state of an agent with this body and these networks.
    pub(crate) fn state<'a>(
        &'a self,
        actor: &'a EnsembleState<f32>,
        critics: &'a EnsembleState<f32>,
    ) -> AgentState<'a> {
        AgentState {
            actor: Cow::Borrowed(actor),
            critics: Cow::Borrowed(critics),
            body: BodyState {
                noise: Cow::Borrowed(&self.noise),
                normaliser: Cow::Borrowed(&self.normaliser),
                rng: Cow::Borrowed(&self.rng),
            },
        }
    }

    /// Appends the state of an agent with this body, these networks and a deterministic policy.
    ///
    /// # Errors
    /// [`Error::ForeignState`] if it cannot be written.
    pub fn save(
        &self,
        magic: &[u8],
        actor: &EnsembleState<f32>,
        critics: &EnsembleState<f32>,
        bytes: &mut Vec<u8>,
    ) -> Result<(), Error> {
        write_state(magic, &self.state(actor, critics), bytes)
    }

    /// Reads what [`save`](Self::save) wrote with the same `magic`; nothing changes yet.
    ///
    /// # Errors
    /// Anything that is not the state of an agent with such a body. Whether its networks fit is not checked.
    pub fn read(&self, magic: &[u8], bytes: &[u8]) -> Result<AgentState<'static>, Error> {
        let state: AgentState<'static> = read_state(magic, bytes)?;
        self.check_state(&state.body)?;
        Ok(state)
    }

    /// Whether a state can be continued from.
    ///
    /// # Errors
    /// [`Error::ForeignState`] if it is that of another kind of body.
    pub(crate) fn check_state(&self, state: &BodyState<'_>) -> Result<(), Error> {
        if state.noise.dimensions() != self.noise.dimensions() {
            return Err(Error::ForeignState("its noise has another number of dimensions".into()));
        }
        Normaliser::check_alike(self.normaliser.as_ref(), state.normaliser.as_ref().as_ref())
    }

    /// Continues from a state that was [read](Self::read).
    pub fn restore(&mut self, state: BodyState<'_>) {
        self.noise.continue_from(state.noise.into_owned());
        self.normaliser = state.normaliser.into_owned();
        self.rng = state.rng.into_owned();
    }
}
