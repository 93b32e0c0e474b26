//! The paper's RESULTS.md: every claim with what was found, and every experiment with its figures.

use std::fmt::Write;
use std::path::Path;

use anyhow::Result;

use super::Recorded;
use super::claims::{CLAIMS, Claim, Verdict};
use super::record::{Record, Summary};
use super::tables::{Column, introduction, table, thousands};

const HEAD: &str = "# Results

Written by `cargo xtask reproduce`: from the records in this folder, not by hand. It runs what is neither recorded nor finished, draws the plots and computes the verdicts;
`cargo xtask reproduce --no-run` only writes this page anew. A recorded run is not made again as long as its configuration and the versions of the program and its plugins are the same.

These are small experiments, for two cores: networks of 64-64, few steps, often TD3 in place of DDPG. What was changed stands with each experiment and in its file. So they show
whether an effect is there, not how large it is at the paper's size; the paper's settings are in the files without `-small`, and were not run. Figures are medians over the
seeds, with the quartiles in brackets, always at equal numbers of steps. Returns are of greedy evaluations, with the shield first; in a table that has no column
\"without the shield\" they are all without it. With fewer than three seeds there is no verdict. A claim *holds in part* where one half of it does, or where an effect is at least half as large as the paper's. No seed is left out; the paper takes the median over
those that solved the task.

| § | environment | the paper | here | seeds, steps | verdict |
|---|---|---|---|---|---|
";

const COLUMNS: [Column; 10] = [
    ("forward steps", |run| Some(run.forward_steps as f64), 0),
    ("early aborts", |run| Some(run.early_aborts as f64), 0),
    ("hard resets", |run| Some(run.hard_resets as f64), 0),
    ("irreversible entries", |run| Some(run.irreversible_entries as f64), 0),
    ("final return", |run| run.final_return, 1),
    ("without the shield", |run| run.final_return_without_shield, 1),
    ("best return", |run| run.best_return, 1),
    ("success, %", |run| run.success_rate.map(|rate| rate * 100.0), 0),
    ("steps to solve", Summary::steps_until_solved, 0),
    ("lifetime return", |run| run.lifetime_return, 0),
];

/// The page, from the records that there are.
///
/// # Errors
/// An experiment's file cannot be read.
pub fn page(root: &Path, records: &[Recorded]) -> Result<String> {
    let mut page = HEAD.to_owned();
    for claim in CLAIMS {
        let record = records.iter().find(|(experiment, _)| experiment.name == claim.experiment);
        writeln!(page, "{}", row(claim, record.and_then(|(_, record)| record.as_ref())))?;
    }
    for (experiment, record) in records {
        let Some(record) = record else { continue };
        writeln!(page, "\n## {}\n\n{}", experiment.title, introduction(root, experiment)?)?;
        writeln!(page, "\n`cargo xtask reproduce {}`\n", experiment.name)?;
        page += &table(record, &COLUMNS, |variant, figure| variant.spread(figure));
        page.push('\n');
        for figure in experiment.figures {
            let plot = format!("plots/{}-{figure}.png", experiment.name);
            if root.join(experiment.folder).join(&plot).exists() {
                writeln!(page, "<img src=\"{plot}\" width=\"440\" alt=\"{}: {figure}\">", experiment.name)?;
            }
        }
    }
    Ok(page)
}

fn row(claim: &Claim, record: Option<&Record>) -> String {
    let Claim { section, environment, claim: text, experiment, .. } = claim;
    let found = record.and_then(|record| Some((record, claim.judge(record)?)));
    let Some((record, finding)) = found else {
        return format!("| {section} | {environment} | {text} | not measured | | (`{experiment}`) |");
    };
    let verdict = match finding.verdict {
        Verdict::Holds => "**holds**",
        Verdict::InPart => "holds in part",
        Verdict::Fails => "does not hold",
        Verdict::Untested => "not tested: nothing was aborted",
    };
    let sizes: Vec<(usize, u64)> = claim
        .variants
        .iter()
        .filter_map(|name| record.variant(name))
        .map(|variant| (variant.runs.len(), variant.runs[0].summary.steps))
        .collect();
    let seeds = sizes.iter().map(|size| size.0).min().unwrap_or(0);
    let steps = thousands(sizes.first().map_or(0, |size| size.1));
    format!(
        "| {section} | {environment} | {text} | {} | {seeds}, {steps} | {verdict} ([`{experiment}`]({experiment}.ron)) |",
        finding.ours
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_claim_without_a_record_is_not_measured() {
        assert!(row(&CLAIMS[0], None).contains("not measured"));
        assert!(row(&CLAIMS[0], Some(&Record { variants: Vec::new() })).contains("not measured"));
    }
}
