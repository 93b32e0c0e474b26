//! Figures as pictures: one drawing, as SVG or as PNG.

mod heat;
mod lines;
mod reliability;
mod rows;

use std::sync::OnceLock;

use anyhow::{Result, anyhow};
use plotters::{
    coord::Shift,
    prelude::{BitMapBackend, DrawingArea, DrawingBackend, IntoDrawingArea, SVGBackend},
    style::{FontStyle, IntoFont, RGBColor, TextStyle, WHITE, register_font},
};

use super::{figures::Figure, picture::Picture};

/// Size of a figure in points: two beside each other fill a page.
const SIZE: [u32; 2] = [640, 400];
/// A bitmap is drawn so many times as large, and then made smaller, so that its edges are smooth.
const SUPERSAMPLING: u32 = 2;
/// Pixels of a bitmap for each point.
const DENSITY: u32 = 2;

/// Okabe and Ito's colours, which people with any kind of colour vision tell apart. Their yellow is too pale for a line.
const COLOURS: [RGBColor; 7] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(40, 40, 40),
];
/// Most ticks of an axis.
const TICKS: u8 = 6;
const TEXT: RGBColor = RGBColor(30, 30, 30);
const GRID: RGBColor = RGBColor(225, 225, 225);
const TITLE_SIZE: u32 = 17;
const TEXT_SIZE: u32 = 14;
/// Height of the title over a picture that others made.
const TITLE_STRIP: u32 = 28;

/// What is drawn on, and how many of its units a point has.
struct Canvas<'a, B: DrawingBackend> {
    area: DrawingArea<B, Shift>,
    scale: u32,
    figure: &'a Figure,
}

impl<B: DrawingBackend> Canvas<'_, B> {
    fn points(&self, points: u32) -> u32 {
        points * self.scale
    }

    fn text(&self, points: u32) -> TextStyle<'static> {
        ("sans-serif", f64::from(self.points(points))).into_font().color(&TEXT)
    }
}

/// The figure as an SVG document.
///
/// # Errors
/// It cannot be drawn.
pub fn svg(figure: &Figure) -> Result<String> {
    let mut text = String::new();
    let size = size(figure);
    let area = SVGBackend::with_string(&mut text, (size[0], size[1])).into_drawing_area();
    draw(&Canvas { area, scale: 1, figure })?;
    Ok(text)
}

/// The figure as a PNG file, with twice as many pixels as it has points.
///
/// # Errors
/// It cannot be drawn.
pub fn png(figure: &Figure) -> Result<Vec<u8>> {
    let scale = DENSITY * SUPERSAMPLING;
    let [width, height] = size(figure).map(|points| points * scale);
    let mut pixels = vec![0; (width * height * 3) as usize];
    let area = BitMapBackend::with_buffer(&mut pixels, (width, height)).into_drawing_area();
    draw(&Canvas { area, scale, figure })?;
    let pixels = smaller(&pixels, width as usize, SUPERSAMPLING as usize);
    Picture::of((width / SUPERSAMPLING) as usize, pixels).png()
}

/// A picture that others made, under its title.
///
/// # Errors
/// The title cannot be drawn.
pub fn titled(picture: &Picture, title: &str) -> Result<Picture> {
    fonts()?;
    let (width, strip) = (picture.width() as u32, TITLE_STRIP * DENSITY);
    let mut pixels = vec![255; 3 * width as usize * (strip as usize + picture.height())];
    let area =
        BitMapBackend::with_buffer(&mut pixels, (width, strip + picture.height() as u32)).into_drawing_area();
    let mut size = f64::from(TEXT_SIZE * DENSITY);
    let style = |size: f64| ("sans-serif", size).into_font().color(&TEXT);
    let drawn = area.estimate_text_size(title, &style(size)).and_then(|(wide, _)| {
        // A long title becomes smaller rather than cut.
        size *= (f64::from(width) * 0.96 / f64::from(wide.max(1))).min(1.0);
        let (wide, high) = area.estimate_text_size(title, &style(size))?;
        let corner = (width.saturating_sub(wide) / 2, strip.saturating_sub(high) / 2);
        area.draw_text(title, &style(size), (corner.0 as i32, corner.1 as i32))?;
        area.present()
    });
    drawn.map_err(|error| anyhow!("{title:?} cannot be drawn: {error}"))?;
    drop(area);
    let mut whole = Picture::of(width as usize, pixels);
    whole.paste(picture, [0, strip as usize]);
    Ok(whole)
}

/// Means over squares of `times` by `times` pixels.
fn smaller(pixels: &[u8], width: usize, times: usize) -> Vec<u8> {
    let height = pixels.len() / 3 / width;
    let mut small = Vec::with_capacity(pixels.len() / (times * times));
    for row in (0..height).step_by(times) {
        for column in (0..width).step_by(times) {
            for colour in 0..3 {
                let within = (0..times * times).map(|at| {
                    let (x, y) = (column + at % times, row + at / times);
                    usize::from(pixels[(y * width + x) * 3 + colour])
                });
                small.push((within.sum::<usize>() / (times * times)) as u8);
            }
        }
    }
    small
}

