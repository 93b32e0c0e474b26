//! `shield run`: every variant with every seed, in parallel over the cores.

use std::{
    collections::VecDeque,
    panic::{AssertUnwindSafe, catch_unwind},
    path::PathBuf,
    sync::{
        Mutex, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
};

use anyhow::{Context, Result, anyhow};
use clap::Args;
use indexmap::IndexMap;
use indicatif::MultiProgress;
use shield_api::manifest::Manifest;
use shield_runtime::{
    experiment::{Experiment, ExperimentFile, Override, PluginChoice, Variant},
    joint_loop::JointLoop,
    observer::Fanout,
    plugin::{Registry, Selection, clear_metrics, read_manifests},
    run::{Identity, Recorder, RunFolder, Summary, prepare},
};

use super::{Failure, progress::Progress, table};

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
    jobs: Option<usize>,
    /// Removes earlier results of the same runs.
    #[arg(long)]
    overwrite: bool,
}

/// One run to be made.
struct Job<'a> {
    variant: &'a Variant,
    identity: Identity,
    folder: RunFolder,
}

/// Set by Ctrl-C; every run looks at it after each step.
static STOP: AtomicBool = AtomicBool::new(false);

/// What all jobs share.
struct Session<'a> {
    registry: &'a Registry,
    overwrite: bool,
    display: MultiProgress,
}

/// Runs an experiment and prints its table.
pub fn run(arguments: &RunArguments, registry: &Registry) -> Result<(), Failure> {
    let file = ExperimentFile::read(&arguments.experiment)?;
    let variants = file.variants(&overrides(arguments)?, arguments.variants.as_deref())?;
    // Everything that can be wrong with the input shows before the first folder is written.
    for variant in &variants {
        prepare(registry, variant, variant.experiment.seeds[0])?;
    }
    let jobs = jobs(arguments, &variants)?;
    let display = MultiProgress::new();
    stop_on_ctrl_c(&display);
    let session = Session { registry, overwrite: arguments.overwrite, display };
    let workers = arguments.jobs.unwrap_or_else(|| default_jobs(&variants)).clamp(1, jobs.len());
    let total = jobs.len();
    let (summaries, failures) = run_all(&session, jobs, workers);

    let names: Vec<String> = variants.iter().map(|variant| variant.name.clone()).collect();
    if !summaries.is_empty() {
        println!("{}", table::results(&names, &summaries));
        let out = arguments.out.join(&variants[0].experiment.name);
        println!("Runs are in {}.", out.display());
    }
    if !failures.is_empty() {
        return Err(Failure::Run(format!(
            "{} of {total} runs failed:\n  {}",
            failures.len(),
            failures.join("\n  ")
        )));
    }
    if STOP.load(Ordering::Relaxed) {
        return Err(Failure::Interrupted("stopped by Ctrl-C; what was measured is saved".into()));
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

/// Seed by seed, so that the first results of every variant come early.
fn jobs<'a>(arguments: &RunArguments, variants: &'a [Variant]) -> Result<VecDeque<Job<'a>>, Failure> {
    let mut jobs: Vec<(usize, Job<'a>)> = Vec::new();
    for variant in variants {
        for (position, seed) in variant.experiment.seeds.iter().enumerate() {
            let identity = Identity {
                experiment: variant.experiment.name.clone(),
                variant: variant.name.clone(),
                seed: *seed,
            };
            let folder = RunFolder::new(&arguments.out, &identity);
            if folder.exists() && !arguments.overwrite {
                return Err(Failure::Input(format!(
                    "{} exists already; --overwrite replaces it, --out <folder> writes elsewhere",
                    folder.path().display()
                )));
            }
            jobs.push((position, Job { variant, identity, folder }));
        }
    }
    jobs.sort_by_key(|(position, _)| *position);
    Ok(jobs.into_iter().map(|(_, job)| job).collect())
}

fn default_jobs(variants: &[Variant]) -> usize {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let threads = variants.iter().map(|variant| variant.experiment.threads).max().unwrap_or(1);
    (cores / threads).max(1)
}

/// The first Ctrl-C lets every run finish its row and write its summary; the second ends the program at once.
fn stop_on_ctrl_c(display: &MultiProgress) {
    let display = display.clone();
    let installed = ctrlc::set_handler(move || {
        if STOP.swap(true, Ordering::Relaxed) {
            std::process::exit(130);
        }
        display.println("stopping: each run writes its summary; Ctrl-C again ends at once").ok();
    });
    if let Err(error) = installed {
        eprintln!("warning: Ctrl-C will not save the runs: {error}");
    }
}

/// Works through the jobs; a run that fails does not end the others.
fn run_all(session: &Session<'_>, jobs: VecDeque<Job<'_>>, workers: usize) -> (Vec<Summary>, Vec<String>) {
    let queue = Mutex::new(jobs);
    let outcomes = Mutex::new((Vec::new(), Vec::new()));
    std::thread::scope(|scope| {
        for _ in 0..workers {
            scope.spawn(|| {
                while let Some(job) = next(&queue) {
                    let outcome = catch_unwind(AssertUnwindSafe(|| run_one(session, &job)))
                        .unwrap_or_else(|_| Err(anyhow!("the shield itself panicked; please report it")));
                    let mut outcomes = outcomes.lock().unwrap_or_else(PoisonError::into_inner);
                    match outcome {
                        Ok(summary) => outcomes.0.push(summary),
                        Err(error) => outcomes.1.push(format!("{}: {error:#}", job.folder.path().display())),
                    }
                }
            });
        }
    });
    outcomes.into_inner().unwrap_or_else(PoisonError::into_inner)
}

fn next<'a>(queue: &Mutex<VecDeque<Job<'a>>>) -> Option<Job<'a>> {
    if STOP.load(Ordering::Relaxed) {
        return None;
    }
    queue.lock().unwrap_or_else(PoisonError::into_inner).pop_front()
}

