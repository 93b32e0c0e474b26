//! A run on disk: its folder, its tables, its summary.

mod build;
mod recorder;
mod summary;

pub use build::{Prepared, prepare};
pub use recorder::{Recorder, RunFolder};
pub use summary::{Identity, Summary};