/// Rows take the room that they need.
fn size(figure: &Figure) -> [u32; 2] {
    match figure {
        Figure::Lines(_) => SIZE,
        Figure::Dots(dots) => [SIZE[0], 110 + 26 * dots.rows.len() as u32],
        Figure::HeatMap(_) => [560, 440],
        Figure::Reliability(_) => [560, 560],
    }
}

fn draw<B: DrawingBackend>(canvas: &Canvas<'_, B>) -> Result<()> {
    let failed = |error: &dyn std::fmt::Display| anyhow!("{} cannot be drawn: {error}", canvas.figure.name());
    fonts()?;
    canvas.area.fill(&WHITE).map_err(|error| failed(&error))?;
    let drawn = match canvas.figure {
        Figure::Lines(figure) => lines::draw(canvas, figure),
        Figure::Dots(figure) => rows::draw(canvas, figure),
        Figure::HeatMap(figure) => heat::draw(canvas, figure),
        Figure::Reliability(figure) => reliability::draw(canvas, figure),
    };
    drawn.and_then(|()| canvas.area.present()).map_err(|error| failed(&error))
}

/// The font lies in the program, so that a figure looks the same on every machine.
fn fonts() -> Result<()> {
    static REGISTERED: OnceLock<bool> = OnceLock::new();
    let is_registered = REGISTERED
        .get_or_init(|| register_font("sans-serif", FontStyle::Normal, dejavu::sans::regular()).is_ok());
    if *is_registered { Ok(()) } else { Err(anyhow!("the font of the figures cannot be read")) }
}

/// A figure on an axis from `low` to `high`: no more digits than the distance of its neighbours needs.
fn label(figure: f64, [low, high]: [f64; 2]) -> String {
    let largest = low.abs().max(high.abs());
    let (divisor, unit) = match largest.abs() {
        large if large >= 1e6 => (1e6, "M"),
        large if large >= 1e4 => (1e3, "k"),
        _ => (1.0, ""),
    };
    let shown = figure / divisor;
    let distance = (high - low) / f64::from(TICKS) / divisor;
    let digits = (-distance.log10().floor()).clamp(0.0, 9.0) as usize;
    let text = format!("{shown:.digits$}");
    let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    if text.is_empty() || text == "-0" || text == "0" { "0".into() } else { format!("{text}{unit}") }
}

/// The colour of a variant, and whether its line is dashed: once all colours are used, they come again with dashes.
fn look(index: usize) -> (RGBColor, bool) {
    (COLOURS[index % COLOURS.len()], (index / COLOURS.len()) % 2 == 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::{
        figures::{Dots, Row},
        statistics::Spread,
    };

    #[test]
    fn axis_labels_are_short() {
        let labels = [(0.0, 60_000.0), (20_000.0, 60_000.0), (2_500_000.0, 5e6), (0.25, 0.5), (40.0, 80.0)];
        let labels = labels.map(|(figure, largest)| label(figure, [0.0, largest]));
        assert_eq!(labels, ["0", "20k", "2.5M", "0.25", "40"]);
        let narrow = [-0.0015, -0.001, -0.0005, 0.0].map(|figure| label(figure, [-0.002, 0.0]));
        assert_eq!(narrow, ["-0.0015", "-0.001", "-0.0005", "0"]);
        assert_eq!(label(100.02, [100.0, 100.1]), "100.02");
        assert_eq!(label(5.0, [5.0, 5.0]), "5");
    }

    #[test]
    fn a_run_in_which_it_never_happened_stands_beyond_the_axis() {
        let drawn = |seeds: Vec<f64>| {
            let spread = Spread::of(seeds.iter().copied()).unwrap();
            let rows = vec![Row { name: "v".into(), spread, seeds }];
            let [name, title, axis] = ["steps-to-solve", "title", "steps"].map(String::from);
            svg(&Figure::Dots(Dots { name, title, axis, rows })).unwrap()
        };
        let some = drawn(vec![100.0, 200.0, f64::INFINITY]);
        assert!(some.contains("never") && !some.contains("inf") && !some.contains("NaN"), "{some}");
        assert_eq!(some.matches("<circle").count(), 3);
        assert!(!drawn(vec![100.0, 200.0]).contains("never"));
    }

    #[test]
    fn a_title_is_drawn_above_the_unchanged_picture() {
        let picture = Picture::of(40, vec![7; 3 * 40 * 30]);
        let whole = titled(&picture, "a: where aborts happened, at most 18% in a cell").unwrap();
        let strip = (TITLE_STRIP * DENSITY) as usize;
        let (above, below) = whole.pixels().split_at(3 * 40 * strip);
        assert!(whole.width() == 40 && below == picture.pixels());
        assert!(above.iter().any(|value| *value < 200), "nothing is written");
    }

    #[test]
    fn a_smaller_picture_averages_the_pixels() {
        let wide = [0, 0, 0, 100, 100, 100, 20, 20, 20, 40, 40, 40];
        let pixels: Vec<u8> = wide.iter().chain(&wide).copied().collect();
        assert_eq!(smaller(&pixels, 4, 2), [50, 50, 50, 30, 30, 30]);
    }
}
