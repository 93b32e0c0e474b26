//! `shield explain`: why an action was rejected.

mod undoing;

use std::{collections::BTreeMap, path::PathBuf};

use anyhow::{Context, Result};
use clap::Args;
use serde::Deserialize;
use shield_lab::run::{DecisionRow, read_decisions};

use super::{Failure, eval::one_run, output};

/// Arguments of `shield explain`.
#[derive(Args)]
pub struct ExplainArguments {
    /// The folder of a run, <OUT>/<experiment>/<variant>/seed-<n>, or the record of a drop-in, such as `record=` of Python's ShieldedEnv writes.
    run: PathBuf,
    /// The environment step whose rejection is explained; without it, the last one after a count of all.
    #[arg(long)]
    step: Option<u64>,
}

/// A row of `interventions.csv`.
#[derive(Debug, Clone, Default, Deserialize)]
struct Rejection {
    step: u64,
    phase: String,
    verdict: String,
    cause: String,
    rule: String,
    score: String,
    reason: String,
    proposed: String,
    executed: String,
    solver_status: String,
    iterations: String,
    distance: String,
}

/// Which it is of several alike at one step: aborts with nothing to undo follow one another without a step between them.
#[derive(Debug, Clone, Copy)]
struct Place {
    nth: usize,
    of: usize,
}

impl Place {
    fn of(rejections: &[Rejection], index: usize) -> Self {
        let key = |one: &Rejection| (one.step, one.phase.clone(), one.verdict.clone());
        let is_alike = |one: &&Rejection| key(one) == key(&rejections[index]);
        let nth = rejections[..index].iter().filter(is_alike).count();
        Self { nth, of: rejections.iter().filter(is_alike).count() }
    }
}

/// Prints why an action was rejected: rule, members, probabilities, threshold, and what projection tried.
pub fn explain(arguments: &ExplainArguments) -> Result<(), Failure> {
    let input = |error: anyhow::Error| Failure::Input(format!("{error:#}"));
    one_run(&arguments.run)?;
    let rejections = read(arguments).map_err(input)?;
    if rejections.is_empty() {
        return output::result("No action was rejected.");
    }
    let explain = |index: usize| explained(arguments, &rejections[index], Place::of(&rejections, index));
    let Some(step) = arguments.step else {
        return output::result(counted(&rejections) + &explain(rejections.len() - 1));
    };
    let chosen: Vec<usize> = (0..rejections.len()).filter(|index| rejections[*index].step == step).collect();
    if chosen.is_empty() {
        let near = rejections.iter().min_by_key(|rejection| rejection.step.abs_diff(step));
        let near = near.map_or(0, |rejection| rejection.step);
        return Err(Failure::Input(format!(
            "no action was rejected at step {step}; the nearest rejection is at step {near}: --step {near}"
        )));
    }
    let texts: Vec<String> = chosen.into_iter().map(explain).collect();
    output::result(texts.join("\n"))
}

fn read(arguments: &ExplainArguments) -> Result<Vec<Rejection>> {
    let path = arguments.run.join("interventions.csv");
    let mut table =
        csv::Reader::from_path(&path).with_context(|| format!("{} cannot be read", path.display()))?;
    let rows: Result<Vec<_>, _> = table.deserialize().collect();
    rows.with_context(|| format!("{} is damaged", path.display()))
}

/// How often each rule rejected what, with a line break at the end.
fn counted(rejections: &[Rejection]) -> String {
    let mut counts: BTreeMap<(&str, &str, &str, &str), u64> = BTreeMap::new();
    for rejection in rejections {
        let Rejection { phase, verdict, cause, rule, .. } = rejection;
        *counts.entry((phase, verdict, cause, rule)).or_default() += 1;
    }
    let mut text = format!("{} actions were rejected:\n", rejections.len());
    for ((phase, verdict, cause, rule), count) in counts {
        let by = if rule.is_empty() { String::new() } else { format!(" by {rule}") };
        text += &format!("  {count:>8}  {phase}, {verdict}: {cause}{by}\n");
    }
    text + "The last of them:\n\n"
}

