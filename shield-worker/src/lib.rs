#![doc = include_str!("../README.md")]

mod bell;
mod client;
mod error;
mod ffi;
mod memory;
mod nursery;
mod transcript;
mod turn;
mod worker;

pub use client::Client;
pub use error::{Ending, WorkerError};
pub use ffi::Plain;
pub use memory::Memory;
pub use worker::{Options, Waiting, Worker};

/// The environment variable in which a child finds its channel: the file descriptors of memory and bell and the memory's length in
/// bytes, separated by commas.
pub const CHANNEL_VARIABLE: &str = "SHIELD_WORKER_CHANNEL";
