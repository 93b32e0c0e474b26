//! A run on disk: its folder, its tables, its summary.

mod recorder;
mod summary;

pub use recorder::{Recorder, RunFolder};
pub use summary::{Identity, Summary};
