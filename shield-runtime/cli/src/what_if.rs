//! `shield what-if`: the decisions of a run under other settings.

mod calibration;
mod settings;

use std::path::{Path, PathBuf};

use clap::Args;
use comfy_table::{Cell, CellAlignment, Table, presets::UTF8_FULL_CONDENSED};
use indicatif::{ProgressBar, ProgressStyle};
use shield_core::events::AttemptOutcome;
use shield_host::plugin::Registry;
use shield_lab::run::{Counterfactual, Recorded, Replay, counterfactual, read_attempts, replay};

use self::settings::{Axis, Row, Settings};
use super::{Failure, eval::one_run, output};

/// Arguments of `shield what-if`.
#[derive(Args)]
#[command(after_help = "\
Replays every recorded forward decision through the rules themselves. Only what the rules reject is counted: nothing is projected, and no \
action that was not executed is followed any further.

The rule `undo-probability` moves its threshold with the outcome of each attempt to get back to the start. In a replay it hears the outcomes of \
the attempts that the run made, in their order. With another accepted risk the shield would have aborted elsewhere, and other attempts would \
have followed; how these would have ended, no replay can know. So a row of --risk shows in which direction a setting acts, the less the \
further it lies from the recorded one.

Examples:
  shield what-if runs/mine/shielded/seed-0 --risk 0.1,0.2
  shield what-if runs/mine/shielded/seed-0 --q-min 5,10,20 --combine min,mean
  shield what-if runs/mine/shielded/seed-0 --set shield.rules[0].config.relative=true
  shield what-if record --risk 0.1,0.2       the record of a drop-in, such as `record=` in Python
  shield what-if runs/mine/shielded/seed-0 --calibration
  shield what-if runs/mine/shielded/seed-0 --counterfactual")]
pub struct WhatIfArguments {
    /// The folder of a run, <OUT>/<experiment>/<variant>/seed-<n>, or the record of a drop-in, such as `record=` of Python's ShieldedEnv writes.
    run: PathBuf,
    /// Accepted risks of the rule `undo-probability`, for example 0.1,0.2: shares of the attempts that may fail.
    #[arg(long, value_delimiter = ',', conflicts_with = "q_min")]
    risk: Vec<f32>,
    /// Values of `q_min` of the rule `ensemble-threshold`, for example 5,10,20.
    #[arg(long, value_delimiter = ',', allow_negative_numbers = true)]
    q_min: Vec<f32>,
    /// Ways to combine of the rule `ensemble-threshold` or `undo-probability`: min, mean, max, or what its configuration takes.
    #[arg(long, value_delimiter = ',')]
    combine: Vec<String>,
    /// Sets any field of the rules in every row, for example shield.rules[1].config.limit=3. May be repeated.
    #[arg(long = "set", value_name = "PATH=VALUE")]
    sets: Vec<String>,
    /// Tables the reset ensemble's mean value at the start of each reset episode, and the success critic's estimate, against its success, instead.
    #[arg(long, conflicts_with_all = ["risk", "q_min", "combine", "sets", "counterfactual"])]
    calibration: bool,
    /// Restores the states that `record: (states_every: …)` kept, executes each proposed action, and lets the final reset policy try to undo it, instead.
    #[arg(long, conflicts_with_all = ["risk", "q_min", "combine", "sets"])]
    counterfactual: bool,
}

/// Tables what the rules would have rejected under other settings.
pub fn what_if(arguments: &WhatIfArguments, registry: &Registry) -> Result<(), Failure> {
    one_run(&arguments.run)?;
    if arguments.calibration {
        return calibration::print(&arguments.run);
    }
    if arguments.counterfactual {
        if let Recorded::DropIn(_) = Recorded::read(&arguments.run, &[])? {
            return Err(Failure::Input(format!(
                "{} is the record of a shield in another program's loop, whose environment cannot be put back into a state from here: \
                 --counterfactual needs a run of `shield run`",
                arguments.run.display()
            )));
        }
        return print_counterfactual(&arguments.run, registry);
    }
    let recorded = Recorded::read(&arguments.run, &[])?;
    let axis = Axis::of(arguments, &recorded);
    let settings = Settings::of(arguments, axis)?;
    let mut rows = vec![(settings.as_recorded(&recorded), run(registry, &recorded, arguments)?)];
    for Row { cells, overrides } in settings.rows(&recorded)? {
        rows.push((cells, run(registry, &Recorded::read(&arguments.run, &overrides)?, arguments)?));
    }
    output::result(table(&settings.headings(), &rows))?;
    if axis == Axis::Risk {
        output::result(told_of_attempts(&arguments.run)?)?;
    }
    let every = recorded.every(&arguments.run).map_err(|error| Failure::Input(format!("{error:#}")))?;
    if every > 1 {
        output::result(format_args!(
            "Every rejection was recorded, but of the allowed decisions only one in {every} was recorded: shares are of what was recorded. \
             `record: (decisions: 1)` gives the true ones."
        ))?;
    }
    Ok(())
}

fn run(registry: &Registry, recorded: &Recorded, arguments: &WhatIfArguments) -> Result<Replay, Failure> {
    replay(registry, recorded, &arguments.run).map_err(|error| Failure::Input(format!("{error:#}")))
}

/// What the rules heard of attempts, and what that leaves open.
fn told_of_attempts(run: &Path) -> Result<String, Failure> {
    let attempts = read_attempts(run).map_err(|error| Failure::Input(format!("{error:#}")))?;
    if attempts.is_empty() {
        return Ok(
            "The run recorded no attempt whose outcome could be told to the rule: its threshold stays."
                .into(),
        );
    }
    let failed = attempts.iter().filter(|attempt| attempt.outcome == AttemptOutcome::Failed).count();
    let share = 100.0 * failed as f64 / attempts.len() as f64;
    Ok(format!(
        "The rule hears how the {} attempts of the run ended: {failed} failed ({share:.0}%). A replay cannot know the outcomes of attempts that were\n\
         not made, and with another accepted risk others would have been. So a row shows in which direction a setting acts, the less the\n\
         further it lies from the recorded one.",
        attempts.len()
    ))
}

/// A row per replay: what was set, under `headings`, and what came of it.
fn table(headings: &[&str], rows: &[(Vec<String>, Replay)]) -> Table {
    let mut table = Table::new();
    table.load_preset(UTF8_FULL_CONDENSED);
    let figures = ["decisions", "rejected", "%", "of them failed", "newly allowed", "newly rejected"];
    let has_threshold = rows.iter().any(|(_, replay)| replay.mean_threshold.is_some());
    let mean = has_threshold.then_some("mean threshold");
    table.set_header(headings.iter().copied().chain(figures).chain(mean));
    for (settings, replay) in rows {
        let share = 100.0 * replay.rejected as f64 / replay.decisions.max(1) as f64;
        let mut figures = vec![
            replay.decisions.to_string(),
            replay.rejected.to_string(),
            format!("{share:.2}"),
            replay.failed.to_string(),
            replay.newly_allowed.to_string(),
            replay.newly_rejected.to_string(),
        ];
        let threshold = || replay.mean_threshold.map_or("-".into(), |threshold| format!("{threshold:.3}"));
        figures.extend(has_threshold.then(threshold));
        let mut cells: Vec<Cell> = settings.iter().map(Cell::new).collect();
        let figures = figures.into_iter();
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
