//! What makes a verdict out of figures.

use crate::reproduce::record::{Aborts, Spread, Summary, Variant};

/// What the figures say of a claim.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    Holds,
    InPart,
    Fails,
    /// What it is about did not happen.
    Untested,
}

impl Verdict {
    /// Both of two.
    pub(super) fn and(self, other: Self) -> Self {
        match (self, other) {
            (Self::Untested, _) | (_, Self::Untested) => Self::Untested,
            (Self::Holds, Self::Holds) => Self::Holds,
            (Self::Fails, Self::Fails) => Self::Fails,
            _ => Self::InPart,
        }
    }

    /// Of a yes or no.
    pub(super) fn if_so(holds: bool) -> Self {
        if holds { Self::Holds } else { Self::Fails }
    }
}

/// What was found.
#[derive(Debug)]
pub struct Finding {
    pub ours: String,
    pub verdict: Verdict,
}

pub(super) fn resets(summary: &Summary) -> Option<f64> {
    Some(summary.hard_resets as f64)
}

fn aborts(summary: &Summary) -> Option<f64> {
    Some(summary.early_aborts as f64)
}

pub(super) fn solve(summary: &Summary) -> Option<f64> {
    summary.steps_until_solved()
}

pub(super) fn gain(summary: &Summary) -> Option<f64> {
    summary.final_return
}

/// Medians of a figure, in the order of the variants.
pub(super) fn medians(variants: &[&Variant], figure: fn(&Summary) -> Option<f64>) -> Option<Vec<f64>> {
    variants.iter().map(|variant| Some(variant.spread(figure)?.median())).collect()
}

/// Between figures that follow one another, and between those that stand side by side.
pub(super) const THEN: &str = " → ";
pub(super) const BESIDE: &str = " / ";

/// Medians with quartiles.
pub(super) fn shown(
    variants: &[&Variant],
    figure: fn(&Summary) -> Option<f64>,
    decimals: usize,
    between: &str,
) -> Option<String> {
    let all: Option<Vec<String>> =
        variants.iter().map(|variant| Some(variant.spread(figure)?.show(decimals))).collect();
    Some(all?.join(between))
}

/// By how many percent the second is less than the first.
pub(super) fn percent_fewer(first: f64, second: f64) -> f64 {
    if first > 0.0 { (1.0 - second / first) * 100.0 } else { 0.0 }
}

/// Fewer hard resets by at least so many percent holds; by at least half of that, in part.
pub(super) fn fewer(variants: &[&Variant], wanted: f64) -> Option<(f64, Verdict)> {
    let resets = medians(variants, resets)?;
    let percent = percent_fewer(resets[0], *resets.last()?);
    Some((percent, graded(percent, wanted)))
}

/// The same, with the figures.
pub(super) fn fewer_resets(variants: &[&Variant], wanted: f64) -> Option<Finding> {
    let (percent, verdict) = fewer(variants, wanted)?;
    let ours = format!("hard resets {}: {percent:.0}% fewer", shown(variants, resets, 0, THEN)?);
    Some(Finding { ours, verdict })
}

pub(super) fn graded(figure: f64, wanted: f64) -> Verdict {
    match figure {
        figure if figure >= wanted => Verdict::Holds,
        figure if figure >= wanted / 2.0 => Verdict::InPart,
        _ => Verdict::Fails,
    }
}

/// A shield that hardly lets anything happen has few hard resets for a trivial reason.
pub(super) fn busy_note(variants: &[&Variant]) -> Option<&'static str> {
    let shares = medians(variants, Summary::forward_percent)?;
    Some(if shares.iter().any(|share| *share < 50.0) {
        "; less than half of the steps are spent forward"
    } else {
        ""
    })
}

/// Hard resets fall by so many percent while a return keeps so many percent of what it was.
pub(super) fn fewer_at_return(variants: &[&Variant], wanted: f64, kept: f64) -> Option<Finding> {
    let (percent, verdict) = fewer(variants, wanted)?;
    let returns = medians(variants, gain)?;
    let (before, after) = (returns[0], *returns.last()?);
    let ours = format!(
        "hard resets {} ({percent:.0}% fewer); return {}{}",
        shown(variants, resets, 0, THEN)?,
        shown(variants, gain, 1, THEN)?,
        busy_note(variants)?
    );
    Some(Finding { ours, verdict: verdict.and(Verdict::if_so(after >= before * kept / 100.0)) })
}

/// Hard resets fall from variant to variant.
pub(super) fn monotone(variants: &[&Variant]) -> Option<Finding> {
    let found = medians(variants, resets)?;
    let falls = found.windows(2).all(|pair| pair[1] <= pair[0]);
    let is_lower_at_last = found.last() < found.first();
    let verdict = match (falls && is_lower_at_last, is_lower_at_last) {
        (true, _) => Verdict::Holds,
        (_, true) => Verdict::InPart,
        _ => Verdict::Fails,
    };
    Some(Finding { ours: format!("hard resets {}", shown(variants, resets, 0, THEN)?), verdict })
}

/// Neither hard resets nor returns differ by more than a quarter between the ways of combining.
pub(super) fn alike(variants: &[&Variant]) -> Option<Finding> {
    let range = |figures: Vec<f64>| {
        let (low, high) = figures
            .iter()
            .fold((f64::INFINITY, 0.0_f64), |(low, high), figure| (low.min(*figure), high.max(*figure)));
        if high > 0.0 { (high - low) / high } else { 0.0 }
    };
    let [resets_apart, returns_apart] = [range(medians(variants, resets)?), range(medians(variants, gain)?)];
    let ours = format!(
        "hard resets {}; return {}",
        shown(variants, resets, 0, BESIDE)?,
        shown(variants, gain, 1, BESIDE)?
    );
    let verdict = Verdict::if_so(resets_apart <= 0.25).and(Verdict::if_so(returns_apart <= 0.25));
    // However they are combined: values that are never too low are alike.
    let has_aborts = medians(variants, aborts)?.iter().any(|count| *count > 0.0);
    Some(Finding { ours, verdict: if has_aborts { verdict } else { Verdict::Untested } })
}

/// Of the aborts of each seed, the share in some cells; the median over the seeds.
pub(super) fn share_in(variant: &Variant, cells: &[usize]) -> Option<f64> {
    let share = |aborts: &Aborts| match aborts {
        Aborts::Discrete { cells: counts } => {
            let there: u64 = cells.iter().filter_map(|cell| counts.get(*cell)).sum();
            Some(there as f64 / counts.iter().sum::<u64>().max(1) as f64 * 100.0)
        }
        Aborts::Continuous(_) => None,
    };
    let shares = variant.runs.iter().filter_map(|run| run.aborts.as_ref().and_then(share)).collect();
    Some(Spread::of(shares)?.median())
}

pub(super) fn aborts_in(variants: &[&Variant], cells: &[usize], where_: &str) -> Option<Finding> {
    let share = share_in(variants[0], cells)?;
    let ours = format!("{share:.0}% of a seed's aborts (median) in the {} cells {where_}", cells.len());
    Some(Finding { ours, verdict: graded(share, 50.0) })
}
