//! `shield report`: what runs came to, on one page and in pictures. Records and runs may be somebody else's: nothing that they name is executed.

mod cells;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::Args;
use shield_host::plugin::Registry;
use shield_lab::run::{RunFolder, write_in_folder};
use shield_report::report::{FIGURE_NAMES, Figure, Record, figures, page, png, svg, titled};

use self::cells::{Drawn, drawings, framed};
use super::{Failure, eval::runs_in, output};

/// Arguments of `shield report`.
#[derive(Args)]
pub struct ReportArguments {
    /// Folders of runs of one experiment, such as runs/mine; or a record of them, a file that --record wrote.
    #[arg(required = true)]
    sources: Vec<PathBuf>,
    /// The page. Default: report.html in the first folder, or beside the record.
    #[arg(long)]
    out: Option<PathBuf>,
    /// Variants to show, in this order, for example shielded,status-quo.
    #[arg(long, value_delimiter = ',')]
    variants: Option<Vec<String>>,
    /// Figures to show, by the names of their files, for example return,hard-resets.
    #[arg(long, value_delimiter = ',')]
    figures: Option<Vec<String>>,
    /// Writes each figure as a PNG file into this folder, too.
    #[arg(long, value_name = "FOLDER")]
    png: Option<PathBuf>,
    /// Writes each figure as an SVG file into this folder, too.
    #[arg(long, value_name = "FOLDER")]
    svg: Option<PathBuf>,
    /// What the names of these files begin with.
    #[arg(long, default_value = "")]
    prefix: String,
    /// Keeps what the page is made of in this file, a few kilobytes a run. What it has already of other runs stays.
    #[arg(long, value_name = "FILE")]
    record: Option<PathBuf>,
    /// The two dimensions of an observation by which aborts are placed. Default: 0,1. A record keeps those that it was made with.
    #[arg(long, value_delimiter = ',', num_args = 1)]
    dimensions: Option<Vec<usize>>,
}

/// Writes the page and whatever else was asked for.
pub fn report(arguments: &ReportArguments, registry: &Registry) -> Result<(), Failure> {
    let input = |error: anyhow::Error| Failure::Input(format!("{error:#}"));
    let mut record = read(arguments)?;
    if let Some(path) = &arguments.record {
        record.write(path).map_err(input)?;
        output::note(path.display());
    }
    choose(&mut record, arguments).map_err(input)?;
    let pictures = choose_pictures(&record, arguments, registry)?;
    write(&record, arguments, pictures).map_err(|error| Failure::Run(format!("{error:#}")))
}

/// The record that the sources are, with what --record has already.
fn read(arguments: &ReportArguments) -> Result<Record, Failure> {
    let input = |error: anyhow::Error| Failure::Input(format!("{error:#}"));
    let dimensions = match arguments.dimensions.as_deref() {
        None => None,
        Some(&[x, y]) => Some([x, y]),
        Some(_) => return Err(Failure::Input("--dimensions takes two numbers, for example 0,1".into())),
    };
    let mut record = match &arguments.record {
        Some(path) if path.exists() => Record::read(path).map_err(input)?,
        _ => Record::default(),
    };
    let mut folders: Vec<RunFolder> = Vec::new();
    for source in &arguments.sources {
        if source.is_file() {
            record.merge(Record::read(source).map_err(input)?).map_err(input)?;
        } else {
            folders.extend(runs_in(source)?);
        }
    }
    if folders.is_empty() && dimensions.is_some() {
        return Err(Failure::Input(
            "--dimensions is for folders of runs: a record keeps the dimensions that it was made with".into(),
        ));
    }
    let (runs, left_out) = Record::of_runs(&folders, dimensions).map_err(input)?;
    for reason in left_out {
        output::message(format_args!("warning: left out: {reason}"));
    }
    if !runs.variants.is_empty() {
        record.merge(runs).map_err(input)?;
    }
    if record.variants.is_empty() {
        return Err(Failure::Input(
            "no run is finished: `shield resume` goes on with those that were stopped or failed".into(),
        ));
    }
    Ok(record)
}

