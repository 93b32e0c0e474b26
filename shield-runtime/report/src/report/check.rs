//! What must hold of a record before anything is made of it: others may have written it.

use super::{
    attempts::Forecasts,
    course::{Course, EvaluationCourse},
    places::Places,
    record::{Record, RunRecord},
};
use shield_config::experiment::check_folder_name;
use shield_lab::{reliability::Reliability, run::AttemptSummary};

/// No figure of a run is larger: that many rewards do not fit into a life.
const LARGEST: f64 = 1e60;
/// Most variants of an experiment.
const MOST_VARIANTS: usize = 1_000;
/// Most attempts of a run in one bin.
const MOST_FORECASTS: u64 = 1_000_000_000_000;

/// Says what is wrong with a record, if something is. Names become parts of paths, and figures places in a picture.
pub(super) fn record(record: &Record) -> Result<(), String> {
    let count = record.variants.len();
    ensure(count <= MOST_VARIANTS, || format!("it has {count} variants; {MOST_VARIANTS} are the most"))?;
    // A record of no run has no name.
    if count > 0 || !record.experiment.is_empty() {
        check_folder_name(&record.experiment).map_err(|reason| format!("the experiment's name {reason}"))?;
    }
    for variant in &record.variants {
        let name = &variant.name;
        check_folder_name(name).map_err(|reason| format!("a variant's name {reason}"))?;
        for one in &variant.runs {
            run(one).map_err(|reason| format!("{name}, seed {}: {reason}", one.seed))?;
        }
    }
    Ok(())
}

/// Says what is wrong with a run, if something is.
pub(super) fn run(run: &RunRecord) -> Result<(), String> {
    course(&run.course)?;
    evaluations(&run.evaluations)?;
    let summary = &run.summary;
    let figures = [
        summary.final_return,
        summary.final_return_without_shield,
        summary.best_return,
        summary.best_return_without_shield,
        summary.success_rate,
        summary.success_rate_without_shield,
        summary.lifetime_return,
    ];
    finite("summary", figures.into_iter().flatten())?;
    attempts(&summary.attempts)?;
    if let Some(Forecasts { all, last_half }) = &run.forecasts {
        forecasts(all)?;
        forecasts(last_half)?;
    }
    match &run.aborts {
        Some(Places::Points { points, .. }) => finite("aborts", points.iter().flatten().copied()),
        Some(Places::Cells(_)) | None => Ok(()),
    }
}

/// Shares and scores lie between 0 and 1.
fn attempts(attempts: &AttemptSummary) -> Result<(), String> {
    let shares = [
        ("realised_risk", attempts.realised_risk),
        ("realised_risk_last_half", attempts.realised_risk_last_half),
        ("accepted_risk", attempts.accepted_risk),
        ("brier_score", attempts.brier_score),
        ("calibration_error", attempts.calibration_error),
        ("calibration_error_last_half", attempts.calibration_error_last_half),
    ];
    for (name, share) in shares {
        let is_share = share.is_none_or(|share| (0.0..=1.0).contains(&share));
        ensure(is_share, || format!("`{name}` is {share:?}, which is no share"))?;
    }
    Ok(())
}

/// Sums are rounded to a thousandth.
fn forecasts(reliability: &Reliability) -> Result<(), String> {
    for bin in &reliability.bins {
        let is_possible = bin.forecasts <= MOST_FORECASTS
            && bin.came_true <= bin.forecasts
            && (0.0..=bin.forecasts as f64 + 0.001).contains(&bin.sum);
        ensure(is_possible, || format!("its forecasts have a bin that cannot be: {bin:?}"))?;
    }
    let error = reliability.squared_error;
    let is_possible = (0.0..=reliability.forecasts() as f64 + 0.001).contains(&error);
    ensure(is_possible, || format!("its forecasts have a squared error of {error}"))
}

fn course(course: &Course) -> Result<(), String> {
    let Course { step, forward_steps, early_aborts, hard_resets, irreversible_entries, .. } = course;
    let counts = [
        ("step", step),
        ("forward_steps", forward_steps),
        ("early_aborts", early_aborts),
        ("hard_resets", hard_resets),
        ("irreversible_entries", irreversible_entries),
    ];
    for (name, column) in counts {
        as_long(name, column.len(), step.len())?;
        ensure(column.is_sorted(), || format!("the column `{name}` of its course decreases"))?;
    }
    as_long("lifetime_return", course.lifetime_return.len(), step.len())?;
    as_long("forward_return", course.forward_return.len(), step.len())?;
    finite("lifetime_return", course.lifetime_return.iter().copied())?;
    finite("forward_return", course.forward_return.iter().copied().flatten())
}

fn evaluations(evaluations: &EvaluationCourse) -> Result<(), String> {
    let EvaluationCourse {
        step,
        mean_return,
        success_rate,
        mean_return_without_shield,
        success_rate_without_shield,
    } = evaluations;
    ensure(step.is_sorted(), || "the column `step` of its evaluations decreases".into())?;
    for (name, column) in [("mean_return", mean_return), ("success_rate", success_rate)] {
        as_long(name, column.len(), step.len())?;
        finite(name, column.iter().copied())?;
    }
    let without_shield = [
        ("mean_return_without_shield", mean_return_without_shield),
        ("success_rate_without_shield", success_rate_without_shield),
    ];
    // Where there is no shield, they are empty.
    for (name, column) in without_shield.into_iter().filter(|(_, column)| !column.is_empty()) {
        as_long(name, column.len(), step.len())?;
        finite(name, column.iter().copied())?;
    }
    Ok(())
}

fn as_long(name: &str, length: usize, steps: usize) -> Result<(), String> {
    ensure(length == steps, || format!("the column `{name}` has {length} figures, `step` has {steps}"))
}

fn finite(name: &str, mut figures: impl Iterator<Item = f64>) -> Result<(), String> {
    match figures.find(|figure| !(-LARGEST..=LARGEST).contains(figure)) {
        Some(figure) => Err(format!("`{name}` has the figure {figure:e}; {LARGEST:e} is the largest")),
        None => Ok(()),
    }
}

fn ensure(holds: bool, complaint: impl FnOnce() -> String) -> Result<(), String> {
    if holds { Ok(()) } else { Err(complaint()) }
}
