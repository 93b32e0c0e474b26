//! RESULTS.md of the shield as it is: every environment with the shield and without it, and which targets are met.

use std::fmt::Write;
use std::fs;
use std::path::Path;

use anyhow::{Context, Result};

use super::Recorded;
use super::experiments::{CART, Experiment, STUDIES};
use super::record::{Record, Spread, Summary, Variant};
use super::tables::{Column, Figure, GAP, introduction, show, table, thousands};

const HEAD: &str = "# Results

Written by `cargo xtask reproduce untouched`: from the records in this folder, not by hand. It runs what is neither recorded nor finished;
`cargo xtask reproduce untouched --no-run` only writes this page anew.

Each figure is the median over the seeds, with the smallest and the largest in brackets: with the shield, then under the status quo, where a hard reset follows each episode. Both make the same number of
steps. A ratio or a share compares the two medians. Returns are of greedy evaluations at the end, with the shield where there is one. Forward steps are those spent on the task. The realised risk is the
share of attempts that failed, over the whole run; the accepted risk is the share that may. ECE is the expected calibration error of the success critic over the last half of a run's attempts.

The last columns say whether the medians meet the target: irreversible entries at most 1/20 of the status quo's, return at least 95% of it, at least 60% forward steps, an ECE of at most 0.1, a realised risk at
most 0.03 above the accepted one. The cart has targets of its own: entries (falls) at most 1/7, hard resets at most 1/40, return at least 97%. A dash means that it was not measured, an empty cell that there is no target.

";

/// What the shield is to reach, against the status quo.
struct Targets {
    /// At most this part of its irreversible entries.
    entries: f64,
    /// At most this part of its hard resets, if there is a target.
    hard_resets: Option<f64>,
    /// At least this share of its return.
    gain: f64,
}

const CART_TARGETS: Targets = Targets { entries: 1.0 / 7.0, hard_resets: Some(1.0 / 40.0), gain: 0.97 };
const TARGETS: Targets = Targets { entries: 1.0 / 20.0, hard_resets: None, gain: 0.95 };
const FORWARD_PERCENT: f64 = 60.0;
const CALIBRATION_ERROR: f64 = 0.1;
const RISK_MARGIN: f64 = 0.03;

/// The shield beside the status quo.
struct Comparison<'a> {
    experiment: &'a Experiment,
    /// How many seeds its file names.
    seeds: usize,
    targets: Targets,
    shielded: Option<&'a Variant>,
    status_quo: Option<&'a Variant>,
}

/// A heading, and what stands below it.
type Cell = (&'static str, fn(&Comparison<'_>) -> String);

const CELLS: [Cell; 17] = [
    ("environment, steps", |row| row.name()),
    ("seeds", |row| row.seeds()),
    ("irreversible entries", |row| row.both(entries, 0)),
    ("ratio", |row| ratio(row.medians(entries))),
    ("hard resets", |row| row.both(hard_resets, 0)),
    ("ratio", |row| ratio(row.medians(hard_resets))),
    ("return", |row| row.both(gain, 1)),
    ("share", |row| share(row.medians(gain))),
    ("forward steps, %", |row| row.ours(Summary::forward_percent, 0)),
    ("realised risk, accepted", |row| {
        format!("{}, {}", row.ours(realised_risk, 3), row.ours(accepted_risk, 3))
    }),
    ("ECE", |row| row.ours(calibration_error, 3)),
    ("target: entries", |row| verdict(is_part(row.medians(entries), row.targets.entries))),
    ("target: hard resets", |row| {
        let of = |part| verdict(is_part(row.medians(hard_resets), part));
        row.targets.hard_resets.map(of).unwrap_or_default()
    }),
    ("target: return", |row| verdict(is_share(row.medians(gain), row.targets.gain))),
    ("target: forward", |row| {
        verdict(row.median(Summary::forward_percent).map(|percent| percent >= FORWARD_PERCENT))
    }),
    ("target: risk", |row| verdict(row.shielded.and_then(is_within_risk))),
    ("target: ECE", |row| verdict(row.median(calibration_error).map(|error| error <= CALIBRATION_ERROR))),
];

