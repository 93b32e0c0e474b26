//! The tables at the end of an experiment.

mod attempts;

pub use attempts::attempts;

use comfy_table::{CellAlignment, Table, presets::UTF8_FULL_CONDENSED};
use shield_lab::run::Summary;
use shield_report::report::{COLUMNS, Cell, Column, forward_share, median};

/// A row per variant, in the order of the experiment: medians over the seeds, and the range where it is not a point. `bare` are the variants
/// that were evaluated without their shield only.
pub fn results(variants: &[String], bare: &[String], runs: &[Summary]) -> String {
    let columns: Vec<&Column> = COLUMNS.iter().filter(|column| column.has_figures(runs)).collect();
    let mut table = Table::new();
    table.load_preset(UTF8_FULL_CONDENSED);
    table.set_header(["variant", "seeds"].into_iter().chain(columns.iter().map(|column| column.heading)));
    let mut notes = String::new();
    for variant in variants {
        let of_variant: Vec<&Summary> = runs.iter().filter(|run| run.variant == *variant).collect();
        if of_variant.is_empty() {
            continue;
        }
        let cells = columns.iter().map(|column| shown(column.cell(of_variant.iter().copied())));
        table.add_row([variant.clone(), of_variant.len().to_string()].into_iter().chain(cells));
        let shares: Vec<f64> = of_variant.iter().map(|run| forward_share(run)).collect();
        if median(&shares) < 0.5 && of_variant.iter().any(|run| run.early_aborts > 0) {
            notes += &format!(
                "\nnote: {variant} spent less than half of its steps forward; its hard resets do not compare with the others'."
            );
        }
        if bare.contains(variant) {
            notes += &format!("\nnote: {variant} was evaluated without its shield only.");
        }
        if of_variant.iter().any(|run| !run.complete) {
            notes += &format!("\nnote: {variant} was stopped before its last step.");
        }
    }
    for column in table.column_iter_mut().skip(1) {
        column.set_cell_alignment(CellAlignment::Right);
    }
    format!(
        "{table}\nEach figure is the median over the seeds, with the smallest and the largest below. Return, success and steps to solve: greedy\n\
         episodes from the start, with the shield where there is one. Without the shield: the final return of the same episodes without it.{notes}"
    )
}

/// The range stands below the median.
fn shown(Cell { median, range }: Cell) -> String {
    if range.is_empty() { median } else { format!("{median}\n{range}") }
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
        let text = results(&["a".into(), "b".into()], &[], &runs);
        assert!(text.contains("1 to 9"), "{text}");
        let even = results(&["a".into()], &[], &[run("a", 2, 80), run("a", 3, 80)]);
        assert!(even.contains("2.5") && even.contains("2 to 3"), "{even}");
        assert!(text.contains("note: b spent less than half") && !text.contains("note: a"), "{text}");
    }

    #[test]
    fn the_return_with_the_shield_stands_before_the_one_without() {
        let evaluated = |variant: &str, bare: Option<f64>| Summary {
            final_return: Some(65.25),
            final_return_without_shield: bare,
            steps_to_solve: Some(100),
            solved: Some(false),
            ..run(variant, 1, 80)
        };
        let names = ["shielded".to_owned(), "status-quo".to_owned()];
        let text = results(&names, &[], &[evaluated("shielded", Some(9.5)), evaluated("status-quo", None)]);
        let row = |name: &str| text.lines().find(|line| line.starts_with(&format!("│ {name} "))).unwrap();
        let of_shielded = row("shielded");
        assert!(of_shielded.find("65.25").unwrap() < of_shielded.find("9.50").unwrap(), "{text}");
        assert!(row("status-quo").contains('–') && of_shielded.contains("never"), "{text}");

        let alone = results(&names[..1], &names[..1], &[evaluated("shielded", None)]);
        assert!(
            !alone.contains("the shield │") && alone.contains("note: shielded was evaluated without"),
            "{alone}"
        );
    }
}
