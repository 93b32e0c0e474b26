//! The host of the shield: loads plugins, decides, runs the joint loop of both agents, keeps their experience and writes results.

pub mod agent;
mod allocations_ffi;
pub mod batch;
pub mod checkpoint;
mod contained;
pub mod decision;
pub mod drop_in;
pub mod environment_check;
pub mod evaluation;
pub mod experience;
pub mod experiment;
pub mod film;
pub mod joint_loop;
pub mod loop_state;
pub mod observer;
pub mod plugin;
pub mod plugin_bench;
pub mod plugin_check;
pub mod record;
pub mod report;
pub mod run;
pub mod shield;
pub mod shielded;
mod workshop;
pub mod world;
