//! The loader against real libraries: good ones, wrong ones, and ones that misbehave when they run.
//!
//! The Rust libraries lie in `tests/fixtures`, a workspace of its own that is built here into one shared target folder; the C
//! libraries come from one source, in which a macro chooses what is wrong.
#![allow(clippy::unwrap_used)] // Helpers of tests are tests too.

mod allocations;
mod c;
mod c_undo;
mod fixtures;
mod instances;
mod isolated;
mod isolated_runs;
mod loading;
mod misbehaving;
mod pinned;
mod repository;
mod scanning;
mod trust;
mod undo;
