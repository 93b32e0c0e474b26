//! What is drawn of a record: the figures' data, without a pixel.

use super::{
    attempts::Diagram,
    course::Course,
    places::Places,
    record::{Record, RunRecord, VariantRecord},
    statistics::Spread,
};
use shield_lab::run::Summary;

/// A figure, with the name of its file.
#[derive(Debug, Clone, PartialEq)]
pub enum Figure {
    /// Something against the steps of a run, a line for each variant.
    Lines(Lines),
    /// Something at the end of a run, a row for each variant.
    Dots(Dots),
    /// How often something happened, over a plane.
    HeatMap(HeatMap),
    /// Predicted against realised success of attempts.
    Reliability(Box<Diagram>),
}

/// Lines with the middle half of the seeds around each.
#[derive(Debug, Clone, PartialEq)]
pub struct Lines {
    /// Name of the file.
    pub name: String,
    /// What it shows.
    pub title: String,
    /// The vertical axis, with its unit.
    pub axis: String,
    /// A line per variant.
    pub bands: Vec<Band>,
}

/// One line.
#[derive(Debug, Clone, PartialEq)]
pub struct Band {
    /// The variant.
    pub name: String,
    /// Environment steps, and what the seeds had then.
    pub points: Vec<(f64, Spread)>,
}

/// Medians and the middle half of the seeds, a row per variant.
#[derive(Debug, Clone, PartialEq)]
pub struct Dots {
    /// Name of the file.
    pub name: String,
    /// What it shows.
    pub title: String,
    /// The horizontal axis, with its unit.
    pub axis: String,
    /// A row per variant.
    pub rows: Vec<Row>,
}

/// One row.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// The variant.
    pub name: String,
    /// Over the seeds.
    pub spread: Spread,
    /// Each seed's figure; infinite where something never happened.
    pub seeds: Vec<f64>,
}

/// Counts over a plane.
#[derive(Debug, Clone, PartialEq)]
pub struct HeatMap {
    /// Name of the file.
    pub name: String,
    /// What it shows.
    pub title: String,
    /// The two axes.
    pub axes: [String; 2],
    /// Least and largest value of each axis.
    pub ranges: [[f64; 2]; 2],
    /// How many fields there are in each direction.
    pub fields: usize,
    /// Counts, row by row from below.
    pub counts: Vec<f64>,
}

impl Figure {
    /// Name of the file, without its extension.
    pub fn name(&self) -> &str {
        match self {
            Self::Lines(Lines { name, .. }) | Self::Dots(Dots { name, .. }) => name,
            Self::HeatMap(HeatMap { name, .. }) => name,
            Self::Reliability(diagram) => &diagram.name,
        }
    }

    /// What it shows.
    pub fn title(&self) -> &str {
        match self {
            Self::Lines(Lines { title, .. }) | Self::Dots(Dots { title, .. }) => title,
            Self::HeatMap(HeatMap { title, .. }) => title,
            Self::Reliability(diagram) => &diagram.title,
        }
    }
}

/// Every name that a figure can have, besides `where-` or `reliability-` and a variant. A figure with nothing to show is left out.
pub const FIGURE_NAMES: [&str; 14] = [
    "return",
    "return-without-shield",
    "success",
    "success-without-shield",
    "training-return",
    "lifetime-reward",
    "hard-resets",
    "irreversible-entries",
    "aborts",
    "final-hard-resets",
    "final-irreversible-entries",
    "final-return",
    "final-return-without-shield",
    "steps-to-solve",
];

/// Fields of a heat map in each direction.
const FIELDS: usize = 24;

