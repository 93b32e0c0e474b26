//! A run on disk: its folder, its tables, its summary.

mod build;
mod folder;
mod launch;
mod recorder;
mod summary;
mod tables;

pub use build::{Prepared, prepare};
pub use folder::RunFolder;
pub use launch::{Launch, Order, Restored, Standing, of_folder, restore};
pub use recorder::{Recorder, RecorderState};
pub use summary::{Identity, Summary};
