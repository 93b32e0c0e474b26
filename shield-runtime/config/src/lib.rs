//! Experiments and drop-ins as RON files: every fault has its place, and the plugins that they name are made here.

pub mod atomic_file;
pub mod drop_in_files;
pub mod experiment;
pub mod growing_file;
pub mod state_file;
pub mod tensorboard;
pub mod workshop;
