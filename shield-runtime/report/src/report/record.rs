//! What the runs of an experiment came to, small enough to be kept beside it.

use std::{collections::BTreeMap, path::Path};

use anyhow::{Context, Result, anyhow, bail};
use serde::{Deserialize, Serialize};
use shield_api::regular_file;

use super::{
    attempts::Forecasts,
    check,
    course::{Course, EvaluationCourse},
    places::Places,
};
use shield_config::experiment::{Difference, Experiment, ExperimentFile, PluginChoice, Variant, differences};
use shield_lab::{
    checkpoint::{PluginVersion, Provenance},
    run::{Run, RunFolder, Summary, write_in_folder},
};

/// Raised with every change of what runs come to.
const PROGRAM: &str = env!("CARGO_PKG_VERSION");

/// The runs of one experiment: what a report is made of.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Record {
    /// Name of the experiment.
    pub experiment: String,
    /// Version of the program that kept it.
    pub program: String,
    /// Its variants, in natural order.
    pub variants: Vec<VariantRecord>,
}

/// The runs of one variant.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct VariantRecord {
    /// Name of the variant.
    pub name: String,
    /// The resolved configuration of its first run; the others differ in their seed.
    pub config: String,
    /// Which plugin each field of the experiment was: the run's `plugins.json`.
    pub plugins: BTreeMap<String, PluginRecord>,
    /// One run per seed.
    pub runs: Vec<RunRecord>,
}

/// A plugin as it was when the runs were made.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct PluginRecord {
    /// Its id.
    pub id: String,
    /// Its version.
    pub version: String,
    /// SHA-256 of its file.
    pub sha256: String,
}

/// One finished run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct RunRecord {
    /// Its seed.
    pub seed: u64,
    /// Its `summary.json`.
    pub summary: Summary,
    /// Its evaluations.
    pub evaluations: EvaluationCourse,
    /// Its counts at equal distances.
    pub course: Course,
    /// Where forward episodes were aborted, if that is known.
    pub aborts: Option<Places>,
    /// How well the success of attempts was foretold, if there was a success critic.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub forecasts: Option<Forecasts>,
}

impl VariantRecord {
    /// The experiment of its configuration; `None` of a configuration that this version cannot read.
    pub(super) fn experiment(&self) -> Option<Experiment> {
        let file = ExperimentFile::from_text("the record", self.config.as_str());
        Some(file.variants(&[], None).ok()?.into_iter().next()?.experiment)
    }
}

impl Record {
    /// Reads the folders of one experiment. Runs that are not finished are left out; a sentence about each is returned beside. `dimensions`
    /// are the two of an observation by which aborts are placed: the first two, where there are two, if none are given.
    ///
    /// # Errors
    /// A folder cannot be read, is not that of a run, or belongs to another experiment or configuration than those before.
    pub fn of_runs(folders: &[RunFolder], dimensions: Option<[usize; 2]>) -> Result<(Self, Vec<String>)> {
        let (mut record, mut left_out) = (Self::default(), Vec::new());
        record.program = PROGRAM.into();
        for folder in folders {
            let path = folder.path().display();
            match folder.summary()? {
                Some(summary) if summary.complete => record.add_run(folder, summary, dimensions)?,
                Some(Summary { error: Some(error), .. }) => left_out.push(format!("{path} failed: {error}")),
                _ => left_out.push(format!("{path} is not finished")),
            }
        }
        check::record(&record).map_err(anyhow::Error::msg)?;
        record.sort();
        Ok((record, left_out))
    }

