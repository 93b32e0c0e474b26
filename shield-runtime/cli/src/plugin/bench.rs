//! `shield plugin bench`: what each call of a plugin costs.

use std::time::Duration;

use clap::Args;
use comfy_table::{CellAlignment, ContentArrangement, Table, presets::NOTHING};
use indicatif::ProgressBar;
use serde::Serialize;
use shield_api::{Space, Spaces};
use shield_check::{
    plugin_bench::{self, Measured, Settings},
    plugin_check::Candidate,
};
use shield_host::plugin::{Entry, Registry, Selection};

use super::super::{Failure, output};

/// Arguments of `shield plugin bench`.
#[derive(Args)]
#[command(after_help = EXAMPLES)]
pub struct BenchArguments {
    /// An id, such as ddpg, or a library, such as target/release/libmine.so, whose plugins are all measured.
    plugin: String,
    /// The plugin's configuration, for example '(critics: 20)'.
    #[arg(long, default_value = "")]
    config: String,
    /// How many numbers an observation has; 4 if none is given. An environment brings its own.
    #[arg(long, value_name = "NUMBERS")]
    observation: Option<usize>,
    /// How many numbers an action has, each in [-1, 1]; 2 if none is given. An environment brings its own.
    #[arg(long, value_name = "NUMBERS")]
    action: Option<usize>,
    /// Transitions in a batch of a learner's update.
    #[arg(long, default_value_t = 64, value_parser = clap::value_parser!(u32).range(1..))]
    batch: u32,
    /// Members of the ensembles whose values a rule is shown.
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..))]
    members: u32,
    /// Seconds for which each function is called.
    #[arg(long, default_value_t = 0.5)]
    seconds: f64,
    /// Seed of instances and arguments.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Prints JSON instead of a table: a list of objects with plugin, call, calls, p50_ns, p99_ns and allocations.
    #[arg(long)]
    json: bool,
}

const EXAMPLES: &str = "\
Examples:
  shield plugin bench target/release/libmine.so
  shield plugin bench ddpg --config '(critics: 20)' --observation 17 --action 6
  shield plugin bench gridworld --json > bench.json

Each function is called through the binary interface, as a run calls it: with the host's checks of lengths and numbers. p50 is the median, \
p99 what 99 of 100 calls stay below; calls shorter than 3 µs are timed in groups, of which each counts with its mean. ALLOCATIONS are those of \
one call, in the plugin and the libraries that it links; in `step`, `act`, `q_values` and `evaluate` there should be none. What a plugin \
does not support is left out. Compare figures of one machine that does nothing else.";

/// One row.
#[derive(Serialize)]
struct Row<'a> {
    plugin: &'a str,
    #[serde(flatten)]
    measured: Measured,
}

/// Measures and prints.
pub fn bench(arguments: &BenchArguments, registry: &Registry) -> Result<(), Failure> {
    let time = Duration::try_from_secs_f64(arguments.seconds)
        .map_err(|_| Failure::Input(format!("--seconds {} is no time", arguments.seconds)))?;
    let entries = registry.named(&arguments.plugin).map_err(|error| Failure::Input(error.to_string()))?;
    let settings = Settings {
        time,
        spaces: spaces(arguments),
        batch: arguments.batch as usize,
        members: arguments.members as usize,
    };
    let progress = if arguments.json { ProgressBar::hidden() } else { ProgressBar::new_spinner() };
    let mut rows = Vec::new();
    for Entry { kind, manifest, path } in &entries {
        let candidate = Candidate {
            registry,
            selection: Selection::new(&manifest.id).at(path),
            kind: *kind,
            manifest,
            config: arguments.config.clone(),
            seed: arguments.seed,
        };
        let mut tell = |call: &str| {
            progress.set_message(format!("{}: {call}", manifest.id));
            progress.tick();
        };
        let measured = plugin_bench::bench(&candidate, &settings, &mut tell)
            .map_err(|error| Failure::Run(format!("{}: {error}", manifest.id)))?;
        rows.extend(measured.into_iter().map(|measured| Row { plugin: &manifest.id, measured }));
    }
    progress.finish_and_clear();
    print(arguments, &rows)
}

/// The spaces that were asked for, if any were.
fn spaces(arguments: &BenchArguments) -> Option<Spaces> {
    let BenchArguments { observation, action, .. } = arguments;
    (observation.is_some() || action.is_some()).then(|| Spaces {
        observation: Space::unbounded(observation.unwrap_or(4)),
        action: Space::uniform(action.unwrap_or(2), -1.0, 1.0),
    })
}

fn print(arguments: &BenchArguments, rows: &[Row<'_>]) -> Result<(), Failure> {
    if arguments.json {
        let json = serde_json::to_string_pretty(rows).map_err(|error| Failure::Run(error.to_string()))?;
        return output::result(json);
    }
    let mut table = Table::new();
    table.load_preset(NOTHING).set_content_arrangement(ContentArrangement::Disabled);
    table.set_header(["PLUGIN", "CALL", "CALLS", "P50", "P99", "ALLOCATIONS"]);
    for Row { plugin, measured } in rows {
        let allocations = measured.allocations.map_or_else(|| "not counted here".into(), counted);
        table.add_row([
            (*plugin).to_owned(),
            measured.call.to_owned(),
            measured.calls.to_string(),
            lasting(measured.p50_ns),
            lasting(measured.p99_ns),
            allocations,
        ]);
    }
    table.column_iter_mut().skip(2).for_each(|column| column.set_cell_alignment(CellAlignment::Right));
    output::result(table)
}

/// Three digits with a unit.
fn lasting(nanoseconds: f64) -> String {
    let (value, unit) = match nanoseconds {
        short if short < 1e3 => (short, "ns"),
        short if short < 1e6 => (short / 1e3, "µs"),
        short if short < 1e9 => (short / 1e6, "ms"),
        long => (long / 1e9, "s"),
    };
    let decimals = if value < 10.0 { 2 } else { usize::from(value < 100.0) };
    format!("{value:.decimals$} {unit}")
}

/// Whole numbers as such; less than one in a thousand calls is not none.
fn counted(allocations: f64) -> String {
    match allocations {
        0.0 => "0".into(),
        few if few < 0.001 => "< 0.001".into(),
        count if (count - count.round()).abs() < 0.001 => format!("{count:.0}"),
        count => format!("{count:.3}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_printed_with_three_digits_and_counts_as_whole_numbers() {
        for (nanoseconds, expected) in [
            (4.256, "4.26 ns"),
            (12.3, "12.3 ns"),
            (999.4, "999 ns"),
            (1_500.0, "1.50 µs"),
            (2.5e9, "2.50 s"),
        ] {
            assert_eq!(lasting(nanoseconds), expected);
        }
        for (allocations, expected) in [(0.0, "0"), (1e-5, "< 0.001"), (2.0004, "2"), (0.5, "0.500")] {
            assert_eq!(counted(allocations), expected);
        }
    }
}
