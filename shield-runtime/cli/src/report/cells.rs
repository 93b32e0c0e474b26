//! Where variants with discrete observations were aborted, drawn by their environments, which alone know where a cell lies.

use anyhow::{Context, Result, bail, ensure};
use base64::{Engine, prelude::BASE64_STANDARD};
use shield_api::{Environment, Frame, Setup, Space};
use shield_config::experiment::{Experiment, ExperimentFile};
use shield_host::plugin::{LoadedEnvironment, Registry, Selection, host_without_metrics};
use shield_report::report::{Picture, Places, Record, VariantRecord};

use super::super::output;

/// Environments that draw cells. With whatever configuration they are made, they read no file and start no process; others might, and a
/// configuration comes with the record.
const ENVIRONMENTS: [&str; 1] = ["gridworld"];
/// A picture is drawn so many times as large as it would be in a film, unless a side would become longer than this, in pixels.
const MAGNIFICATION: usize = 2;
const LONGEST_SIDE: usize = 4096;

/// A figure that the environment drew.
pub struct Drawn {
    /// Name of its file, without the extension.
    pub name: String,
    /// What it shows.
    pub title: String,
    /// The cells, each shaded by its share of the aborts.
    pub picture: Picture,
}

/// A picture for each variant that has counts of cells.
pub fn drawings(record: &Record, registry: &Registry) -> Vec<Drawn> {
    let mut drawings = Vec::new();
    for variant in &record.variants {
        let Some(shares) = cells(variant) else { continue };
        match drawing(variant, &shares, registry) {
            Ok(drawn) => drawings.push(drawn),
            Err(error) => {
                let name = &variant.name;
                output::message(format_args!("warning: {name}: no picture of its aborts: {error:#}"));
            }
        }
    }
    drawings
}

/// Which share of a seed's early aborts each cell has, the mean over the seeds: one that aborts without end does not hide the others.
fn cells(variant: &VariantRecord) -> Option<Vec<f64>> {
    let counts = variant.runs.iter().filter_map(|run| match &run.aborts {
        Some(Places::Cells(counts)) => Some(counts),
        _ => None,
    });
    let seeds = counts.clone().count();
    let mut shares = vec![0.0; counts.clone().next()?.len()];
    for counts in counts {
        let total: f64 = counts.iter().map(|count| *count as f64).sum();
        let each = counts.iter().map(|count| *count as f64 / total.max(1.0) / seeds as f64);
        shares.iter_mut().zip(each).for_each(|(share, more)| *share += more);
    }
    Some(shares)
}

fn drawing(variant: &VariantRecord, shares: &[f64], registry: &Registry) -> Result<Drawn> {
    let file = ExperimentFile::from_text("the record", variant.config.as_str());
    let variants = file.variants(&[], None)?;
    let first = variants.first().context("the record has no configuration")?;
    let mut environment = environment(&first.experiment, registry)?;
    let cells = match environment.spec().spaces.observation {
        Space::Discrete { n } => n,
        Space::Box { .. } => 0,
    };
    ensure!(cells == shares.len(), "the record counts {} cells, its environment has {cells}", shares.len());
    let size = environment.frame_size();
    let is_large = size.iter().any(|pixels| pixels * MAGNIFICATION > LONGEST_SIDE);
    let [width, height] = size.map(|pixels| if is_large { pixels } else { pixels * MAGNIFICATION });
    let most = shares.iter().copied().fold(0.0, f64::max);
    let shades: Vec<f32> = shares.iter().map(|share| (share / most) as f32).collect();
    let mut picture = Picture::new(width, height);
    environment.render(&mut Frame::new(width, height, picture.pixels_mut())?.with_shades(&shades))?;
    Ok(Drawn {
        name: format!("where-{}", variant.name),
        title: format!("{}: where aborts happened, at most {:.0}% in a cell", variant.name, most * 100.0),
        picture,
    })
}

/// The environment alone, from the search path: the file and the process of its own that a configuration may ask for are ignored.
fn environment(experiment: &Experiment, registry: &Registry) -> Result<LoadedEnvironment> {
    let choice = &experiment.environment;
    if !ENVIRONMENTS.contains(&choice.plugin.as_str()) {
        let known = ENVIRONMENTS.join(", ");
        bail!(
            "a report makes no environment but {known}: what a record says could let another start programs"
        );
    }
    let setup = Setup::new(0, 1, host_without_metrics());
    Ok(registry.environment(&Selection::new(&choice.plugin), choice.config.get_ron(), &setup)?)
}

/// A picture with its title, as an SVG document.
pub fn framed(drawn: &Drawn) -> Result<String> {
    let [width, height] = [drawn.picture.width(), drawn.picture.height()];
    let image = BASE64_STANDARD.encode(drawn.picture.png()?);
    let title = drawn.title.replace('&', "&amp;").replace('<', "&lt;");
    Ok(format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {}\" width=\"{width}\">\
         <text x=\"{}\" y=\"20\" text-anchor=\"middle\" font-family=\"sans-serif\" font-size=\"14\">{title}</text>\
         <image y=\"32\" width=\"{width}\" height=\"{height}\" href=\"data:image/png;base64,{image}\"/></svg>\n",
        height + 32,
        width / 2,
    ))
}
