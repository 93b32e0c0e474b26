//! Plugins: finding, trusting, loading, calling and isolating shared libraries.

pub mod plugin;
