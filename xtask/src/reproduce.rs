//! Experiments whose results are kept, small enough for two cores: the paper's, and those of the shield as it is. Runs what is missing, draws it, and
//! says which claims hold, or which targets are met.

mod claims;
mod experiments;
mod gymnasium;
mod record;
mod results;
mod tables;
mod untouched;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

use anyhow::{Context, Result, bail};

use crate::say::say;
use crate::{cargo, wheel};
use experiments::Experiment;
use record::Record;

/// Experiments whose results make one page.
struct Collection {
    /// Stands for all of them on the command line.
    name: &'static str,
    /// Where the page is, and the records: in the repository.
    folder: &'static str,
    /// Where the runs themselves are: outside of it.
    runs: &'static str,
    experiments: &'static [Experiment],
    page: fn(&Path, &[Recorded]) -> Result<String>,
}

/// An experiment with what is known of its runs.
type Recorded = (&'static Experiment, Option<Record>);

/// The first is meant where none is named.
const COLLECTIONS: [Collection; 2] = [
    Collection {
        name: "paper",
        folder: "examples/paper",
        runs: "runs/paper",
        experiments: experiments::PAPER,
        page: results::page,
    },
    Collection {
        name: "untouched",
        folder: "examples/untouched",
        runs: "runs/untouched",
        experiments: experiments::UNTOUCHED,
        page: untouched::page,
    },
];

/// Which experiments, and how.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// Experiments to run, by the names of their files, or Gymnasium's environments; `paper`, `untouched` and `gymnasium` are all of one folder,
    /// and `paper` is meant if none is named
    experiments: Vec<String>,
    /// Runs nothing: takes what is there, finished runs in runs/ and the records beside the page
    #[arg(long)]
    no_run: bool,
    /// Seeds to run instead of each experiment's, for example 0,1
    #[arg(long, conflicts_with = "no_run")]
    seeds: Option<String>,
}

impl Arguments {
    /// Whether something is named that the program `shield` runs.
    pub fn needs_program(&self) -> bool {
        self.experiments.is_empty() || self.experiments.iter().any(|name| !is_in_gymnasium(name))
    }
}

/// Whether a name stands for environments in which a program in Python trains.
fn is_in_gymnasium(name: &str) -> bool {
    name == gymnasium::NAME || gymnasium::ENVIRONMENTS.contains(&name)
}

/// Runs what is missing, then writes records, plots and the `RESULTS.md` of each folder from which something was named.
///
/// # Errors
/// A name is unknown, a run fails, or a file cannot be written.
pub fn reproduce(root: &Path, program: &Path, arguments: &Arguments) -> Result<ExitCode> {
    let mut code = ExitCode::SUCCESS;
    let (collections, environments) = chosen(&arguments.experiments)?;
    if !environments.is_empty() {
        if !arguments.no_run {
            let python = wheel::install(root, &[])?;
            if !gymnasium::run(root, &python, &environments, arguments.seeds.as_deref())? {
                code = ExitCode::FAILURE;
            }
        }
        gymnasium::write_page(root)?;
    }
    for (collection, experiments) in collections {
        for experiment in experiments {
            let place = Place { root, program, collection, experiment };
            if !arguments.no_run && !place.run(arguments.seeds.as_deref())? {
                // What is finished is written all the same; the next call goes on from there.
                code = ExitCode::FAILURE;
            }
            place.report()?;
        }
        collection.write_page(root)?;
    }
    Ok(code)
}

/// Experiments by the collections to which they belong, and Gymnasium's environments.
type Chosen = (Vec<(&'static Collection, Vec<&'static Experiment>)>, Vec<&'static str>);

/// What these names stand for.
fn chosen(names: &[String]) -> Result<Chosen> {
    let trained = [gymnasium::NAME].into_iter().chain(gymnasium::ENVIRONMENTS);
    let known = || COLLECTIONS.iter().flat_map(Collection::names).chain(trained.clone());
    if let Some(name) = names.iter().find(|name| known().all(|known| known != name.as_str())) {
        let known: Vec<&str> = known().collect();
        bail!("there is no experiment {name}; there are: {}", known.join(", "));
    }
    let default = [COLLECTIONS[0].name.to_owned()];
    let names = if names.is_empty() { &default } else { names };
    let is_named = |name: &str| names.iter().any(|named| named == name);
    let of = |collection: &'static Collection| {
        let is_wanted = |experiment: &&Experiment| is_named(collection.name) || is_named(experiment.name);
        (collection, collection.experiments.iter().filter(is_wanted).collect::<Vec<_>>())
    };
    let collections = COLLECTIONS.iter().map(of).filter(|(_, experiments)| !experiments.is_empty()).collect();
    let is_wanted = |name: &&str| is_named(gymnasium::NAME) || is_named(name);
    Ok((collections, gymnasium::ENVIRONMENTS.into_iter().filter(is_wanted).collect()))
}

