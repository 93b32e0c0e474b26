//! `shield plugin …`: finding, reading, making, checking, measuring and pinning plugins. Only `check` and `bench` execute one, `check` never in its own
//! process.

mod bench;
mod check;
mod info;
mod list;
mod lock;
mod new;

pub use list::list;

use clap::Subcommand;
use shield_host::plugin::Registry;

use super::Failure;

/// What can be done with plugins.
#[derive(Subcommand)]
pub enum PluginCommand {
    /// Lists the plugins on the search path, without loading any, and why files were passed over.
    List,
    /// Shows what a plugin says of itself: its configuration with defaults, and an example to copy. Loads nothing.
    Info(info::InfoArguments),
    /// Asks a plugin everything that a host relies on: each check in a process of its own, with a time limit.
    Check(check::CheckArguments),
    /// Measures what each call of a plugin costs: time and allocations.
    Bench(bench::BenchArguments),
    /// Makes the folder of a new plugin that builds, passes its checks and runs in an example experiment.
    New(new::NewArguments),
    /// Pins every plugin of an experiment to the file that is found now, by its SHA-256.
    ///
    /// The pins are written into the experiment. A run then refuses any other file before anything of it is executed.
    Lock(lock::LockArguments),
}

/// Does it.
pub fn run(command: &PluginCommand, registry: &Registry) -> Result<(), Failure> {
    match command {
        PluginCommand::List => list(registry, None),
        PluginCommand::Info(arguments) => info::info(arguments, registry),
        PluginCommand::Check(arguments) => check::check(arguments, registry),
        PluginCommand::Bench(arguments) => bench::bench(arguments, registry),
        PluginCommand::New(arguments) => new::new(arguments),
        PluginCommand::Lock(arguments) => lock::lock(arguments, registry),
    }
}
