//! The full state as bytes.

use std::borrow::Cow;

use actor_critic::{EnsembleState, Error as StateError, Normaliser, read_state, write_state};
use learner_kit::plugin_error;
use serde::{Deserialize, Serialize};
use shield_api::{Checkpoint, Result};

use crate::CriticEnsemble;

/// How the bytes begin.
pub(crate) const MAGIC: &[u8] = b"shield/success-critic/1\n";

#[derive(Serialize, Deserialize)]
struct State<'a> {
    critics: Cow<'a, EnsembleState<f32>>,
    normaliser: Cow<'a, Option<Normaliser>>,
}

impl Checkpoint for CriticEnsemble {
    fn save(&self, bytes: &mut Vec<u8>) -> Result<()> {
        let state = State {
            critics: Cow::Borrowed(self.critics.state()),
            normaliser: Cow::Borrowed(&self.normaliser),
        };
        write_state(MAGIC, &state, bytes).map_err(plugin_error)
    }

    fn load(&mut self, bytes: &[u8]) -> Result<()> {
        self.restore(bytes).map_err(plugin_error)
    }
}

impl CriticEnsemble {
    fn restore(&mut self, bytes: &[u8]) -> Result<(), StateError> {
        let state: State<'static> = read_state(MAGIC, bytes)?;
        let normaliser = state.normaliser.into_owned();
        Normaliser::check_alike(self.normaliser.as_ref(), normaliser.as_ref())?;
        self.critics.restore(state.critics.into_owned())?;
        self.normaliser = normaliser;
        Ok(())
    }
}