fn choose(record: &mut Record, arguments: &ReportArguments) -> Result<()> {
    let Some(wanted) = &arguments.variants else { return Ok(()) };
    let mut chosen = Vec::with_capacity(wanted.len());
    for name in wanted {
        let variant = record.variants.iter().find(|variant| variant.name == *name);
        let known =
            || record.variants.iter().map(|variant| variant.name.as_str()).collect::<Vec<_>>().join(", ");
        chosen.push(
            variant.with_context(|| format!("there is no variant {name}; there are: {}", known()))?.clone(),
        );
    }
    record.variants = chosen;
    Ok(())
}

/// The figures that the arguments name, or all. One that is known, but has nothing to show, is left out with a warning while others remain.
fn choose_pictures(
    record: &Record,
    arguments: &ReportArguments,
    registry: &Registry,
) -> Result<(Vec<Figure>, Vec<Drawn>), Failure> {
    let (mut figures, mut drawn) = (figures(record), drawings(record, registry));
    let Some(wanted) = &arguments.figures else { return Ok((figures, drawn)) };
    let own = figures.iter().map(Figure::name).chain(drawn.iter().map(|drawn| drawn.name.as_str()));
    let present: Vec<String> = own.map(str::to_owned).collect();
    let is_known = |name: &String| FIGURE_NAMES.contains(&name.as_str()) || present.contains(name);
    if let Some(unknown) = wanted.iter().find(|name| !is_known(name)) {
        let message = format!("there is no figure {unknown}; there are: {}", present.join(", "));
        return Err(Failure::Input(message));
    }
    let empty: Vec<&str> = wanted.iter().filter(|name| !present.contains(name)).map(String::as_str).collect();
    if empty.len() == wanted.len() {
        let (empty, present) = (empty.join(", "), present.join(", "));
        return Err(Failure::Input(format!("nothing to show in {empty}; there are: {present}")));
    }
    if !empty.is_empty() {
        output::message(format_args!("warning: nothing to show in {}", empty.join(", ")));
    }
    figures.retain(|figure| wanted.iter().any(|name| name == figure.name()));
    drawn.retain(|drawn| wanted.contains(&drawn.name));
    Ok((figures, drawn))
}

fn write(
    record: &Record,
    arguments: &ReportArguments,
    (figures, drawn): (Vec<Figure>, Vec<Drawn>),
) -> Result<()> {
    let place = |folder: &Path, name: &str, extension: &str| {
        folder.join(format!("{}{name}.{extension}", arguments.prefix))
    };
    if let Some(folder) = &arguments.png {
        for figure in &figures {
            write_in_folder(&place(folder, figure.name(), "png"), &png(figure)?)?;
        }
        for drawn in &drawn {
            let picture = titled(&drawn.picture, &drawn.title)?;
            write_in_folder(&place(folder, &drawn.name, "png"), &picture.png()?)?;
        }
    }
    let mut pictures = Vec::with_capacity(drawn.len());
    for drawn in drawn {
        let text = framed(&drawn)?;
        pictures.push((drawn.name, drawn.title, text));
    }
    if let Some(folder) = &arguments.svg {
        for figure in &figures {
            write_in_folder(&place(folder, figure.name(), "svg"), svg(figure)?.as_bytes())?;
        }
        for (name, _, text) in &pictures {
            write_in_folder(&place(folder, name, "svg"), text.as_bytes())?;
        }
    }
    let out = arguments.out.clone().unwrap_or_else(|| match &arguments.sources[0] {
        source if source.is_dir() => source.join("report.html"),
        source => source.with_extension("html"),
    });
    write_in_folder(&out, page(record, &figures, &pictures)?.as_bytes())?;
    output::note(out.display());
    Ok(())
}
