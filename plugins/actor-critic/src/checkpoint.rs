//! A learner's state as bytes: a line that names the format, then the state in postcard's encoding.

use serde::{Serialize, de::DeserializeOwned};

use crate::Error;

/// Appends `magic` and the state.
///
/// # Errors
/// [`Error::ForeignState`] if it cannot be written.
pub fn write_state(magic: &[u8], state: &impl Serialize, bytes: &mut Vec<u8>) -> Result<(), Error> {
    let state = postcard::to_stdvec(state).map_err(foreign)?;
    bytes.extend_from_slice(magic);
    bytes.extend_from_slice(&state);
    Ok(())
}

/// Reads what [`write_state`] wrote with the same `magic`.
///
/// # Errors
/// [`Error::ForeignState`] for anything else, or more.
pub fn read_state<S: DeserializeOwned>(magic: &[u8], bytes: &[u8]) -> Result<S, Error> {
    let body = bytes.strip_prefix(magic).ok_or_else(|| foreign("it begins differently"))?;
    let (state, rest) = postcard::take_from_bytes(body).map_err(foreign)?;
    if rest.is_empty() { Ok(state) } else { Err(foreign("it is too long")) }
}

fn foreign(reason: impl std::fmt::Display) -> Error {
    Error::ForeignState(reason.to_string())
}