    fn add_run(
        &mut self,
        folder: &RunFolder,
        summary: Summary,
        dimensions: Option<[usize; 2]>,
    ) -> Result<()> {
        let path = folder.path();
        let identity = Run::of_folder(folder.clone(), &[])?.identity();
        if self.variants.is_empty() {
            self.experiment.clone_from(&identity.experiment);
        } else if self.experiment != identity.experiment {
            bail!("{} is a run of {}, not of {}", path.display(), identity.experiment, self.experiment);
        }
        let run = RunRecord {
            seed: identity.seed,
            evaluations: EvaluationCourse::read(path)?,
            course: Course::read(path, summary.steps)?,
            aborts: Places::read(path, dimensions)?,
            forecasts: Forecasts::read(path)?,
            summary,
        };
        check::run(&run).map_err(|reason| anyhow!("{} is damaged: {reason}", path.display()))?;
        let config = folder.config()?;
        let plugins = path.join("plugins.json");
        let text =
            regular_file::read(&plugins).with_context(|| format!("{} cannot be read", plugins.display()))?;
        let plugins = serde_json::from_slice(&text)
            .with_context(|| format!("{} is not a list of plugins", plugins.display()))?;
        let known = self.variants.iter_mut().find(|variant| variant.name == identity.variant);
        match known {
            None => {
                self.variants.push(VariantRecord { name: identity.variant, config, plugins, runs: vec![run] })
            }
            Some(variant) => {
                if let Some(difference) = but_for_seed(&variant.config, &config).next() {
                    bail!("{} is not like the other runs of its variant: {difference}", path.display());
                }
                variant.runs.push(run);
            }
        }
        Ok(())
    }

    fn sort(&mut self) {
        self.variants.sort_by(|one, other| natural_order(&one.name, &other.name));
        self.variants.iter_mut().for_each(|variant| variant.runs.sort_by_key(|run| run.seed));
    }

    /// Reads a record that [`write`](Self::write) wrote.
    ///
    /// # Errors
    /// It cannot be read, is none, or is damaged.
    pub fn read(path: &Path) -> Result<Self> {
        let bytes = regular_file::read(path).with_context(|| format!("{} cannot be read", path.display()))?;
        let record = serde_json::from_slice(&bytes)
            .with_context(|| format!("{} is not a record of runs", path.display()))?;
        check::record(&record).map_err(|reason| anyhow!("{} is damaged: {reason}", path.display()))?;
        Ok(record)
    }

    /// Writes it as JSON, a run to a line.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write(&self, path: &Path) -> Result<()> {
        let mut text = format!(
            "{{\"experiment\":{},\"program\":{},\"variants\":[",
            serde_json::to_string(&self.experiment)?,
            serde_json::to_string(&self.program)?
        );
        for (index, variant) in self.variants.iter().enumerate() {
            let comma = if index == 0 { "" } else { "," };
            let name = serde_json::to_string(&variant.name)?;
            let config = serde_json::to_string(&variant.config)?;
            let plugins = serde_json::to_string(&variant.plugins)?;
            text += &format!(
                "{comma}\n{{\"name\":{name},\n\"config\":{config},\n\"plugins\":{plugins},\n\"runs\":["
            );
            let runs: Vec<String> =
                variant.runs.iter().map(serde_json::to_string).collect::<Result<_, _>>()?;
            text += &format!("\n{}]}}", runs.join(",\n"));
        }
        text += "\n]}\n";
        write_in_folder(path, text.as_bytes())
    }

    /// Takes over the runs of `other`; where both have one, that of `other` counts. A variant whose configuration or plugins changed
    /// loses its earlier runs; all do if they are of another version of the program.
    ///
    /// # Errors
    /// It is the record of another experiment.
    pub fn merge(&mut self, other: Self) -> Result<()> {
        if !self.variants.is_empty() && self.experiment != other.experiment {
            bail!("the record is one of {}, not of {}", self.experiment, other.experiment);
        }
        if self.program != other.program {
            self.variants.clear();
        }
        (self.experiment, self.program) = (other.experiment, other.program);
        for new in other.variants {
            let place = self.variants.iter().position(|variant| variant.name == new.name);
            let Some(place) = place else {
                self.variants.push(new);
                continue;
            };
            let old = &mut self.variants[place];
            if but_for_seed(&old.config, &new.config).next().is_some() || !same_versions(old, &new) {
                *old = new;
                continue;
            }
            old.runs.retain(|run| new.runs.iter().all(|newer| newer.seed != run.seed));
            old.runs.extend(new.runs);
        }
        self.sort();
        Ok(())
    }

    /// What a run came to, if it is kept here with the same configuration and the same versions of everything. What it would be now is
    /// compared with what it was: a field that has come since with a default is no difference. `provenance` says what a run
    /// of a variant with the seed of `run` would be made of.
    pub fn summary_of(
        &self,
        run: &Run,
        provenance: impl Fn(&Variant) -> Result<Provenance>,
    ) -> Option<&Summary> {
        let variant = self.variants.iter().find(|variant| variant.name == run.variant.name)?;
        let recorded = variant.runs.iter().find(|recorded| recorded.seed == run.seed)?;
        let file = ExperimentFile::from_text("the record", variant.config.as_str());
        let then = file.variants(&[], None).ok()?.into_iter().next()?;
        if !names_no_other(&then.experiment, &run.variant.experiment) {
            return None;
        }
        // With a plugin that is no longer there, it is not the same; the run itself says which.
        let now = provenance(&run.variant).ok()?;
        let then = provenance(&then).ok()?;
        let is_same = but_for_seed(&then.config, &now.config).next().is_none();
        let version = |plugin: &PluginVersion| {
            let is_it = |kept: &PluginRecord| kept.id == plugin.id && kept.version == plugin.version;
            variant.plugins.values().any(is_it)
        };
        (is_same && self.program == PROGRAM && now.plugins.iter().all(version)).then_some(&recorded.summary)
    }
}