/// Every figure of a record that has something to show. Cells of discrete spaces are not among them: only an environment knows where they lie.
pub fn figures(record: &Record) -> Vec<Figure> {
    let variants = &record.variants;
    let mut figures = Vec::new();
    let mut lines = |name: &str, title: &str, axis: &str, bands: Vec<Band>| {
        if bands.iter().any(Band::is_worth_drawing) {
            let (name, title, axis) = (name.into(), title.into(), axis.into());
            figures.push(Figure::Lines(Lines { name, title, axis, bands }));
        }
    };
    let evaluated =
        |figure: Evaluated| variants.iter().map(|variant| evaluations(variant, figure)).collect::<Vec<_>>();
    let is_paired = variants.iter().any(VariantRecord::is_paired);
    // Where no variant was evaluated both ways, these would be the same lines again.
    let bare = |figure: Evaluated, without_shield: Evaluated| {
        let shown = variants.iter().filter(|_| is_paired);
        shown.map(|variant| bare_evaluations(variant, figure, without_shield)).collect::<Vec<_>>()
    };
    let with_shield = if is_paired { ", with the shield" } else { "" };
    let counted = |figure: fn(&Course, usize) -> f64| {
        variants.iter().map(|variant| course(variant, figure)).collect::<Vec<_>>()
    };
    let gain: Evaluated = |run, at| run.evaluations.mean_return[at];
    let success: Evaluated = |run, at| run.evaluations.success_rate[at] * 100.0;
    lines(
        "return",
        &format!("Task, from the start{with_shield} (greedy evaluation)"),
        "mean return of an episode",
        evaluated(gain),
    );
    lines(
        "return-without-shield",
        "Task, from the start, without the shield (greedy evaluation)",
        "mean return of an episode",
        bare(gain, |run, at| known(&run.evaluations.mean_return_without_shield, at)),
    );
    lines(
        "success",
        &format!("Success, from the start{with_shield} (greedy evaluation)"),
        "successful episodes, %",
        evaluated(success),
    );
    lines(
        "success-without-shield",
        "Success, from the start, without the shield (greedy evaluation)",
        "successful episodes, %",
        bare(success, |run, at| known(&run.evaluations.success_rate_without_shield, at) * 100.0),
    );
    lines(
        "training-return",
        "Task, while learning",
        "mean return of a forward episode",
        counted(|course, at| course.forward_return[at].unwrap_or(f64::NAN)),
    );
    lines(
        "lifetime-reward",
        "Task reward over the whole lifetime, both phases",
        "mean reward of a step so far",
        counted(|course, at| course.lifetime_return[at] / course.step[at].max(1) as f64),
    );
    lines(
        "hard-resets",
        "Hard resets",
        "hard resets so far",
        counted(|course, at| course.hard_resets[at] as f64),
    );
    lines(
        "irreversible-entries",
        "Entries into irreversible states",
        "entries so far",
        counted(|course, at| course.irreversible_entries[at] as f64),
    );
    lines("aborts", "Early aborts", "early aborts of 1,000 steps", counted(abort_rate));
    figures.extend(final_figures(variants));
    figures.extend(
        variants.iter().filter_map(Diagram::of).map(|diagram| Figure::Reliability(Box::new(diagram))),
    );
    figures.extend(variants.iter().filter_map(heat_map));
    figures
}

/// Early aborts of a thousand steps within one part of a run.
fn abort_rate(course: &Course, at: usize) -> f64 {
    let before = |column: &[u64]| at.checked_sub(1).map_or(0, |before| column[before]);
    let aborts = course.early_aborts[at] - before(&course.early_aborts);
    let steps = course.step[at] - before(&course.step);
    aborts as f64 * 1_000.0 / steps.max(1) as f64
}

impl Band {
    /// A figure in which every line lies on zero shows nothing.
    fn is_worth_drawing(&self) -> bool {
        self.points.iter().any(|(_, spread)| spread.upper != 0.0 || spread.lower != 0.0)
    }
}

fn band(name: &str, points: impl Iterator<Item = (u64, Option<Spread>)>) -> Band {
    let known = points.filter_map(|(step, spread)| Some((step as f64, spread?)));
    Band { name: name.to_owned(), points: known.collect() }
}

/// The figure of one of a run's evaluations.
type Evaluated = fn(&RunRecord, usize) -> f64;

impl VariantRecord {
    /// Whether its evaluations were made with the shield and without.
    fn is_paired(&self) -> bool {
        self.runs.iter().any(|run| !run.evaluations.mean_return_without_shield.is_empty())
    }

    /// Whether its only evaluations were made without a shield. Version 1.0 made them with a shield or without.
    fn is_bare(&self) -> bool {
        !self.is_paired()
            && !self.experiment().is_some_and(|experiment| experiment.is_evaluated_with_shield())
    }
}

/// A figure that some runs of a variant may be without.
fn known(column: &[f64], at: usize) -> f64 {
    column.get(at).copied().unwrap_or(f64::NAN)
}

/// Evaluations without the shield. Of a variant without a shield they are the only ones, and shown beside the others' for comparison.
fn bare_evaluations(variant: &VariantRecord, figure: Evaluated, without_shield: Evaluated) -> Band {
    evaluations(variant, if variant.is_bare() { figure } else { without_shield })
}

fn evaluations(variant: &VariantRecord, figure: Evaluated) -> Band {
    let longest = variant.runs.iter().max_by_key(|run| run.evaluations.step.len());
    let steps = longest.into_iter().flat_map(|run| run.evaluations.step.iter().copied());
    let spread = |at: usize| {
        let there = variant.runs.iter().filter(|run| run.evaluations.step.len() > at);
        Spread::of(there.map(|run| figure(run, at)))
    };
    band(&variant.name, steps.enumerate().map(|(at, step)| (step, spread(at))))
}

