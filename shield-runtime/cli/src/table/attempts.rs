//! The table of attempts to get back to the start, below that of the results.

use comfy_table::{CellAlignment, Table, presets::UTF8_FULL_CONDENSED};
use shield_lab::run::Summary;
use shield_report::report::{ATTEMPT_COLUMNS, ATTEMPT_NOTE, has_attempts};

use super::shown;

/// A row per variant; `None` where no run has a success critic or a risk that it accepts.
pub fn attempts(variants: &[String], runs: &[Summary]) -> Option<String> {
    let attempts = |run: &Summary| run.attempts.brier_score.or(run.attempts.accepted_risk);
    runs.iter().find_map(attempts)?;
    let mut table = Table::new();
    table.load_preset(UTF8_FULL_CONDENSED);
    let headings = ATTEMPT_COLUMNS.iter().map(|column| column.heading);
    table.set_header(["variant", "seeds"].into_iter().chain(headings));
    for variant in variants {
        let is_of_variant = |run: &&Summary| run.variant == *variant && has_attempts(run);
        let of_variant: Vec<&Summary> = runs.iter().filter(is_of_variant).collect();
        if !of_variant.is_empty() {
            let cells = ATTEMPT_COLUMNS.iter().map(|column| shown(column.cell(of_variant.iter().copied())));
            table.add_row([variant.clone(), of_variant.len().to_string()].into_iter().chain(cells));
        }
    }
    for column in table.column_iter_mut().skip(1) {
        column.set_cell_alignment(CellAlignment::Right);
    }
    Some(format!("{table}\n{ATTEMPT_NOTE}"))
}

#[cfg(test)]
mod tests {
    use shield_core::events::Counters;
    use shield_lab::run::{AttemptSummary, Identity};

    use super::*;

    fn run(variant: &str, attempts: AttemptSummary) -> Summary {
        let identity = Identity { experiment: "e".into(), variant: variant.into(), seed: 0 };
        Summary { attempts, ..Summary::new(&identity, &Counters::default()) }
    }

    #[test]
    fn attempts_are_tabled_where_something_was_expected_of_them() {
        let counted = AttemptSummary {
            reset_successes: Some(9),
            failed_attempts: Some(3),
            realised_risk: Some(0.25),
            ..AttemptSummary::default()
        };
        let judged = AttemptSummary { accepted_risk: Some(0.2), brier_score: Some(0.1), ..counted.clone() };
        let runs = [run("old", counted.clone()), run("new", judged), run("none", AttemptSummary::default())];
        let names = ["old", "new", "none"].map(str::to_owned);
        let text = attempts(&names, &runs).unwrap_or_default();
        let row = |name: &str| text.lines().find(|line| line.contains(name)).map(str::to_owned);
        assert!(row("old").is_some_and(|row| row.contains("25.0") && row.contains("12")), "{text}");
        assert!(row("new").is_some_and(|row| row.contains("20.0") && row.contains("0.100")), "{text}");
        assert_eq!(row("none"), None, "{text}");
        assert_eq!(attempts(&names, &runs[..1]), None);
    }
}
