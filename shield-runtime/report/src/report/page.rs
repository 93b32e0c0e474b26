//! One page of HTML with everything in it.

use anyhow::Result;
use minijinja::{Environment, context};
use serde::Serialize;
use shield_lab::run::Summary;

use super::{
    attempts::{ATTEMPT_COLUMNS, ATTEMPT_NOTE, has_attempts},
    columns::{COLUMNS, Cell, Column, forward_share},
    draw,
    figures::Figure,
    record::{PluginRecord, Record, RunRecord, VariantRecord, but_for_seed},
    statistics::Spread,
};

use shield_lab::run::FoundInRun;

fn lifetime(run: &RunRecord) -> Option<f64> {
    run.course.lifetime_return.last().map(|sum| sum / run.summary.steps.max(1) as f64)
}

/// The last column, of the page alone.
const LIFETIME: &str = "lifetime reward of a step";

#[derive(Serialize)]
struct TableRow {
    name: String,
    seeds: usize,
    cells: Vec<Cell>,
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
    let runs = || record.variants.iter().flat_map(summaries);
    let columns: Vec<&Column> = COLUMNS.iter().filter(|column| column.has_figures(runs())).collect();
    let mut headings: Vec<String> = columns.iter().map(|column| column.heading.replace('\n', " ")).collect();
    headings.push(LIFETIME.into());
    let mut environment = Environment::new();
    environment.set_trim_blocks(true);
    environment.set_lstrip_blocks(true);
    environment.add_template("page.html", include_str!("page.html"))?;
    let names: Vec<&str> = record.variants.iter().map(|variant| variant.name.as_str()).collect();
    Ok(environment.get_template("page.html")?.render(context! {
        experiment => record.experiment,
        headings,
        rows => record.variants.iter().map(|variant| row(variant, &columns)).collect::<Vec<_>>(),
        notes => notes(&record.variants),
        attempt_columns => ATTEMPT_COLUMNS.map(|column| column.heading),
        attempts => record.variants.iter().filter_map(attempts).collect::<Vec<_>>(),
        attempt_note => ATTEMPT_NOTE,
        findings => findings(&record.variants),
        drawings,
        names,
        differences => configurations(&record.variants),
        config => record.variants.first().map_or("", |variant| &variant.config),
        plugins => plugins(&record.variants),
    })?)
}

fn summaries(variant: &VariantRecord) -> impl Iterator<Item = &Summary> {
    variant.runs.iter().map(|run| &run.summary)
}

fn row(variant: &VariantRecord, columns: &[&Column]) -> TableRow {
    let lifetime = Cell::of(variant.runs.iter().filter_map(lifetime), 3);
    let cells = columns.iter().map(|column| column.cell(summaries(variant))).chain([lifetime]);
    TableRow { name: variant.name.clone(), seeds: variant.runs.len(), cells: cells.collect() }
}

/// The row of a variant in the table of attempts, if it made any.
fn attempts(variant: &VariantRecord) -> Option<TableRow> {
    let some = || summaries(variant).filter(|run| has_attempts(run));
    let cells = ATTEMPT_COLUMNS.iter().map(|column| column.cell(some()));
    let seeds = some().count();
    (seeds > 0).then(|| TableRow { name: variant.name.clone(), seeds, cells: cells.collect() })
}

/// What must be known before figures are compared.
fn notes(variants: &[VariantRecord]) -> Vec<String> {
    let mut notes = Vec::new();
    for variant in variants {
        let name = &variant.name;
        let shares = Spread::of(summaries(variant).map(forward_share));
        let has_aborts = summaries(variant).any(|run| run.early_aborts > 0);
        if has_aborts && shares.is_some_and(|shares| shares.median < 0.5) {
            notes.push(format!(
                "{name} spent less than half of its steps forward; its hard resets do not compare with the others’."
            ));
        }
        if variant.experiment().is_some_and(|experiment| experiment.is_evaluated_without_its_shield()) {
            notes.push(format!("{name} was evaluated without its shield only."));
        }
    }
    notes
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