fn explained(arguments: &ExplainArguments, rejection: &Rejection, place: Place) -> String {
    let Rejection { step, phase, verdict, cause, rule, score, reason, .. } = rejection;
    let mut lines =
        vec![format!("step {step}, {phase} agent: {verdict} ({cause})"), format!("  why        {reason}")];
    if !rule.is_empty() {
        let compared =
            score.parse().map_or(String::new(), |score| format!(", which compared {}", short(score)));
        lines.push(format!("  rule       {rule}{compared}"));
    }
    let found = find(arguments, rejection, place);
    if let Ok(Some(row)) = &found {
        lines.extend(undoing::probabilities(row));
    }
    lines.extend(undoing::threshold(&arguments.run, rejection, place));
    lines.push(format!("  proposed   {}", rejection.proposed));
    lines.push(match verdict.as_str() {
        "abort" => "  executed   nothing: the reset agent took over".into(),
        _ => format!("  executed   {}", rejection.executed),
    });
    lines.push(format!("  projection {}", tried(rejection)));
    match found {
        Ok(Some(row)) => lines.extend(members(&row)),
        Ok(None) => {
            lines.push("  members    this decision was not recorded (`record: (decisions: …)`)".into())
        }
        Err(error) if arguments.run.join("decisions").is_dir() => {
            lines.push(format!("  members    {error:#}"));
        }
        Err(_) => lines.push("  members    no decisions were recorded (`record: (decisions: …)`)".into()),
    }
    lines.join("\n")
}

/// What projection tried.
fn tried(rejection: &Rejection) -> String {
    let Rejection { verdict, cause, solver_status, iterations, distance, executed, .. } = rejection;
    match (verdict.as_str(), solver_status.as_str(), cause.as_str()) {
        ("project", "", _) => format!("another action was allowed as it is: {executed}"),
        ("project", _, _) => {
            let times = if iterations == "1" { "once" } else { &format!("{iterations} times") };
            format!("a program was solved, linearised {times}, distance {distance} from the proposed action")
        }
        (_, "infeasible", _) => "no action keeps the rules' rows".to_owned(),
        (_, "", "still_rejected") => "what was found, the rules reject too".to_owned(),
        (_, "", "not_linearisable") => "a rule has no rows".to_owned(),
        (_, "", _) => "nothing was tried".to_owned(),
        (_, status, _) => format!("the solver: {status}"),
    }
}

/// The recorded decision of a rejection.
fn find(arguments: &ExplainArguments, rejection: &Rejection, place: Place) -> Result<Option<DecisionRow>> {
    let (mut found, mut before) = (None, 0);
    read_decisions(&arguments.run, |row| {
        let Rejection { step, phase, verdict, .. } = rejection;
        let is_alike = (&row.step, &row.phase, &row.verdict) == (step, phase, verdict);
        let is_it = is_alike && before == place.nth;
        before += usize::from(is_alike);
        let is_beyond = row.step > rejection.step;
        if is_it {
            found = Some(row);
        }
        Ok(!is_it && !is_beyond)
    })?;
    Ok(found)
}

fn members(row: &DecisionRow) -> impl Iterator<Item = String> {
    let figures = |numbers: &[f32]| numbers.iter().copied().map(short).collect::<Vec<_>>().join(" ");
    let kinds = [
        ("members", &row.values),
        ("greedy", &row.greedy_values),
        ("forward", &row.forward_values),
        ("scores", &row.scores),
    ];
    let known = kinds.into_iter().filter(|(_, values)| !values.is_empty());
    known.map(move |(name, values)| format!("  {name:<10} {}", figures(values)))
}

/// Six decimals at most, or scientific where these would hide it.
fn short(value: f32) -> String {
    let (plain, shortest) = (format!("{value:.6}"), value.to_string());
    match value.abs() {
        small if small > 0.0 && small < 1e-4 => format!("{value:.3e}"),
        _ if shortest.len() < plain.len() => shortest,
        _ => plain,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_printed_with_six_digits_at_most() {
        let shown = [5.611_509_6e-14, 0.123_456_79, 0.4, -2.5, 0.0, f32::NAN].map(short);
        assert_eq!(shown, ["5.612e-14", "0.123457", "0.4", "-2.5", "0", "NaN"]);
    }
}