fn run_one(session: &Session<'_>, job: &Job<'_>) -> Result<Summary> {
    let Job { variant, identity, folder } = job;
    let experiment = &variant.experiment;
    let prepared = prepare(session.registry, variant, identity.seed)?;
    let manifests = manifests(session.registry, experiment);
    let fields_of = |id: &str| {
        let fields = manifests.iter().find(|manifest| manifest.id == id).map(|manifest| &manifest.fields);
        fields.into_iter().flatten().map(|field| (field.name.clone(), field.default.clone())).collect()
    };
    let config = variant.resolved_ron(identity.seed, &fields_of);
    folder.create(&config, &plugins_json(session.registry, experiment)?, session.overwrite)?;
    let rules = experiment.rules().map(|choice| choice.plugin.clone()).collect();
    let solved_at = experiment.evaluation.as_ref().map_or(1.0, |evaluation| evaluation.solved_at);
    let is_deterministic =
        experiment.shield.deadline_us.is_none() && manifests.iter().all(|manifest| manifest.deterministic);
    let recorder = Recorder::new(folder.clone(), identity.clone(), rules, solved_at)
        .inspect_err(|_| folder.discard())?
        .reset_kinds(prepared.participants.world.reset_kinds())
        .deterministic(is_deterministic);
    let name = format!("{} seed {}", identity.variant, identity.seed);
    let progress = Progress::new(&session.display, name.clone(), experiment.steps);

    // A run that came before on this thread leaves nothing to this one.
    clear_metrics();
    let mut observer = Fanout(recorder, progress);
    let mut joint =
        JointLoop::new(prepared.settings, prepared.participants, prepared.randomness, &mut observer, &STOP);
    let ran = joint.run();
    let counters = *joint.counters();
    drop(joint);
    let Fanout(recorder, progress) = observer;
    progress.finish();
    let ran = ran.with_context(|| format!("{name} failed after {} steps", counters.steps));
    let error = ran.as_ref().err().map(|error| format!("{error:#}"));
    let summary = recorder.finish(&counters, experiment.steps, error);
    if ran.is_err() && counters.steps == 0 {
        folder.discard();
    }
    ran.and(summary)
}

/// Which plugin each field of the experiment is, with version and hash: what `plugins.json` holds.
fn plugins_json(registry: &Registry, experiment: &Experiment) -> Result<String> {
    let mut identities = IndexMap::new();
    for (path, kind, choice) in experiment.plugins() {
        let selection = Selection { path: choice.path.clone(), ..Selection::new(&choice.plugin) };
        identities.insert(path, registry.identify(&selection, kind)?);
    }
    Ok(serde_json::to_string_pretty(&identities)? + "\n")
}

/// The manifests of every plugin that the experiment names, from the file that it is loaded from.
fn manifests(registry: &Registry, experiment: &Experiment) -> Vec<Manifest> {
    let of_choice = |choice: &PluginChoice| match &choice.path {
        Some(path) => {
            let manifests = read_manifests(path).unwrap_or_default();
            manifests.into_iter().find(|manifest| manifest.id == choice.plugin)
        }
        None => {
            let mut entries = registry.entries().iter();
            entries.find(|entry| entry.manifest.id == choice.plugin).map(|entry| entry.manifest.clone())
        }
    };
    experiment.plugins().into_iter().filter_map(|(_, _, choice)| of_choice(choice)).collect()
}
