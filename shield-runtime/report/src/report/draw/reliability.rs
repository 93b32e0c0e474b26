//! A reliability diagram: realised share against estimate, and below it how many attempts each point stands for.

use plotters::{
    chart::{ChartBuilder, ChartContext},
    coord::{Shift, cartesian::Cartesian2d, types::RangedCoordf64},
    element::{Circle, PathElement},
    prelude::{DashedLineSeries, DrawingArea, DrawingAreaErrorKind, DrawingBackend, LineSeries, Rectangle},
    style::{Color, RGBColor, ShapeStyle},
};

use super::{COLOURS, Canvas, GRID, TEXT, TEXT_SIZE, TITLE_SIZE, label};
use crate::report::attempts::Diagram;

type Drawn<B> = Result<(), DrawingAreaErrorKind<<B as DrawingBackend>::ErrorType>>;
type Plane = Cartesian2d<RangedCoordf64, RangedCoordf64>;

/// Height of the counts below the diagram.
const COUNTS: u32 = 120;
/// Height of the legend above it.
const LEGEND: u32 = 24;
/// Of the diagonal.
const DASH: u32 = 5;
const GAP: u32 = 4;
/// Of what belongs to the whole run.
const PALE: RGBColor = RGBColor(150, 150, 150);
/// Ticks of both axes: a bin is a tenth.
const TENTHS: usize = 11;

pub(super) fn draw<B: DrawingBackend>(canvas: &Canvas<'_, B>, figure: &Diagram) -> Drawn<B> {
    let titled =
        canvas.area.margin(canvas.points(8), 0, 0, 0).titled(&figure.title, canvas.text(TITLE_SIZE))?;
    let (strip, charts) = titled.split_vertically(canvas.points(LEGEND));
    let height = charts.dim_in_pixel().1;
    let (above, below) = charts.split_vertically(height.saturating_sub(canvas.points(COUNTS)));
    legend(canvas, &strip, figure)?;
    diagram(canvas, &above, figure)?;
    counts(canvas, &below, figure)
}

/// A point is the larger, the more attempts it stands for.
fn diagram<B: DrawingBackend>(
    canvas: &Canvas<'_, B>,
    area: &DrawingArea<B, Shift>,
    figure: &Diagram,
) -> Drawn<B> {
    let mut chart = plane(canvas, area, 1.0)?;
    mesh(canvas, &mut chart, 1.0, "share that succeeded", "")?;
    let (dash, gap) = (canvas.points(DASH), canvas.points(GAP));
    let diagonal = [(0.0, 0.0), (1.0, 1.0)];
    chart.draw_series(DashedLineSeries::new(diagonal, dash, gap, stroke(canvas, TEXT, 1)))?;
    for (reliability, colour) in [(&figure.all, PALE), (&figure.last_half, COLOURS[0])] {
        let points = Diagram::points(reliability);
        let most = points.iter().map(|(_, forecasts)| *forecasts).max().unwrap_or(1) as f64;
        let line = points.iter().map(|(point, _)| *point);
        chart.draw_series(LineSeries::new(line, stroke(canvas, colour, 1)))?;
        chart.draw_series(points.iter().map(|(point, forecasts)| {
            let radius = 1.5 + 5.0 * (*forecasts as f64 / most).sqrt();
            Circle::new(*point, (radius * f64::from(canvas.points(1))).round() as u32, colour.filled())
        }))?;
    }
    Ok(())
}

