//! The shield itself: what decides, what undoes, and the cycle of both.
//!
//! It knows no file, no configuration text and no shared library: plugins can be linked in as Rust types.

pub mod agent;
pub mod controller;
pub mod critic;
pub mod cycle;
pub mod decision;
pub mod diagnosis;
pub mod drop_in;
pub mod events;
pub mod examination;
pub mod experience;
pub mod plugin_state;
pub mod settings;
pub mod shield;
pub mod shielded;
pub mod world;