fn course(variant: &VariantRecord, figure: fn(&Course, usize) -> f64) -> Band {
    let steps = variant.runs.first().map_or(&[][..], |run| &run.course.step);
    let spread = |at: usize| {
        let there = variant.runs.iter().filter(|run| run.course.step.len() > at);
        Spread::of(there.map(|run| figure(&run.course, at)))
    };
    band(&variant.name, steps.iter().enumerate().map(|(at, step)| (*step, spread(at))))
}

fn final_figures(variants: &[VariantRecord]) -> Vec<Figure> {
    type Final = fn(&VariantRecord, &Summary) -> Option<f64>;
    let is_paired = variants.iter().any(VariantRecord::is_paired);
    let last = if is_paired {
        "Return of the last evaluation, with the shield"
    } else {
        "Return of the last evaluation"
    };
    let bare = "Return of the last evaluation, without the shield";
    let kinds: [(&str, &str, &str, Final); 5] = [
        ("final-hard-resets", "Hard resets of a whole run", "hard resets", |_, run| {
            Some(run.hard_resets as f64)
        }),
        (
            "final-irreversible-entries",
            "Entries into irreversible states of a whole run",
            "entries",
            |_, run| Some(run.irreversible_entries as f64),
        ),
        ("final-return", last, "mean return of an episode", |_, run| run.final_return),
        ("final-return-without-shield", bare, "mean return of an episode", |variant, run| {
            if variant.is_bare() { run.final_return } else { run.final_return_without_shield }
        }),
        ("steps-to-solve", "Steps until the task was solved", "environment steps", |_, run| {
            run.steps_until_solved()
        }),
    ];
    let row = |variant: &VariantRecord, figure: Final| {
        let seeds: Vec<f64> = variant.runs.iter().filter_map(|run| figure(variant, &run.summary)).collect();
        let spread = Spread::of(seeds.iter().copied())?;
        Some(Row { name: variant.name.clone(), spread, seeds })
    };
    let is_worth_drawing = |seed: &f64| *seed != 0.0 && seed.is_finite();
    let mut figures = Vec::new();
    for (name, title, axis, figure) in kinds {
        if name == "final-return-without-shield" && !is_paired {
            continue;
        }
        let rows: Vec<Row> = variants.iter().filter_map(|variant| row(variant, figure)).collect();
        if rows.iter().any(|row| row.seeds.iter().any(is_worth_drawing)) {
            let (name, title, axis) = (name.into(), title.into(), axis.into());
            figures.push(Figure::Dots(Dots { name, title, axis, rows }));
        }
    }
    figures
}

/// Where a variant's forward episodes were aborted, of all seeds together.
fn heat_map(variant: &VariantRecord) -> Option<Figure> {
    let mut points: Vec<[f64; 2]> = Vec::new();
    let (mut dimensions, mut total) = ([0, 1], 0);
    for run in &variant.runs {
        let Some(Places::Points { dimensions: chosen, of, points: more }) = &run.aborts else { continue };
        (dimensions, total) = (*chosen, of.saturating_add(total));
        points.extend(more.iter().filter(|point| point.iter().all(|place| place.is_finite())));
    }
    if points.is_empty() {
        return None;
    }
    let ranges = [0, 1].map(|axis| range(points.iter().map(|point| point[axis])));
    let mut counts = vec![0.0; FIELDS * FIELDS];
    // Of many aborts only some places are kept: each stands for as many.
    let weight = total as f64 / points.len() as f64;
    for point in &points {
        let [x, y] = [0, 1].map(|axis| {
            let [low, high] = ranges[axis];
            (((point[axis] - low) / (high - low) * FIELDS as f64) as usize).min(FIELDS - 1)
        });
        counts[y * FIELDS + x] += weight;
    }
    Some(Figure::HeatMap(HeatMap {
        name: format!("where-{}", variant.name),
        title: format!("{}: where {total} forward episodes were aborted", variant.name),
        axes: dimensions.map(|dimension| format!("dimension {dimension} of the observation")),
        ranges,
        fields: FIELDS,
        counts,
    }))
}

fn range(figures: impl Iterator<Item = f64>) -> [f64; 2] {
    let range = figures
        .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], figure| [low.min(figure), high.max(figure)]);
    visible(range)
}

/// A range that an axis can show: one whose ends hardly differ gets room on both sides, since no tick would lie between them.
pub(super) fn visible([low, high]: [f64; 2]) -> [f64; 2] {
    let size = low.abs().max(high.abs());
    let air = if high - low > (size * 1e-9).max(1e-40) { 0.0 } else { (size * 1e-3).max(0.5) };
    [low - air, high + air]
}
