//! Experiments and drop-ins as RON files: every fault has its place, and the plugins that they name are made here.

pub mod drop_in_files;
pub mod events;
pub mod experiment;
pub mod state_file;
pub mod workshop;