/// Whether the run names every plugin that the record names, and the same file for each: no other file is looked at.
fn names_no_other(recorded: &Experiment, run: &Experiment) -> bool {
    let known = run.plugins();
    recorded.plugins().into_iter().all(|(_, kind, choice)| {
        let is_it = |other: &PluginChoice| other.selection() == choice.selection();
        known.iter().any(|(_, other_kind, other)| *other_kind == kind && is_it(other))
    })
}

/// How two resolved configurations differ, apart from their seed.
pub(super) fn but_for_seed(first: &str, second: &str) -> impl Iterator<Item = Difference> + use<> {
    differences(first, second).into_iter().filter(|difference| !difference.path.starts_with("seeds"))
}

fn same_versions(one: &VariantRecord, other: &VariantRecord) -> bool {
    let versions = |variant: &VariantRecord| {
        let of = |(field, plugin): (&String, &PluginRecord)| {
            (field.clone(), plugin.id.clone(), plugin.version.clone())
        };
        variant.plugins.iter().map(of).collect::<Vec<_>>()
    };
    versions(one) == versions(other)
}

/// Names in the order in which a person would list them: `q_min-2` before `q_min-10`, and numbers with a point by their value.
pub fn natural_order(one: &str, other: &str) -> std::cmp::Ordering {
    let (a, b) = (split_number(one), split_number(other));
    match (a, b) {
        ((stem, Some(x)), (same, Some(y))) if stem == same => x.total_cmp(&y),
        _ => one.cmp(other),
    }
}

/// A name without the number at its end, and that number.
fn split_number(name: &str) -> (&str, Option<f64>) {
    let is_figure = |letter: char| letter.is_ascii_digit() || letter == '.';
    let stem = name.trim_end_matches(is_figure);
    (stem, name[stem.len()..].parse().ok())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn experiment(environment: &str) -> Experiment {
        let text = format!(
            "Experiment(name: \"x\", steps: 1, seeds: [0], mode: StatusQuo, environment: ({environment}), forward: Learner(plugin: \"ddpg\"))"
        );
        let variants = ExperimentFile::from_text("x.ron", text).variants(&[], None).unwrap();
        variants.into_iter().next().unwrap().experiment
    }

    #[test]
    fn a_record_that_names_another_file_than_the_run_is_not_compared() {
        let (plain, placed) = ("plugin: \"arm\"", "plugin: \"arm\", path: \"arm.so\"");
        for (recorded, run, expected) in [
            (plain, plain, true),
            (placed, placed, true),
            (placed, plain, false),
            ("plugin: \"arm\", path: \"other.so\"", placed, false),
            ("plugin: \"leg\"", plain, false),
        ] {
            let is_same = names_no_other(&experiment(recorded), &experiment(run));
            assert_eq!(is_same, expected, "{recorded} in a record, {run} in a run");
        }
    }

    #[test]
    fn variants_are_sorted_by_the_number_at_their_end() {
        let mut names = vec!["q_min-10", "status-quo", "q_min-0.4", "q_min-2", "ours"];
        names.sort_by(|one, other| natural_order(one, other));
        assert_eq!(names, ["ours", "q_min-0.4", "q_min-2", "q_min-10", "status-quo"]);
    }
}
