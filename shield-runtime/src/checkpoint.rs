//! Checkpoints: what is needed to continue a run as if it had never stopped.
//!
//! A checkpoint is one file, written aside, synced and renamed, with the one before it kept. The experience is too large to be
//! written each time: it lies beside the file in segments that only grow, and the checkpoint says how far they count.

mod experience_log;
pub(crate) mod file;
mod lock;
mod store;

pub(crate) use file::BEGIN_ANEW;
pub use file::CheckpointError;
pub use store::{CheckpointStore, LockedCheckpoints, PluginVersion, Provenance, Saved, last_checkpoint};