/// How many attempts lie in each bin, of the later half.
fn counts<B: DrawingBackend>(
    canvas: &Canvas<'_, B>,
    area: &DrawingArea<B, Shift>,
    figure: &Diagram,
) -> Drawn<B> {
    let bins = &figure.last_half.bins;
    let most = bins.iter().map(|bin| bin.forecasts).max().unwrap_or(0).max(1) as f64;
    // Room for the number above the highest bar.
    let top = most * 1.4;
    let mut chart = plane(canvas, area, top)?;
    mesh(canvas, &mut chart, top, "attempts", "estimated probability of success at the start of an attempt")?;
    let occupied = || bins.iter().enumerate().filter(|(_, bin)| bin.forecasts > 0);
    chart.draw_series(occupied().map(|(index, bin)| {
        let [from, to] = Diagram::borders(index);
        let corners = [(from + 0.008, 0.0), (to - 0.008, bin.forecasts as f64)];
        Rectangle::new(corners, COLOURS[0].mix(0.5).filled())
    }))?;
    let style = canvas.text(TEXT_SIZE - 2);
    for (index, bin) in occupied() {
        let [from, to] = Diagram::borders(index);
        let (x, y) = chart.backend_coord(&(0.5 * (from + to), bin.forecasts as f64));
        let count = bin.forecasts.to_string();
        let (width, height) = canvas.area.estimate_text_size(&count, &style)?;
        canvas.area.draw_text(
            &count,
            &style,
            (x - width as i32 / 2, y - height as i32 - canvas.points(2) as i32),
        )?;
    }
    Ok(())
}

fn plane<'a, B: DrawingBackend>(
    canvas: &Canvas<'_, B>,
    area: &'a DrawingArea<B, Shift>,
    top: f64,
) -> Result<ChartContext<'a, B, Plane>, DrawingAreaErrorKind<B::ErrorType>> {
    ChartBuilder::on(area)
        .margin(canvas.points(6))
        .margin_right(canvas.points(24))
        .x_label_area_size(canvas.points(44))
        .y_label_area_size(canvas.points(64))
        .build_cartesian_2d(0.0..1.0, 0.0..top)
}

fn mesh<B: DrawingBackend>(
    canvas: &Canvas<'_, B>,
    chart: &mut ChartContext<'_, B, Plane>,
    top: f64,
    vertical: &str,
    horizontal: &str,
) -> Drawn<B> {
    let text = canvas.text(TEXT_SIZE);
    chart
        .configure_mesh()
        .bold_line_style(stroke(canvas, GRID, 1))
        .light_line_style(GRID.mix(0.0))
        .axis_style(stroke(canvas, TEXT, 1))
        .set_all_tick_mark_size(canvas.points(4))
        .x_labels(TENTHS)
        .y_labels(if top == 1.0 { TENTHS } else { 3 })
        .x_label_formatter(&|figure| label(*figure, [0.0, 1.0]))
        .y_label_formatter(&|figure| label(*figure, [0.0, top]))
        .x_desc(horizontal)
        .y_desc(vertical)
        .label_style(text.clone())
        .axis_desc_style(text)
        .draw()
}

/// What each line is.
fn legend<B: DrawingBackend>(
    canvas: &Canvas<'_, B>,
    area: &DrawingArea<B, Shift>,
    figure: &Diagram,
) -> Drawn<B> {
    let (style, of) = (canvas.text(TEXT_SIZE), |points: u32| canvas.points(points) as i32);
    let middle = of(LEGEND) / 2;
    let mut left = of(70);
    let entries = [
        (COLOURS[0], format!("later half ({})", figure.last_half.forecasts())),
        (PALE, format!("all attempts ({})", figure.all.forecasts())),
        (TEXT, "calibrated".to_owned()),
    ];
    for (colour, words) in entries {
        if colour == TEXT {
            let dashes = (0..3).map(|dash| left + dash * of(DASH + GAP));
            for start in dashes {
                let path = vec![(start, middle), (start + of(DASH), middle)];
                area.draw(&PathElement::new(path, stroke(canvas, colour, 1)))?;
            }
        } else {
            area.draw(&Circle::new((left + of(12), middle), of(5), colour.filled()))?;
        }
        let (width, height) = area.estimate_text_size(&words, &style)?;
        area.draw_text(&words, &style, (left + of(28), middle - height as i32 / 2))?;
        left += of(28 + 22) + width as i32;
    }
    Ok(())
}

fn stroke<B: DrawingBackend>(canvas: &Canvas<'_, B>, colour: RGBColor, width: u32) -> ShapeStyle {
    ShapeStyle { color: colour.to_rgba(), filled: false, stroke_width: canvas.points(width) }
}
