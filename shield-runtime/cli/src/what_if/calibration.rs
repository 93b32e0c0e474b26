//! `shield what-if --calibration`: what was expected at the start of attempts, and how they ended.

use std::path::Path;

use comfy_table::{Cell, CellAlignment, Table, presets::UTF8_FULL_CONDENSED};
use shield_lab::{
    reliability::{BINS, Reliability},
    run::{CalibrationBin, calibration, last_half, read_attempts, reliability},
};

use super::{Failure, output};

/// Prints a table of the reset values, and one of the undo probabilities where there is a success critic.
pub fn print(run: &Path) -> Result<(), Failure> {
    let input = |error: anyhow::Error| Failure::Input(format!("{error:#}"));
    let bins = calibration(run).map_err(input)?;
    let attempts = read_attempts(run).map_err(input)?;
    let all = reliability(&attempts);
    if bins.is_empty() && all.forecasts() == 0 {
        return Err(Failure::Input(format!("{} has no reset episodes with a forecast", run.display())));
    }
    if !bins.is_empty() {
        output::result(values(&bins))?;
    }
    if all.forecasts() == 0 {
        return Ok(());
    }
    output::result(probabilities(&all))?;
    let later = reliability(last_half(&attempts)).calibration_error();
    output::result(format_args!(
        "Brier score {}, expected calibration error {}, of the later half of the attempts {}.",
        shown(all.brier_score()),
        shown(all.calibration_error()),
        shown(later)
    ))
}

/// A row for each group of reset values at the start.
fn values(bins: &[CalibrationBin]) -> Table {
    let mut table = headed(&["reset value from", "to", "reset episodes", "successful, %"]);
    for bin in bins {
        let share = 100.0 * bin.successes as f64 / bin.episodes as f64;
        let figures = [
            format!("{:.3}", bin.low),
            format!("{:.3}", bin.high),
            bin.episodes.to_string(),
            format!("{share:.1}"),
        ];
        table.add_row(figures.map(right));
    }
    table
}

/// A row for each tenth that some estimate lies in.
fn probabilities(reliability: &Reliability) -> Table {
    let mut table = headed(&["undo probability from", "to", "attempts", "expected, %", "successful, %"]);
    for (index, bin) in reliability.bins.iter().enumerate() {
        let (Some(predicted), Some(realised)) = (bin.predicted(), bin.realised()) else { continue };
        let bound = |index: usize| format!("{:.1}", index as f64 / BINS as f64);
        let percent = |share: f64| format!("{:.1}", share * 100.0);
        let figures = [
            bound(index),
            bound(index + 1),
            bin.forecasts.to_string(),
            percent(predicted),
            percent(realised),
        ];
        table.add_row(figures.map(right));
    }
    table
}

fn headed(headings: &[&str]) -> Table {
    let mut table = Table::new();
    table.load_preset(UTF8_FULL_CONDENSED);
    table.set_header(headings);
    table
}

fn right(text: String) -> Cell {
    Cell::new(text).set_alignment(CellAlignment::Right)
}

fn shown(figure: Option<f64>) -> String {
    figure.map_or("-".into(), |figure| format!("{figure:.3}"))
}
