//! What the pages have in common: a table of an experiment's variants, and what its file says of itself.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result};

use super::experiments::Experiment;
use super::record::{Record, Spread, Summary, Variant};

/// A figure of a run.
pub type Figure = fn(&Summary) -> Option<f64>;

/// What a table shows of a run: heading, figure, decimals.
pub type Column = (&'static str, Figure, usize);

/// What stands where nothing was measured.
pub const GAP: &str = "–";

/// The comment at the head of the experiment's file.
///
/// # Errors
/// The file cannot be read.
pub fn introduction(root: &Path, experiment: &Experiment) -> Result<String> {
    let path = root.join(experiment.file());
    let text = fs::read_to_string(&path).with_context(|| format!("{} cannot be read", path.display()))?;
    let comments = text.lines().map_while(|line| line.strip_prefix("//")).map(str::trim);
    Ok(comments.collect::<Vec<_>>().join("\n"))
}

/// A row per variant; `spread` says what is shown of the figures of its runs.
pub fn table(record: &Record, columns: &[Column], spread: fn(&Variant, Figure) -> Option<Spread>) -> String {
    // A column of nothing but zeros and gaps says nothing.
    let is_telling = |(_, figure, _): &&Column| {
        let mut spreads = record.variants.iter().filter_map(|variant| spread(variant, *figure));
        spreads.any(|Spread(lower, _, upper)| lower != 0.0 || upper != 0.0)
    };
    let shown: Vec<&Column> = columns.iter().filter(is_telling).collect();
    let headings = shown.iter().map(|(heading, ..)| format!(" {heading} |"));
    let mut table = format!("| variant | seeds |{}\n", headings.collect::<String>());
    table += &format!("|---|---|{}\n", "---|".repeat(shown.len()));
    for variant in &record.variants {
        let cell =
            |(_, figure, decimals): &&Column| format!(" {} |", show(spread(variant, *figure), *decimals));
        let cells: String = shown.iter().map(cell).collect();
        table += &format!("| {} | {} |{cells}\n", variant.name, variant.runs.len());
    }
    table
}

/// A figure with what is around it, or a gap.
pub fn show(spread: Option<Spread>, decimals: usize) -> String {
    spread.map_or_else(|| GAP.into(), |spread| spread.show(decimals))
}

pub fn thousands(figure: u64) -> String {
    let digits = figure.to_string();
    let groups: Vec<&str> = digits
        .as_bytes()
        .rchunks(3)
        .rev()
        .map(|group| std::str::from_utf8(group).unwrap_or_default())
        .collect();
    groups.join(",")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn large_figures_have_commas() {
        assert_eq!(["7", "1,000", "50,000"].map(String::from), [7, 1_000, 50_000].map(thousands));
    }
}
