//! `shield what-if`: the decisions of a run under other settings.

use std::path::{Path, PathBuf};

use clap::Args;
use comfy_table::{Cell, CellAlignment, Table, presets::UTF8_FULL_CONDENSED};
use indicatif::{ProgressBar, ProgressStyle};
use shield_config::experiment::{ExperimentFile, Override, Variant};
use shield_host::plugin::Registry;
use shield_lab::run::{Counterfactual, Replay, calibration, counterfactual, replay};

use super::{Failure, eval::one_run, output};

const RULE: &str = "ensemble-threshold";

/// Arguments of `shield what-if`.
#[derive(Args)]
#[command(after_help = "\
Replays every recorded forward decision through the rules themselves. Only what the rules reject is counted: nothing is projected, and no \
action that was not executed is followed any further.

Examples:
  shield what-if runs/mine/shielded/seed-0 --q-min 5,10,20 --combine min,mean
  shield what-if runs/mine/shielded/seed-0 --set shield.rules[0].config.relative=true
  shield what-if runs/mine/shielded/seed-0 --calibration
  shield what-if runs/mine/shielded/seed-0 --counterfactual")]
pub struct WhatIfArguments {
    /// The folder of a run, <OUT>/<experiment>/<variant>/seed-<n>.
    run: PathBuf,
    /// Values of `q_min` of the rule `ensemble-threshold`, for example 5,10,20.
    #[arg(long, value_delimiter = ',', allow_negative_numbers = true)]
    q_min: Vec<f32>,
    /// Ways to combine of the rule `ensemble-threshold`: min, mean, max, or what its configuration takes.
    #[arg(long, value_delimiter = ',')]
    combine: Vec<String>,
    /// Sets any field of the rules in every row, for example shield.rules[1].config.limit=3. May be repeated.
    #[arg(long = "set", value_name = "PATH=VALUE")]
    sets: Vec<String>,
    /// Tables the reset ensemble's mean value at the start of each reset episode against its success, instead.
    #[arg(long, conflicts_with_all = ["q_min", "combine", "sets", "counterfactual"])]
    calibration: bool,
    /// Restores the states that `record: (states_every: …)` kept, executes each proposed action, and lets the final reset policy try to undo it, instead.
    #[arg(long, conflicts_with_all = ["q_min", "combine", "sets"])]
    counterfactual: bool,
}

/// Tables what the rules would have rejected under other settings.
pub fn what_if(arguments: &WhatIfArguments, registry: &Registry) -> Result<(), Failure> {
    one_run(&arguments.run)?;
    if arguments.calibration {
        return print_calibration(&arguments.run);
    }
    if arguments.counterfactual {
        return print_counterfactual(&arguments.run, registry);
    }
    let file = ExperimentFile::read(arguments.run.join("config.ron"))?;
    let recorded = one_variant(&file, &[])?;
    let has_sets = !arguments.sets.is_empty();
    let not_given = if has_sets { "-" } else { "as recorded" };
    let headings = has_sets.then_some("set").into_iter().chain(["q_min", "combine"]);
    let mut first = vec![String::new(); headings.clone().count()];
    first[0] = "as recorded".into();
    let mut rows = vec![(first, run(registry, &recorded, arguments)?)];
    let or_one = |count: usize| count.max(1);
    for index in 0..or_one(arguments.q_min.len()) * or_one(arguments.combine.len()) {
        let q_min = arguments.q_min.get(index / or_one(arguments.combine.len()));
        let combine = arguments.combine.get(index % or_one(arguments.combine.len()));
        let sets = overrides(&recorded, arguments, q_min, combine)?;
        if sets.is_empty() {
            continue;
        }
        let variant = one_variant(&file, &sets)?;
        let name = |given: Option<String>| given.unwrap_or_else(|| not_given.into());
        let mut settings = vec![name(q_min.map(f32::to_string)), name(combine.cloned())];
        if has_sets {
            settings.insert(0, arguments.sets.join("\n"));
        }
        rows.push((settings, run(registry, &variant, arguments)?));
    }
    output::result(table(headings, &rows))?;
    let every = recorded.experiment.record.decisions;
    if every > 1 {
        output::result(format_args!(
            "Every rejection was recorded, but of the allowed decisions only one in {every} was recorded: shares are of what was recorded. \
             `record: (decisions: 1)` gives the true ones."
        ))?;
    }
    Ok(())
}

fn one_variant(file: &ExperimentFile, sets: &[Override]) -> Result<Variant, Failure> {
    let mut variants = file.variants(sets, None)?;
    Ok(variants.remove(0))
}

fn run(registry: &Registry, variant: &Variant, arguments: &WhatIfArguments) -> Result<Replay, Failure> {
    replay(registry, variant, &arguments.run).map_err(|error| Failure::Input(format!("{error:#}")))
}

