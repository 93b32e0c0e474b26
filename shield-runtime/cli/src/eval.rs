//! `shield eval`: what the agents of a run, as its last checkpoint has them, reach in fresh episodes.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use comfy_table::{CellAlignment, Table, presets::UTF8_FULL_CONDENSED};
use serde::Serialize;
use shield_config::experiment::{Mode, Override};
use shield_core::events::{EvaluationEvent, EvaluationFigures};
use shield_host::plugin::Registry;
use shield_lab::run::{Restored, RunFolder, restore};

use super::{Failure, output};

/// Arguments of `shield eval`.
#[derive(Args)]
pub struct EvalArguments {
    /// Folders of runs, or of everything that an experiment wrote. They are only read.
    #[arg(required = true)]
    folders: Vec<PathBuf>,
    /// Episodes of each run.
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..))]
    episodes: u32,
    /// Leaves out runs that have no shield. The others are evaluated with it, and from the same seeds without it, in any case.
    #[arg(long)]
    shielded: bool,
    /// Whose episodes they are. The reset agent's, without the shield: its return is its own reward, its success the reset set.
    #[arg(long, value_enum, default_value_t = Who::Forward)]
    agent: Who,
    /// The named start of each episode, instead of the usual one.
    #[arg(long)]
    start: Option<String>,
    /// Prints JSON, an object per run, instead of the table.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Who {
    Forward,
    Reset,
}

/// What one run reached.
#[derive(Serialize)]
struct Evaluated {
    run: String,
    variant: String,
    seed: u64,
    /// Training steps of the agents.
    step: u64,
    episodes: u32,
    /// With the shield, where there is one.
    #[serde(flatten)]
    figures: EvaluationFigures,
    mean_return_without_shield: Option<f64>,
    success_rate_without_shield: Option<f64>,
    irreversible_entries_without_shield: Option<u64>,
    steps_without_shield: Option<u64>,
}

/// Evaluates every run that can be, and prints what came out.
pub fn run(arguments: &EvalArguments, registry: &Registry) -> Result<(), Failure> {
    let settings = settings(arguments)?;
    let mut folders = Vec::new();
    for root in &arguments.folders {
        folders.extend(runs_in(root)?);
    }
    let (mut evaluated, mut left_out) = (Vec::new(), Vec::new());
    for folder in &folders {
        match restore(registry, folder, std::slice::from_ref(&settings)) {
            Ok(restored) if arguments.shielded && restored.run.variant.experiment.mode != Mode::Shielded => {
                left_out.push(format!("{}: there is no shield", folder.path().display()));
            }
            Ok(restored) => evaluated.push(evaluate(restored, arguments.episodes)?),
            Err(error) => left_out.push(format!("{}: {error:#}", folder.path().display())),
        }
    }
    if evaluated.is_empty() {
        return Err(Failure::Input(format!(
            "no run can be evaluated with these options:\n  {}",
            left_out.join("\n  ")
        )));
    }
    for reason in left_out {
        output::message(format_args!("warning: left out: {reason}"));
    }
    if arguments.json {
        let text = serde_json::to_string_pretty(&evaluated);
        output::result(text.map_err(|error| Failure::Run(error.to_string()))?)
    } else {
        output::result(table(&evaluated))
    }
}

/// The runs in a folder; at least one.
pub fn runs_in(root: &Path) -> Result<Vec<RunFolder>, Failure> {
    let folders = RunFolder::find(root).map_err(|error| Failure::Input(format!("{error:#}")))?;
    if folders.is_empty() {
        return Err(Failure::Input(format!(
            "{} has no run in it; a run is a folder with a config.ron, as `shield run` writes it",
            root.display()
        )));
    }
    Ok(folders)
}

/// The run that a folder is.
pub fn one_run(path: &Path) -> Result<RunFolder, Failure> {
    if path.join("config.ron").is_file() {
        return Ok(RunFolder::at(path));
    }
    let inside = RunFolder::find(path).ok().and_then(|found| found.into_iter().next());
    let example = inside.map_or("runs/mine/default/seed-0".into(), |run| run.path().display().to_string());
    let path = path.display();
    Err(Failure::Input(format!("{path} is not the folder of a run; give one, such as {example}")))
}

/// The evaluation of the experiment gives way to that of the arguments.
fn settings(arguments: &EvalArguments) -> Result<Override, Failure> {
    let EvalArguments { episodes, agent, start, .. } = arguments;
    let start = start.as_ref().map_or("None".to_owned(), |start| format!("Some({start:?})"));
    let value = format!("Some((every: 1, episodes: {episodes}, agent: {agent:?}, start: {start}))");
    Ok(Override::new("evaluation", &value, "the arguments of `shield eval`")?)
}

fn evaluate(restored: Restored, episodes: u32) -> Result<Evaluated, Failure> {
    let Restored { run, mut parts, state } = restored;
    let Some(evaluator) = &mut parts.evaluator else {
        return Err(Failure::Run("the experiment has no evaluation".into()));
    };
    let EvaluationEvent { step, figures, without_shield: bare } = evaluator
        .run(state.counters().steps, parts.agents.agents())
        .map_err(|error| Failure::Run(format!("{}: {error}", run.folder.path().display())))?;
    Ok(Evaluated {
        run: run.folder.path().display().to_string(),
        variant: run.variant.name,
        seed: run.seed,
        step,
        episodes,
        figures,
        mean_return_without_shield: bare.map(|bare| bare.mean_return),
        success_rate_without_shield: bare.map(|bare| bare.success_rate),
        irreversible_entries_without_shield: bare.map(|bare| bare.irreversible_entries),
        steps_without_shield: bare.map(|bare| bare.steps),
    })
}

fn table(evaluated: &[Evaluated]) -> String {
    let mut table = Table::new();
    table.load_preset(UTF8_FULL_CONDENSED);
    table.set_header([
        "variant",
        "seed",
        "trained\nsteps",
        "episodes",
        "mean\nreturn",
        "without\nthe shield",
        "success,\n%",
        "irreversible\nentries",
        "mean\nlength",
    ]);
    for row in evaluated {
        table.add_row([
            row.variant.clone(),
            row.seed.to_string(),
            row.step.to_string(),
            row.episodes.to_string(),
            format!("{:.2}", row.figures.mean_return),
            row.mean_return_without_shield.map_or("–".into(), |mean| format!("{mean:.2}")),
            format!("{:.0}", row.figures.success_rate * 100.0),
            row.figures.irreversible_entries.to_string(),
            format!("{:.0}", row.figures.steps as f64 / f64::from(row.episodes)),
        ]);
    }
    for column in table.column_iter_mut().skip(1) {
        column.set_cell_alignment(CellAlignment::Right);
    }
    table.to_string()
}