/// What the tables of the studies show.
const STUDY_COLUMNS: [Column; 8] = [
    ("irreversible entries", entries, 0),
    ("hard resets", hard_resets, 0),
    ("return", gain, 1),
    ("without the shield", |run| run.final_return_without_shield, 1),
    ("forward steps, %", Summary::forward_percent, 0),
    ("accepted risk", accepted_risk, 2),
    ("realised risk", realised_risk, 3),
    ("ECE", calibration_error, 3),
];

fn entries(run: &Summary) -> Option<f64> {
    Some(run.irreversible_entries as f64)
}

fn hard_resets(run: &Summary) -> Option<f64> {
    Some(run.hard_resets as f64)
}

fn gain(run: &Summary) -> Option<f64> {
    run.final_return
}

fn realised_risk(run: &Summary) -> Option<f64> {
    run.realised_risk
}

fn accepted_risk(run: &Summary) -> Option<f64> {
    run.accepted_risk
}

fn calibration_error(run: &Summary) -> Option<f64> {
    run.calibration_error_last_half
}

/// The page, from the records that there are.
///
/// # Errors
/// An experiment's file cannot be read, or names no seeds.
pub fn page(root: &Path, records: &[Recorded]) -> Result<String> {
    let mut page = HEAD.to_owned();
    page += &line(CELLS.iter().map(|(heading, _)| (*heading).into()));
    page += &line(CELLS.iter().map(|_| "---".into()));
    let is_study = |experiment: &Experiment| STUDIES.contains(&experiment.name);
    for (experiment, record) in records.iter().filter(|(experiment, _)| !is_study(experiment)) {
        let row = Comparison::new(experiment, seeds_named(root, experiment)?, record.as_ref());
        page += &line(CELLS.iter().map(|(_, cell)| cell(&row)));
    }
    for (experiment, record) in records.iter().filter(|(experiment, _)| is_study(experiment)) {
        let Some(record) = record else { continue };
        writeln!(page, "\n## {}\n\n{}\n", experiment.title, introduction(root, experiment)?)?;
        page += &table(record, &STUDY_COLUMNS, |variant, figure| variant.range(figure));
        let verdicts: Vec<bool> = record.variants.iter().filter_map(is_within_risk).collect();
        let within = verdicts.iter().filter(|is_within| **is_within).count();
        writeln!(
            page,
            "\nThe realised risk is at most {RISK_MARGIN} above the accepted one in {within} of {} variants.",
            verdicts.len()
        )?;
    }
    Ok(page)
}

/// Whether the median realised risk is within reach of the accepted one; `None` where there is none.
fn is_within_risk(variant: &Variant) -> Option<bool> {
    Some(variant.median(realised_risk)? <= variant.median(accepted_risk)? + RISK_MARGIN)
}

fn line(cells: impl Iterator<Item = String>) -> String {
    format!("| {} |\n", cells.collect::<Vec<_>>().join(" | "))
}

/// How many seeds an experiment's file names.
fn seeds_named(root: &Path, experiment: &Experiment) -> Result<usize> {
    let path = root.join(experiment.file());
    let text = fs::read_to_string(&path).with_context(|| format!("{} cannot be read", path.display()))?;
    let list = text.lines().find_map(|line| line.trim().strip_prefix("seeds: [")?.strip_suffix("],"));
    let list = list.with_context(|| format!("{} has no line of seeds", path.display()))?;
    Ok(list.split(',').count())
}

impl<'a> Comparison<'a> {
    fn new(experiment: &'a Experiment, seeds: usize, record: Option<&'a Record>) -> Self {
        let variant = |name| record.and_then(|record| record.variant(name));
        let targets = if experiment.name == CART { CART_TARGETS } else { TARGETS };
        let (shielded, status_quo) = (variant("shielded"), variant("status-quo"));
        Self { experiment, seeds, targets, shielded, status_quo }
    }

    fn name(&self) -> String {
        let Experiment { title, .. } = self.experiment;
        let some = self.shielded.or(self.status_quo);
        some.map_or_else(
            || (*title).to_owned(),
            |variant| format!("{title}, {}", thousands(variant.runs[0].summary.steps)),
        )
    }