impl Collection {
    /// What can be named on the command line.
    fn names(&self) -> impl Iterator<Item = &'static str> {
        [self.name].into_iter().chain(self.experiments.iter().map(|experiment| experiment.name))
    }

    /// From the root, where `shield` is called.
    fn record(&self, experiment: &Experiment) -> PathBuf {
        Path::new(self.folder).join("records").join(format!("{}.json", experiment.name))
    }

    fn write_page(&self, root: &Path) -> Result<()> {
        let read = |experiment: &'static Experiment| {
            let path = root.join(self.record(experiment));
            Ok((experiment, path.exists().then(|| Record::read(&path)).transpose()?))
        };
        let records: Vec<Recorded> = self.experiments.iter().map(read).collect::<Result<_>>()?;
        write_results(root, self.folder, &(self.page)(root, &records)?)
    }
}

/// Writes the page of a folder, and says so.
fn write_results(root: &Path, folder: &str, page: &str) -> Result<()> {
    let path = root.join(folder).join("RESULTS.md");
    fs::write(&path, page).with_context(|| format!("{} cannot be written", path.display()))?;
    say(format_args!("{folder}/RESULTS.md"));
    Ok(())
}

/// Where everything of one experiment is.
struct Place<'a> {
    root: &'a Path,
    program: &'a Path,
    collection: &'a Collection,
    experiment: &'a Experiment,
}

impl Place<'_> {
    fn record(&self) -> PathBuf {
        self.collection.record(self.experiment)
    }

    fn runs(&self) -> PathBuf {
        Path::new(self.collection.runs).join(self.experiment.name)
    }

    fn shield(&self) -> Command {
        let mut command = Command::new(self.program);
        command.current_dir(self.root);
        command
    }

    /// Makes the runs that are neither recorded nor finished. Returns whether all are.
    fn run(&self, seeds: Option<&str>) -> Result<bool> {
        let mut command = self.shield();
        let file = self.experiment.file();
        say(&file);
        command.args(["run", &file, "--out", self.collection.runs, "--record"]).arg(self.record());
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
        let page = format!("{}.html", self.experiment.name);
        command.arg("--out").arg(Path::new(self.collection.runs).join(page));
        if !self.experiment.figures.is_empty() {
            command.arg("--png").arg(Path::new(self.collection.folder).join("plots"));
            command.args(["--prefix", &format!("{}-", self.experiment.name)]);
            command.args(["--figures", &self.experiment.figures.join(",")]);
        }
        cargo::run(&mut command)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn count(names: &[&str]) -> Option<Vec<(&'static str, usize)>> {
        let names: Vec<String> = names.iter().map(ToString::to_string).collect();
        let (collections, _) = chosen(&names).ok()?;
        Some(
            collections
                .iter()
                .map(|(collection, experiments)| (collection.name, experiments.len()))
                .collect(),
        )
    }

    #[test]
    fn environments_of_gymnasium_are_named_alone_or_together() {
        let environments = |names: &[&str]| {
            let names: Vec<String> = names.iter().map(ToString::to_string).collect();
            let arguments = Arguments { experiments: names.clone(), no_run: true, seeds: None };
            (chosen(&names).unwrap().1.len(), arguments.needs_program())
        };
        assert_eq!(environments(&["gymnasium"]), (gymnasium::ENVIRONMENTS.len(), false));
        assert_eq!(environments(&["Pendulum-v1", "walker"]), (1, true));
        assert_eq!(environments(&[]), (0, true));
    }

    #[test]
    fn a_collection_is_named_as_a_whole_or_by_its_experiments() {
        let all = COLLECTIONS.map(|collection| (collection.name, collection.experiments.len()));
        assert_eq!(count(&[]), Some(vec![all[0]]));
        assert_eq!(count(&["untouched"]), Some(vec![all[1]]));
        assert_eq!(count(&["untouched", "paper", "walker"]), Some(all.to_vec()));
        assert_eq!(
            count(&["walker", "cart-small", "quickstart"]),
            Some(vec![("paper", 1), ("untouched", 2)])
        );
        assert_eq!(count(&["walker", "nobody"]), None);
    }
}
