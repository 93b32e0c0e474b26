//! The paper's experiments, small enough for two cores: runs what is missing, draws it, and says which claims hold.

mod claims;
mod experiments;
mod record;
mod results;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

use anyhow::{Context, Result, bail};

use crate::cargo;
use crate::say::say;
use experiments::{EXPERIMENTS, Experiment};
use record::Record;

/// What was measured, in the repository.
const PAPER: &str = "examples/paper";
/// Where the runs themselves are, outside of it.
const RUNS: &str = "runs/paper";

/// Which experiments, and how.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Experiments to run, by the names of their files in examples/paper; all if none is named
    experiments: Vec<String>,
    /// Runs nothing: takes what is there, finished runs in runs/paper and the records in examples/paper/records
    #[arg(long)]
    no_run: bool,
    /// Seeds to run instead of each experiment's, for example 0,1
    #[arg(long, conflicts_with = "no_run")]
    seeds: Option<String>,
}

/// Runs what is missing, then writes records, plots and `examples/paper/RESULTS.md`.
///
/// # Errors
/// A name is unknown, a run fails, or a file cannot be written.
pub fn reproduce(root: &Path, program: &Path, arguments: &Arguments) -> Result<ExitCode> {
    for name in &arguments.experiments {
        if !EXPERIMENTS.iter().any(|experiment| experiment.name == name) {
            let known: Vec<&str> = EXPERIMENTS.iter().map(|experiment| experiment.name).collect();
            bail!("there is no experiment {name}; there are: {}", known.join(", "));
        }
    }
    let is_wanted = |experiment: &&Experiment| {
        arguments.experiments.is_empty() || arguments.experiments.iter().any(|name| name == experiment.name)
    };
    let mut code = ExitCode::SUCCESS;
    for experiment in EXPERIMENTS.iter().filter(is_wanted) {
        let place = Place { root, program, experiment };
        if !arguments.no_run && !place.run(arguments.seeds.as_deref())? {
            // What is finished is written all the same; the next call goes on from there.
            code = ExitCode::FAILURE;
        }
        place.report()?;
    }
    let mut records = Vec::new();
    for experiment in EXPERIMENTS {
        let path = root.join(Place { root, program, experiment }.record());
        let record = if path.exists() { Some(Record::read(&path)?) } else { None };
        records.push((experiment, record));
    }
    let path = root.join(PAPER).join("RESULTS.md");
    fs::write(&path, results::page(root, &records)?)
        .with_context(|| format!("{} cannot be written", path.display()))?;
    say(format_args!("{PAPER}/RESULTS.md"));
    Ok(code)
}

/// Where everything of one experiment is.
struct Place<'a> {
    root: &'a Path,
    program: &'a Path,
    experiment: &'a Experiment,
}

impl Place<'_> {
    /// From the root, where `shield` is called.
    fn record(&self) -> PathBuf {
        Path::new(PAPER).join("records").join(format!("{}.json", self.experiment.name))
    }

    fn runs(&self) -> PathBuf {
        Path::new(RUNS).join(self.experiment.name)
    }

    fn shield(&self) -> Command {
        let mut command = Command::new(self.program);
        command.current_dir(self.root);
        command
    }

    /// Makes the runs that are neither recorded nor finished. Returns whether all are.
    fn run(&self, seeds: Option<&str>) -> Result<bool> {
        let mut command = self.shield();
        let file = format!("{PAPER}/{}.ron", self.experiment.name);
        say(&file);
        command.args(["run", &file, "--out", RUNS, "--record"]).arg(self.record());
        if let Some(seeds) = seeds {
            command.args(["--seeds", seeds]);
        }
        let status =
            command.status().with_context(|| format!("{} could not be run", self.program.display()))?;
        Ok(status.success())
    }

    /// Brings record and plots up to date with the runs that are finished.
    fn report(&self) -> Result<()> {
        let (record, runs) = (self.record(), self.runs());
        let mut command = self.shield();
        command.arg("report");
        match (self.root.join(&runs).is_dir(), self.root.join(&record).exists()) {
            (true, _) => command.arg(&runs).arg("--record").arg(&record),
            (false, true) => command.arg(&record),
            (false, false) => return Ok(()),
        };
        command.arg("--out").arg(Path::new(RUNS).join(format!("{}.html", self.experiment.name)));
        command.arg("--png").arg(Path::new(PAPER).join("plots"));
        command.args(["--prefix", &format!("{}-", self.experiment.name)]);
        command.args(["--figures", &self.experiment.figures.join(",")]);
        cargo::run(&mut command)
    }
}
