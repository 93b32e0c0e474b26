//! The host of the shield: loads plugins, decides, runs the joint loop of both agents, keeps their experience and writes results.

pub mod experiment;
pub mod plugin;
