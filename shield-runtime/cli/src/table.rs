//! The tables at the end of an experiment.

mod attempts;

pub use attempts::attempts;

use comfy_table::{CellAlignment, Table, presets::UTF8_FULL_CONDENSED};
use shield_lab::run::Summary;
use shield_report::report::{median, show};

/// A column: its heading, the figure of one run, and how many decimals it has.
struct Column {
    heading: &'static str,
    figure: fn(&Summary) -> Option<f64>,
    decimals: usize,
}

const COLUMNS: [Column; 9] = [
    Column { heading: "steps", figure: |run| Some(run.steps as f64), decimals: 0 },
    Column { heading: "of them\nforward, %", figure: |run| Some(forward_share(run) * 100.0), decimals: 0 },
    Column { heading: "early\naborts", figure: |run| Some(run.early_aborts as f64), decimals: 0 },
    Column { heading: "hard\nresets", figure: |run| Some(run.hard_resets as f64), decimals: 0 },
    Column {
        heading: "irreversible\nentries",
        figure: |run| Some(run.irreversible_entries as f64),
        decimals: 0,
    },
    Column { heading: "final\nreturn", figure: |run| run.final_return, decimals: 2 },
    Column { heading: "best\nreturn", figure: |run| run.best_return, decimals: 2 },
    Column { heading: "success,\n%", figure: |run| run.success_rate.map(|rate| rate * 100.0), decimals: 0 },
    Column {
        heading: "steps\nto solve",
        figure: |run| run.steps_to_solve.map(|steps| steps as f64),
        decimals: 0,
    },
];

fn forward_share(run: &Summary) -> f64 {
    run.forward_steps as f64 / (run.steps.max(1)) as f64
}

/// A row per variant, in the order of the experiment: medians over the seeds, and the range where it is not a point.
pub fn results(variants: &[String], runs: &[Summary]) -> String {
    let mut table = Table::new();
    table.load_preset(UTF8_FULL_CONDENSED);
    table.set_header(["variant", "seeds"].into_iter().chain(COLUMNS.iter().map(|column| column.heading)));
    let mut notes = String::new();
    for variant in variants {
        let of_variant: Vec<&Summary> = runs.iter().filter(|run| run.variant == *variant).collect();
        if of_variant.is_empty() {
            continue;
        }
        let cells = COLUMNS.iter().map(|column| cell(column, &of_variant));
        table.add_row([variant.clone(), of_variant.len().to_string()].into_iter().chain(cells));
        let shares: Vec<f64> = of_variant.iter().map(|run| forward_share(run)).collect();
        if median(&shares) < 0.5 && of_variant.iter().any(|run| run.early_aborts > 0) {
            notes += &format!(
                "\nnote: {variant} spent less than half of its steps forward; its hard resets do not compare with the others'."
            );
        }
        if of_variant.iter().any(|run| !run.complete) {
            notes += &format!("\nnote: {variant} was stopped before its last step.");
        }
    }
    for column in table.column_iter_mut().skip(1) {
        column.set_cell_alignment(CellAlignment::Right);
    }
    format!(
        "{table}\nEach figure is the median over the seeds, with the smallest and the largest below. Return and success: greedy, of the last evaluation.{notes}"
    )
}

fn cell(column: &Column, runs: &[&Summary]) -> String {
    let mut figures: Vec<f64> = runs.iter().filter_map(|run| (column.figure)(run)).collect();
    if figures.is_empty() {
        return "-".into();
    }
    figures.sort_by(f64::total_cmp);
    let show = |figure: f64| show(figure, column.decimals);
    let (low, high) = (show(figures[0]), show(figures[figures.len() - 1]));
    let middle = show(median(&figures));
    if low == high { middle } else { format!("{middle}\n{low} to {high}") }
}

#[cfg(test)]
mod tests {
    use shield_core::events::Counters;
    use shield_lab::run::Identity;

    use super::*;

    fn run(variant: &str, hard_resets: u64, forward_steps: u64) -> Summary {
        let identity = Identity { experiment: "e".into(), variant: variant.into(), seed: 0 };
        let counters =
            Counters { steps: 100, forward_steps, hard_resets, early_aborts: 5, ..Counters::default() };
        Summary { complete: true, ..Summary::new(&identity, &counters) }
    }

    #[test]
    fn a_variant_is_summed_up_by_median_and_range() {
        let runs = [run("a", 1, 80), run("b", 7, 30), run("a", 3, 80), run("a", 9, 80)];
        let text = results(&["a".into(), "b".into()], &runs);
        assert!(text.contains("1 to 9"), "{text}");
        let even = results(&["a".into()], &[run("a", 2, 80), run("a", 3, 80)]);
        assert!(even.contains("2.5") && even.contains("2 to 3"), "{even}");
        assert!(text.contains("note: b spent less than half") && !text.contains("note: a"), "{text}");
    }
}
