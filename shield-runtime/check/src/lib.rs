//! Checks and benchmarks of environments and plugins, for their authors.

mod allocations_ffi;
pub mod environment_check;
pub mod plugin_bench;
pub mod plugin_check;
