//! What is recorded of a shield's decisions, by the runs of experiments and by drop-ins, and how it is read back.

mod contained;
mod log;
pub mod provenance;
mod read;
pub mod record;
pub mod tables;

pub use log::{DecisionLog, DecisionState, check};
pub use read::{DecisionRow, read_decisions};
