//! `shield run`: every variant with every seed, as far as they are not done yet.

use std::{num::NonZeroUsize, path::PathBuf};

use clap::Args;
use shield_config::experiment::{ExperimentFile, Override};
use shield_host::plugin::Registry;
use shield_lab::run::{Run, prepare};
use shield_report::report::Record;

use super::{
    Failure, output,
    runs::{Earlier, make_all},
};

/// Arguments of `shield run`.
#[derive(Args)]
pub struct RunArguments {
    /// The experiment, a RON file.
    experiment: PathBuf,
    /// Folder of the results; each run writes <OUT>/<experiment>/<variant>/seed-<n>.
    #[arg(long, default_value = "runs")]
    out: PathBuf,
    /// Seeds to run instead of the experiment's, for example 0,1.
    #[arg(long, value_delimiter = ',')]
    seeds: Option<Vec<u64>>,
    /// Steps of each run instead of the experiment's.
    #[arg(long)]
    steps: Option<u64>,
    /// Variants to run instead of all, for example shielded,status-quo.
    #[arg(long, value_delimiter = ',')]
    variants: Option<Vec<String>>,
    /// Sets a field of the experiment, for example shield.rules[0].config.q_min=5. May be repeated.
    #[arg(long = "set", value_name = "PATH=VALUE")]
    sets: Vec<String>,
    /// Runs at the same time. Default: as many as the cores allow with the experiment's threads.
    #[arg(long)]
    jobs: Option<NonZeroUsize>,
    /// Removes earlier results of the same runs. Without it, finished runs are kept and unfinished ones go on.
    #[arg(long)]
    overwrite: bool,
    /// A record of runs, as `shield report --record` writes it: those that it has with the same configuration are not made again.
    #[arg(long, value_name = "FILE")]
    record: Option<PathBuf>,
}

/// Runs an experiment and prints its table.
pub fn run(arguments: &RunArguments, registry: &Registry) -> Result<(), Failure> {
    let file = ExperimentFile::read(&arguments.experiment)?;
    let variants = file.variants(&overrides(arguments)?, arguments.variants.as_deref())?;
    // Everything that can be wrong with the input shows before the first folder is written. What begins at once is not made again; more
    // would only wait, an environment's process too.
    let workers = std::thread::available_parallelism().map_or(1, usize::from);
    let mut runs = Vec::new();
    for (index, variant) in variants.iter().enumerate() {
        let parts = prepare(registry, variant, variant.experiment.seeds[0])?;
        let mut parts = (index < workers).then_some(parts);
        for (position, seed) in variant.experiment.seeds.iter().enumerate() {
            let run = Run::new(&arguments.out, variant.clone(), *seed);
            runs.push((position, (run, parts.take())));
        }
    }
    // Seed by seed, so that the first results of every variant come early.
    runs.sort_by_key(|(position, _)| *position);
    let runs = runs.into_iter().map(|(_, run)| run).collect();
    let record = match &arguments.record {
        Some(path) if path.exists() => {
            Some(Record::read(path).map_err(|error| Failure::Input(format!("{error:#}")))?)
        }
        Some(path) => {
            let path = path.display();
            output::message(format_args!("{path} does not exist yet: no run is recorded"));
            None
        }
        None => None,
    };
    let earlier = if arguments.overwrite { Earlier::IsReplaced } else { Earlier::MayStay(record) };
    make_all(registry, runs, arguments.jobs, &earlier)?;
    let folder = arguments.out.join(&variants[0].experiment.name);
    match &arguments.record {
        Some(record) if !folder.exists() => {
            output::note(format_args!("Every run is recorded in {}.", record.display()));
        }
        _ => output::note(format_args!("Runs are in {}.", folder.display())),
    }
    Ok(())
}

fn overrides(arguments: &RunArguments) -> Result<Vec<Override>, Failure> {
    let mut overrides = Vec::new();
    for set in &arguments.sets {
        overrides.push(Override::parse(set)?);
    }
    if let Some(steps) = arguments.steps {
        overrides.push(Override::new("steps", &steps.to_string(), format!("--steps {steps}"))?);
    }
    if let Some(seeds) = &arguments.seeds {
        let list = seeds.iter().map(u64::to_string).collect::<Vec<_>>().join(",");
        overrides.push(Override::new("seeds", &format!("[{list}]"), format!("--seeds {list}"))?);
    }
    Ok(overrides)
}
