#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod attempts;
mod crossq;
mod ddpg;
mod learner;
mod report;
mod sac;
mod settings;
mod td3;

use actor_critic::{Body, ErrorKind, check_unit};
use shield_api::{Batch, Error, Result, check_finite};

pub use attempts::{UndoTarget, check_attempts};
pub use crossq::CrossqConfig;
pub use ddpg::DdpgConfig;
pub use learner::{ActorCritic, AgentConfig, Backend, Update};
pub use report::CriticReport;
pub use sac::SacConfig;
pub use td3::Td3Config;

/// An error of the networks as one of a plugin.
pub fn plugin_error(error: actor_critic::Error) -> Error {
    let message = error.to_string();
    match error.kind() {
        ErrorKind::Setting => {
            let refused = Error::invalid_config(message);
            error.setting().map_or(refused.clone(), |name| refused.in_field(name))
        }
        ErrorKind::Argument => Error::invalid_argument(message),
        ErrorKind::Failure => Error::failed(message),
    }
}

/// Checks a whole batch before anything changes, and takes it in.
///
/// # Errors
/// As [`check_batch`]; or an action has the wrong length or is not finite.
pub fn take_batch(body: &mut Body, batch: &Batch<'_>, members: usize) -> Result<()> {
    check_finite("actions", batch.actions, batch.size * body.scale.len())?;
    check_batch(batch, body.observation_len(), members)?;
    body.take_batch(batch.observations, batch.actions, batch.next_observations);
    Ok(())
}

/// Checks everything of a batch but its actions, which depend on the space.
///
/// # Errors
/// The batch is empty, something has the wrong length or is not finite, or a continuation or mask lies outside [0, 1].
pub fn check_batch(batch: &Batch<'_>, observation_len: usize, members: usize) -> Result<()> {
    let size = batch.size;
    if size == 0 {
        return Err(Error::invalid_argument("the batch is empty"));
    }
    check_finite("observations", batch.observations, size * observation_len)?;
    check_finite("rewards", batch.rewards, size)?;
    check_finite("next_observations", batch.next_observations, size * observation_len)?;
    check_unit("continuations", batch.continuations, size).map_err(plugin_error)?;
    check_unit("masks", batch.masks, size * members).map_err(plugin_error)
}
