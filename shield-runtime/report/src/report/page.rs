//! One page of HTML with everything in it.

use anyhow::Result;
use minijinja::{Environment, context};
use serde::Serialize;

use super::{
    draw,
    figures::Figure,
    record::{PluginRecord, Record, RunRecord, VariantRecord, but_for_seed},
    statistics::{Spread, show},
};

use shield_lab::run::FoundInRun;

/// A column of the final table: heading, figure of one run, decimals.
type Column = (&'static str, fn(&RunRecord) -> Option<f64>, usize);

const COLUMNS: [Column; 10] = [
    ("steps", |run| Some(run.summary.steps as f64), 0),
    ("of them forward, %", |run| Some(share(run) * 100.0), 0),
    ("early aborts", |run| Some(run.summary.early_aborts as f64), 0),
    ("hard resets", |run| Some(run.summary.hard_resets as f64), 0),
    ("irreversible entries", |run| Some(run.summary.irreversible_entries as f64), 0),
    ("final return", |run| run.summary.final_return, 2),
    ("best return", |run| run.summary.best_return, 2),
    ("success, %", |run| run.summary.success_rate.map(|rate| rate * 100.0), 0),
    ("steps to solve", |run| run.summary.steps_to_solve.map(|steps| steps as f64), 0),
    ("lifetime reward of a step", |run| lifetime(run), 3),
];

fn share(run: &RunRecord) -> f64 {
    run.summary.forward_steps as f64 / run.summary.steps.max(1) as f64
}

fn lifetime(run: &RunRecord) -> Option<f64> {
    run.course.lifetime_return.last().map(|sum| sum / run.summary.steps.max(1) as f64)
}

#[derive(Serialize)]
struct TableRow {
    name: String,
    seeds: usize,
    cells: Vec<Cell>,
}

/// A median, and the quartiles if they differ from it.
#[derive(Serialize)]
struct Cell {
    median: String,
    quartiles: String,
}

#[derive(Serialize)]
struct ConfigRow {
    field: String,
    values: Vec<String>,
}

/// Of several runs, the sentence is the first one's.
#[derive(Serialize)]
struct FindingRow<'a> {
    variant: &'a str,
    seeds: String,
    name: &'a str,
    sentence: &'a str,
    when: String,
}

#[derive(Serialize)]
struct PluginRow<'a> {
    fields: String,
    plugin: &'a PluginRecord,
}

#[derive(Serialize)]
struct Drawing {
    title: String,
    name: String,
    svg: String,
}

/// The page: final table, figures, configurations, plugins. `pictures` are drawings that others made, as name, title and SVG.
///
/// # Errors
/// A figure cannot be drawn.
pub fn page(record: &Record, figures: &[Figure], pictures: &[(String, String, String)]) -> Result<String> {
    let mut drawings = Vec::with_capacity(figures.len());
    for figure in figures {
        let svg = draw::svg(figure)?;
        drawings.push(Drawing { title: figure.title().into(), name: figure.name().into(), svg });
    }
    drawings.extend(pictures.iter().cloned().map(|(name, title, svg)| Drawing { title, name, svg }));
    let mut environment = Environment::new();
    environment.set_trim_blocks(true);
    environment.set_lstrip_blocks(true);
    environment.add_template("page.html", include_str!("page.html"))?;
    let names: Vec<&str> = record.variants.iter().map(|variant| variant.name.as_str()).collect();
    Ok(environment.get_template("page.html")?.render(context! {
        experiment => record.experiment,
        columns => COLUMNS.map(|(heading, ..)| heading),
        rows => record.variants.iter().map(row).collect::<Vec<_>>(),
        notes => notes(&record.variants),
        findings => findings(&record.variants),
        drawings,
        names,
        differences => configurations(&record.variants),
        config => record.variants.first().map_or("", |variant| &variant.config),
        plugins => plugins(&record.variants),
    })?)
}

fn row(variant: &VariantRecord) -> TableRow {
    let cell = |(_, figure, decimals): &Column| {
        let Some(spread) = Spread::of(variant.runs.iter().filter_map(figure)) else {
            return Cell { median: "–".into(), quartiles: String::new() };
        };
        let show = |figure: f64| show(figure, *decimals);
        let [lower, upper] = [show(spread.lower), show(spread.upper)];
        let quartiles = if lower == upper { String::new() } else { format!("{lower} to {upper}") };
        Cell { median: show(spread.median), quartiles }
    };
    TableRow {
        name: variant.name.clone(),
        seeds: variant.runs.len(),
        cells: COLUMNS.iter().map(cell).collect(),
    }
}

/// What must be known before hard resets are compared.
fn notes(variants: &[VariantRecord]) -> Vec<String> {
    let is_busy_resetting = |variant: &&VariantRecord| {
        let shares = Spread::of(variant.runs.iter().map(share));
        let aborts = variant.runs.iter().any(|run| run.summary.early_aborts > 0);
        aborts && shares.is_some_and(|shares| shares.median < 0.5)
    };
    let note = |variant: &VariantRecord| {
        let name = &variant.name;
        format!(
            "{name} spent less than half of its steps forward; its hard resets do not compare with the others’."
        )
    };
    variants.iter().filter(is_busy_resetting).map(note).collect()
}

/// What kept the shield from helping: a line for each finding of each variant, with the seeds that have it.
fn findings(variants: &[VariantRecord]) -> Vec<FindingRow<'_>> {
    let mut rows: Vec<FindingRow<'_>> = Vec::new();
    for variant in variants {
        let first = rows.len();
        for run in &variant.runs {
            for found in &run.summary.findings {
                let FoundInRun { name, sentence, .. } = found;
                let seed = run.seed.to_string();
                match rows[first..].iter_mut().find(|row| row.name == name) {
                    Some(row) => row.seeds += &format!(", {seed}"),
                    None => {
                        let (seeds, when) = (seed, found.when());
                        rows.push(FindingRow { variant: &variant.name, seeds, name, sentence, when });
                    }
                }
            }
        }
    }
    rows
}

/// Every field in which some variant differs from the first, with what each has there.
fn configurations(variants: &[VariantRecord]) -> Vec<ConfigRow> {
    let Some((first, others)) = variants.split_first() else { return Vec::new() };
    let mut rows: Vec<ConfigRow> = Vec::new();
    for (index, variant) in others.iter().enumerate() {
        for difference in but_for_seed(&first.config, &variant.config) {
            let show = |value: Option<String>| value.unwrap_or_else(|| "–".into());
            let at = rows.iter().position(|row| row.field == difference.path).unwrap_or_else(|| {
                let values = vec![show(difference.first.clone()); variants.len()];
                rows.push(ConfigRow { field: difference.path.clone(), values });
                rows.len() - 1
            });
            rows[at].values[index + 1] = show(difference.second);
        }
    }
    rows
}

/// Every plugin once, with the fields that name it.
fn plugins(variants: &[VariantRecord]) -> Vec<PluginRow<'_>> {
    let mut rows: Vec<(Vec<&str>, &PluginRecord)> = Vec::new();
    for (field, plugin) in variants.iter().flat_map(|variant| &variant.plugins) {
        match rows.iter_mut().find(|(_, known)| *known == plugin) {
            None => rows.push((vec![field], plugin)),
            Some((fields, _)) if !fields.contains(&field.as_str()) => fields.push(field),
            Some(_) => (),
        }
    }
    rows.into_iter().map(|(fields, plugin)| PluginRow { fields: fields.join(", "), plugin }).collect()
}