    /// Of the shield, and of the status quo where it has another number; out of how many where some are missing.
    fn seeds(&self) -> String {
        let count = |variant: Option<&Variant>| variant.map_or(0, |variant| variant.runs.len());
        let [ours, theirs] = [count(self.shielded), count(self.status_quo)];
        let of = |count: usize| {
            if count < self.seeds { format!("{count} of {}", self.seeds) } else { count.to_string() }
        };
        if ours == theirs { of(ours) } else { format!("{}; status quo {}", of(ours), of(theirs)) }
    }

    fn spreads(&self, figure: Figure) -> [Option<Spread>; 2] {
        [self.shielded, self.status_quo].map(|variant| variant?.range(figure))
    }

    fn both(&self, figure: Figure, decimals: usize) -> String {
        self.spreads(figure).map(|spread| show(spread, decimals)).join(" / ")
    }

    fn ours(&self, figure: Figure, decimals: usize) -> String {
        show(self.spreads(figure)[0], decimals)
    }

    fn median(&self, figure: Figure) -> Option<f64> {
        self.shielded?.median(figure)
    }

    /// With the shield and without it, where both were measured.
    fn medians(&self, figure: Figure) -> Option<[f64; 2]> {
        Some([self.median(figure)?, self.status_quo?.median(figure)?])
    }
}

fn verdict(is_met: Option<bool>) -> String {
    match is_met {
        Some(true) => "met".into(),
        Some(false) => "**missed**".into(),
        None => GAP.into(),
    }
}

/// Whether ours is at most a part of theirs. Where theirs is none, nothing can be shown but a failure.
fn is_part(medians: Option<[f64; 2]>, part: f64) -> Option<bool> {
    let [ours, theirs] = medians?;
    (ours + theirs > 0.0).then_some(ours <= theirs * part)
}

/// Whether ours is at least a share of theirs. Below a return of 0 the same part of its size may be lost.
fn is_share(medians: Option<[f64; 2]>, share: f64) -> Option<bool> {
    let [ours, theirs] = medians?;
    Some(ours >= theirs - (1.0 - share) * theirs.abs())
}

/// As a part of theirs, never shown as smaller than it is.
fn ratio(medians: Option<[f64; 2]>) -> String {
    match medians {
        Some([ours, theirs]) if theirs > 0.0 && ours == 0.0 => "0".into(),
        Some([ours, theirs]) if theirs > ours => format!("1/{:.1}", floor_tenth(theirs / ours)),
        Some([ours, theirs]) if theirs > 0.0 => format!("{:.1}", ours / theirs),
        _ => GAP.into(),
    }
}

/// In percent of theirs, never shown as larger than it is. A negative return has no shares.
fn share(medians: Option<[f64; 2]>) -> String {
    match medians {
        Some([ours, theirs]) if theirs > 0.0 => format!("{:.1}%", floor_tenth(ours / theirs * 100.0)),
        _ => GAP.into(),
    }
}

