//! What was known of undoing a rejected action: probabilities and threshold, in words.

use std::path::Path;

use serde::Deserialize;
use shield_api::notation;
use shield_lab::run::{DecisionRow, Recorded};

use super::{Place, Rejection};

const RULE: &str = "undo-probability";

/// A row of `learning.csv`.
#[derive(Debug, Deserialize)]
struct Figure {
    step: u64,
    metric: String,
    mean: f64,
}

/// Sentences about the probabilities of a recorded decision; none where no rule asked for them.
pub fn probabilities(row: &DecisionRow) -> Vec<String> {
    let kinds = [
        (&row.probabilities, "undoing    the proposed action could be undone with a probability of"),
        (&row.greedy_probabilities, "           the reset agent's own action, with"),
        (&row.start_probabilities, "           its action where the last reset ended, with"),
    ];
    let known = kinds.into_iter().filter(|(members, _)| members.iter().any(|member| !member.is_nan()));
    known.map(|(members, words)| format!("  {words} {}", of_members(members))).collect()
}

/// Mean, smallest and largest.
fn of_members(members: &[f32]) -> String {
    let mean = members.iter().copied().map(f64::from).sum::<f64>() / members.len() as f64;
    let low = members.iter().copied().fold(f32::INFINITY, f32::min);
    let high = members.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    match members {
        [one] => format!("{one:.3}"),
        _ => format!("{mean:.3} (mean of {} members, {low:.3} to {high:.3})", members.len()),
    }
}

/// The threshold that was in force when an action was rejected, in words; `None` where no rule has one.
pub fn threshold(run: &Path, rejection: &Rejection, place: Place) -> Option<String> {
    if rejection.rule != RULE {
        return None;
    }
    let mut table = csv::Reader::from_path(run.join("learning.csv")).ok()?;
    let figures = table.deserialize().filter_map(Result::ok);
    let thresholds: Vec<Figure> = figures.filter(|figure: &Figure| figure.metric == "threshold").collect();
    let threshold = in_force(&thresholds, rejection, place)?;
    Some(if is_relative(run) {
        format!("  threshold  {threshold:.3} of the probability where the last reset ended")
    } else {
        format!("  threshold  a probability of {threshold:.3}, wherever the last reset ended")
    })
}

/// The figure of the forward episode in which it was, which is written at its end. An aborted episode ends with the abort; others, which ended
/// at the same step, come before.
fn in_force(thresholds: &[Figure], rejection: &Rejection, place: Place) -> Option<f64> {
    let step = rejection.step;
    let found = match (rejection.phase.as_str(), rejection.verdict.as_str()) {
        ("forward", "abort") => {
            let here: Vec<&Figure> = thresholds.iter().filter(|figure| figure.step == step).collect();
            here.len().checked_sub(place.of).and_then(|before| here.get(before + place.nth).copied())
        }
        ("forward", _) => thresholds.iter().find(|figure| figure.step > step),
        // An attempt changes the threshold only with its end.
        _ => thresholds.iter().rev().find(|figure| figure.step <= step),
    };
    found.map(|figure| figure.mean)
}

/// Whether the rule of this run measures against the start; its default where that cannot be told.
fn is_relative(run: &Path) -> bool {
    #[derive(Deserialize)]
    #[serde(default)]
    struct Config {
        relative: bool,
    }
    impl Default for Config {
        fn default() -> Self {
            Self { relative: true }
        }
    }
    let config = || {
        let recorded = Recorded::read(run, &[]).ok()?;
        notation::from_str::<Config>(recorded.rule(RULE)?.config.get_ron()).ok()
    };
    config().unwrap_or_default().relative
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_probabilities_are_told_in_sentences() {
        let row = DecisionRow {
            probabilities: vec![0.2, 0.4],
            greedy_probabilities: vec![0.9],
            start_probabilities: vec![f32::NAN; 2],
            ..DecisionRow::default()
        };
        let told = probabilities(&row).join("\n");
        assert!(
            told.contains("undone with a probability of 0.300 (mean of 2 members, 0.200 to 0.400)"),
            "{told}"
        );
        assert!(told.ends_with("own action, with 0.900"), "{told}");
        assert!(probabilities(&DecisionRow::default()).is_empty());
    }

    #[test]
    fn the_threshold_is_that_of_the_episode_in_which_it_was() {
        let figure = |(step, mean)| Figure { step, metric: "threshold".into(), mean };
        let thresholds = [(10, 0.1), (20, 0.2), (20, 0.3), (20, 0.4), (35, 0.5)].map(figure);
        let at = |step, phase: &str, verdict: &str, nth, of| {
            let rejection =
                Rejection { step, phase: phase.into(), verdict: verdict.into(), ..Rejection::default() };
            in_force(&thresholds, &rejection, Place { nth, of })
        };
        // The first episode that ended at step 20 was not aborted.
        assert_eq!(at(20, "forward", "abort", 0, 2), Some(0.3));
        assert_eq!(at(20, "forward", "abort", 1, 2), Some(0.4));
        assert_eq!(at(20, "forward", "project", 0, 1), Some(0.5));
        assert_eq!(at(30, "reset", "replace", 0, 1), Some(0.4));
        assert_eq!(at(50, "forward", "abort", 0, 1), None);
    }
}
