//! `shield resume`: goes on with the runs of a folder that are not finished.

use std::{collections::HashSet, num::NonZeroUsize, path::PathBuf};

use clap::Args;
use shield_host::plugin::Registry;
use shield_lab::run::Run;

use super::{
    Failure,
    eval::runs_in,
    runs::{Earlier, make_all},
};

/// Arguments of `shield resume`.
#[derive(Args)]
pub struct ResumeArguments {
    /// Folders of runs, or of everything that an experiment wrote: runs/mine, runs/mine/shielded/seed-0.
    #[arg(required = true)]
    folders: Vec<PathBuf>,
    /// Runs at the same time. Default: as many as the cores allow with the experiment's threads.
    #[arg(long)]
    jobs: Option<NonZeroUsize>,
}

/// Goes on with what is not finished and prints the table of all.
pub fn run(arguments: &ResumeArguments, registry: &Registry) -> Result<(), Failure> {
    let mut runs = Vec::new();
    let mut seen = HashSet::new();
    for root in &arguments.folders {
        for folder in runs_in(root)? {
            let run = Run::of_folder(folder, &[]).map_err(|error| Failure::Input(format!("{error:#}")))?;
            if seen.insert(run.folder.path().to_owned()) {
                runs.push((run, None));
            }
        }
    }
    // Seed by seed, as `shield run` does.
    runs.sort_by_key(|(run, _)| run.seed);
    make_all(registry, runs, arguments.jobs, &Earlier::Stays)
}