fn floor_tenth(figure: f64) -> f64 {
    (figure * 10.0).floor() / 10.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cargo::workspace_root;
    use crate::reproduce::experiments::UNTOUCHED;

    /// Three runs around these figures: entries, hard resets, return.
    fn variant(name: &str, [entries, hard_resets, gain]: [f64; 3], risk: Option<f64>) -> Variant {
        let run = |change: f64| {
            serde_json::json!({"summary": {
                "steps": 60_000, "forward_steps": 42_000, "early_aborts": 9, "hard_resets": (hard_resets + change) as u64,
                "irreversible_entries": (entries + change) as u64, "final_return": gain + change, "best_return": null,
                "lifetime_return": null, "success_rate": null, "steps_to_solve": null, "realised_risk": risk, "accepted_risk": 0.1,
                "calibration_error_last_half": risk}, "aborts": null})
        };
        let runs = [run(-1.0), run(0.0), run(1.0)];
        serde_json::from_value(serde_json::json!({"name": name, "runs": runs})).unwrap()
    }

    fn cells(name: &str, variants: Vec<Variant>) -> Vec<String> {
        let experiment = UNTOUCHED.iter().find(|experiment| experiment.name == name).unwrap();
        let record = Record { variants };
        let row = Comparison::new(experiment, 5, Some(&record));
        CELLS.iter().map(|(_, cell)| cell(&row)).collect()
    }

    #[test]
    fn an_environment_is_a_row_with_figures_and_verdicts() {
        let shielded = || variant("shielded", [4.0, 15.0, 84.0], Some(0.12));
        let status_quo = || variant("status-quo", [35.0, 610.0, 85.0], None);
        let row = cells("quickstart", vec![shielded(), status_quo()]);
        let figures = [
            "cart, 60,000",
            "3 of 5",
            "4 (3 to 5) / 35 (34 to 36)",
            "1/8.7",
            "15 (14 to 16) / 610 (609 to 611)",
            "1/40.6",
            "84.0 (83.0 to 85.0) / 85.0 (84.0 to 86.0)",
            "98.8%",
            "70",
            "0.120, 0.100",
            "0.120",
        ];
        assert_eq!(row[..11], figures);
        assert_eq!(row[11..], ["met", "met", "met", "met", "met", "**missed**"]);
        // The others may have fewer entries, and have no target for hard resets.
        let row = cells("walker", vec![shielded(), status_quo()]);
        assert_eq!(row[11..], ["**missed**", "", "met", "met", "met", "**missed**"]);
    }

    #[test]
    fn nothing_stands_in_for_runs_that_are_missing() {
        let row = cells("walker", vec![variant("shielded", [4.0, 15.0, 84.0], None)]);
        assert_eq!(row[1], "3 of 5; status quo 0 of 5");
        assert_eq!(row[2..6], ["4 (3 to 5) / –", "–", "15 (14 to 16) / –", "–"]);
        assert_eq!(row[9..], ["–, 0.100", "–", "–", "", "–", "met", "–", "–"]);
        let row = cells("walker", Vec::new());
        assert_eq!((row[0].as_str(), row[1].as_str(), row[2].as_str()), ("walker", "0 of 5", "– / –"));
        assert_eq!(row[11..], ["–", "", "–", "–", "–", "–"]);
    }

    #[test]
    fn a_ratio_is_not_rounded_in_our_favour() {
        let shown = |ours, theirs| ratio(Some([ours, theirs]));
        assert_eq!([shown(100.0, 1_999.0), shown(0.0, 7.0), shown(9.0, 6.0)], ["1/19.9", "0", "1.5"]);
        assert_eq!([shown(0.0, 0.0), shown(3.0, 0.0)], ["–", "–"]);
        assert_eq!([share(Some([94.99, 100.0])), share(Some([-3.0, -2.0]))], ["94.9%", "–"]);
    }

    #[test]
    fn targets_hold_at_their_borders_and_not_beyond() {
        let part = |ours, theirs| is_part(Some([ours, theirs]), TARGETS.entries);
        assert_eq!(
            [part(5.0, 100.0), part(6.0, 100.0), part(3.0, 0.0)],
            [Some(true), Some(false), Some(false)]
        );
        assert_eq!([part(0.0, 0.0), is_part(None, 1.0)], [None, None], "nothing was there to prevent");
        let gain = |ours, theirs| is_share(Some([ours, theirs]), TARGETS.gain).unwrap();
        assert!(gain(95.1, 100.0) && !gain(94.9, 100.0));
        assert!(gain(-104.9, -100.0) && !gain(-105.1, -100.0));
        assert!(!gain(f64::NAN, 1.0));
    }

    #[test]
    fn the_page_has_every_environment_and_the_studies() {
        let record = || Some(Record { variants: vec![variant("no-strata", [4.0, 15.0, 84.0], Some(0.14))] });
        let records: Vec<Recorded> = UNTOUCHED.iter().map(|experiment| (experiment, record())).collect();
        let page = page(workspace_root(), &records).unwrap();
        assert_eq!(page.matches("| 0 of 5 |").count(), UNTOUCHED.len() - STUDIES.len());
        assert_eq!(
            page.matches("\n| no-strata | 3 | 4 (3 to 5) | 15 (14 to 16) |").count(),
            STUDIES.len(),
            "{page}"
        );
        // 0.14 realised, 0.1 accepted.
        assert!(page.contains("above the accepted one in 0 of 1 variants."), "{page}");
    }
}