/// The overrides of one row of the table.
fn overrides(
    recorded: &Variant,
    arguments: &WhatIfArguments,
    q_min: Option<&f32>,
    combine: Option<&String>,
) -> Result<Vec<Override>, Failure> {
    let mut overrides = Vec::new();
    for set in &arguments.sets {
        let set = Override::parse(set)?;
        if !set.path.starts_with("shield.rules") {
            return Err(Failure::Input(format!(
                "--set {}={}: a replay reads nothing but the rules, `shield.rules`",
                set.path, set.value
            )));
        }
        overrides.push(set);
    }
    if q_min.is_none() && combine.is_none() {
        return Ok(overrides);
    }
    let rules = recorded.experiment.plugins();
    let Some((path, ..)) =
        rules.iter().find(|(path, _, rule)| path.starts_with("shield.") && rule.plugin == RULE)
    else {
        return Err(Failure::Input(format!(
            "the run has no rule {RULE:?}, to which --q-min and --combine belong; --set sets any field of another"
        )));
    };
    if let Some(q_min) = q_min {
        let origin = format!("--q-min {q_min}");
        overrides.push(Override::new(&format!("{path}.config.q_min"), &format!("{q_min:?}"), origin)?);
    }
    if let Some(combine) = combine {
        let value = match combine.as_str() {
            "min" => "Pessimistic",
            "mean" => "Realist",
            "max" => "Optimistic",
            other => other,
        };
        overrides.push(Override::new(
            &format!("{path}.config.combine"),
            value,
            format!("--combine {combine}"),
        )?);
    }
    Ok(overrides)
}

/// A row per replay: what was set, under `headings`, and what came of it.
fn table(headings: impl Iterator<Item = &'static str>, rows: &[(Vec<String>, Replay)]) -> Table {
    let mut table = Table::new();
    table.load_preset(UTF8_FULL_CONDENSED);
    let figures = ["decisions", "rejected", "%", "of them failed", "newly allowed", "newly rejected"];
    table.set_header(headings.chain(figures));
    for (settings, replay) in rows {
        let share = 100.0 * replay.rejected as f64 / replay.decisions.max(1) as f64;
        let figures = [
            replay.decisions.to_string(),
            replay.rejected.to_string(),
            format!("{share:.2}"),
            replay.failed.to_string(),
            replay.newly_allowed.to_string(),
            replay.newly_rejected.to_string(),
        ];
        let mut cells: Vec<Cell> = settings.iter().map(Cell::new).collect();
        cells.extend(figures.map(|figure| Cell::new(figure).set_alignment(CellAlignment::Right)));
        table.add_row(cells);
    }
    table
}

fn print_counterfactual(run: &Path, registry: &Registry) -> Result<(), Failure> {
    let bar = ProgressBar::new_spinner().with_style(
        ProgressStyle::with_template("{spinner} {pos} actions tried, {elapsed}")
            .unwrap_or_else(|_| ProgressStyle::default_spinner()),
    );
    let tried = counterfactual(registry, run, |count| bar.set_position(count));
    bar.finish_and_clear();
    let tried = tried.map_err(|error| Failure::Input(format!("{error:#}")))?;
    let mut table = Table::new();
    table.load_preset(UTF8_FULL_CONDENSED);
    table.set_header(["sampled actions that were", "count", "undone after all", "lost"]);
    for (verdict, count, undone) in [
        ("rejected", tried.rejected, tried.rejected_but_undone),
        ("allowed", tried.allowed, tried.allowed - tried.allowed_but_lost),
    ] {
        let figures = [count, undone, count - undone].map(|figure| figure.to_string());
        let mut cells = vec![Cell::new(verdict)];
        cells.extend(figures.map(|figure| Cell::new(figure).set_alignment(CellAlignment::Right)));
        table.add_row(cells);
    }
    output::result(table)?;
    let Counterfactual { rejected_but_undone, allowed_but_lost, .. } = tried;
    output::result(format_args!(
        "{rejected_but_undone} false aborts (rejected, but undone) and {allowed_but_lost} missed (allowed, but lost)."
    ))?;
    output::result(
        "These are single-step counterfactuals: each action is executed in its restored state, and what follows is the final reset policy's, not the\n\
         policy's of that time. Nothing is said of actions that would have come later.",
    )
}

fn print_calibration(run: &Path) -> Result<(), Failure> {
    let bins = calibration(run).map_err(|error| Failure::Input(format!("{error:#}")))?;
    let mut table = Table::new();
    table.load_preset(UTF8_FULL_CONDENSED);
    table.set_header(["reset value from", "to", "reset episodes", "successful, %"]);
    for bin in &bins {
        let share = 100.0 * bin.successes as f64 / bin.episodes as f64;
        let figures = [
            format!("{:.3}", bin.low),
            format!("{:.3}", bin.high),
            bin.episodes.to_string(),
            format!("{share:.1}"),
        ];
        table.add_row(figures.map(|figure| Cell::new(figure).set_alignment(CellAlignment::Right)));
    }
    output::result(table)
}
