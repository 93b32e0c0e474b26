//! Lines with bands, and their legend underneath.

use plotters::{
    chart::ChartBuilder,
    coord::Shift,
    element::{PathElement, Polygon},
    prelude::{DashedLineSeries, DrawingArea, DrawingAreaErrorKind, DrawingBackend, LineSeries, Rectangle},
    style::{Color, RGBColor, ShapeStyle},
};

use super::{Canvas, GRID, TEXT, TEXT_SIZE, TICKS, TITLE_SIZE, label, look};
use crate::report::figures::{Band, Lines, visible};

type Drawn<B> = Result<(), DrawingAreaErrorKind<<B as DrawingBackend>::ErrorType>>;

/// Height of a line of the legend, and the length of the stroke before a name.
const LEGEND_LINE: u32 = 20;
const STROKE: u32 = 26;
const GAP: u32 = 18;

pub(super) fn draw<B: DrawingBackend>(canvas: &Canvas<'_, B>, figure: &Lines) -> Drawn<B> {
    let legend = Legend::arrange(canvas, &figure.bands)?;
    let height = canvas.area.dim_in_pixel().1;
    // The curves keep half of the picture: of very many variants, the legend names the first.
    let (plot, below) = canvas.area.split_vertically(height.saturating_sub(legend.height).max(height / 2));
    let steps = figure.bands.iter().flat_map(|band| band.points.last()).map(|point| point.0);
    let right = steps.fold(1.0, f64::max);
    let [low, high] = vertical_range(&figure.bands);
    let text = canvas.text(TEXT_SIZE);
    let mut chart = ChartBuilder::on(&plot)
        .caption(&figure.title, canvas.text(TITLE_SIZE))
        .margin(canvas.points(10))
        .margin_right(canvas.points(24))
        .x_label_area_size(canvas.points(44))
        .y_label_area_size(canvas.points(64))
        .build_cartesian_2d(0.0..right, low..high)?;
    chart
        .configure_mesh()
        .disable_x_mesh()
        .bold_line_style(ShapeStyle { color: GRID.to_rgba(), filled: false, stroke_width: canvas.scale })
        .light_line_style(GRID.mix(0.0))
        .axis_style(ShapeStyle { color: TEXT.to_rgba(), filled: false, stroke_width: canvas.scale })
        .set_all_tick_mark_size(canvas.points(4))
        .x_labels(TICKS.into())
        .y_labels(TICKS.into())
        .x_label_formatter(&|figure| label(*figure, [0.0, right]))
        .y_label_formatter(&|figure| label(*figure, [low, high]))
        .x_desc("environment steps")
        .y_desc(&figure.axis)
        .label_style(text.clone())
        .axis_desc_style(text)
        .draw()?;
    for (index, band) in figure.bands.iter().enumerate() {
        let (colour, _) = look(index);
        let upper = band.points.iter().map(|(step, spread)| (*step, spread.upper));
        let lower = band.points.iter().rev().map(|(step, spread)| (*step, spread.lower));
        let outline: Vec<(f64, f64)> = upper.chain(lower).collect();
        chart.draw_series([Polygon::new(outline, colour.mix(0.16).filled())])?;
    }
    for (index, band) in figure.bands.iter().enumerate() {
        let (colour, is_dashed) = look(index);
        let medians = band.points.iter().map(|(step, spread)| (*step, spread.median));
        let style = stroke(canvas, colour);
        if is_dashed {
            let (dash, gap) = (canvas.points(7), canvas.points(4));
            chart.draw_series(DashedLineSeries::new(medians, dash, gap, style))?;
        } else {
            chart.draw_series(LineSeries::new(medians, style))?;
        }
    }
    legend.draw(canvas, &below)
}

fn stroke<B: DrawingBackend>(canvas: &Canvas<'_, B>, colour: RGBColor) -> ShapeStyle {
    ShapeStyle { color: colour.to_rgba(), filled: false, stroke_width: canvas.points(2) }
}

/// With zero where that is near, and some air above.
fn vertical_range(bands: &[Band]) -> [f64; 2] {
    let spreads = bands.iter().flat_map(|band| band.points.iter().map(|(_, spread)| spread));
    let [low, high] = spreads.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], spread| {
        [low.min(spread.lower), high.max(spread.upper)]
    });
    let low = if low > 0.0 && low < 0.6 * high { 0.0 } else { low };
    let air = if high > low { (high - low) * 0.05 } else { 0.5 };
    visible([if low == 0.0 { 0.0 } else { low - air }, high + air])
}

/// Where each name stands: as many in a line as fit.
struct Legend {
    /// Name, and its place within the legend.
    entries: Vec<(String, [i32; 2])>,
    height: u32,
}

impl Legend {
    fn arrange<B: DrawingBackend>(
        canvas: &Canvas<'_, B>,
        bands: &[Band],
    ) -> Result<Self, DrawingAreaErrorKind<B::ErrorType>> {
        let style = canvas.text(TEXT_SIZE);
        let (left, line) = (canvas.points(74), canvas.points(LEGEND_LINE));
        let right = canvas.area.dim_in_pixel().0 - canvas.points(12);
        let (mut x, mut y) = (left, 0);
        let mut entries = Vec::new();
        for band in bands {
            let text = canvas.area.estimate_text_size(&band.name, &style)?.0;
            let width = canvas.points(STROKE + 6) + text;
            if x + width > right && x > left {
                (x, y) = (left, y + line);
            }
            entries.push((band.name.clone(), [x as i32, y as i32]));
            x += width + canvas.points(GAP);
        }
        Ok(Self { entries, height: y + line + canvas.points(10) })
    }

    fn draw<B: DrawingBackend>(&self, canvas: &Canvas<'_, B>, area: &DrawingArea<B, Shift>) -> Drawn<B> {
        let style = canvas.text(TEXT_SIZE);
        let of = |points: u32| canvas.points(points) as i32;
        let room = area.dim_in_pixel().1 as i32 - of(LEGEND_LINE);
        for (index, (name, [x, y])) in self.entries.iter().enumerate().filter(|(_, (_, [_, y]))| *y <= room) {
            let (colour, is_dashed) = look(index);
            let middle = y + of(LEGEND_LINE) / 2;
            let band = [(*x, middle - of(5)), (x + of(STROKE), middle + of(5))];
            area.draw(&Rectangle::new(band, colour.mix(0.16).filled()))?;
            let strokes: &[(u32, u32)] =
                if is_dashed { &[(0, 7), (11, 18), (22, 26)] } else { &[(0, STROKE)] };
            for (from, to) in strokes {
                let path = vec![(x + of(*from), middle), (x + of(*to), middle)];
                area.draw(&PathElement::new(path, stroke(canvas, colour)))?;
            }
            let height = area.estimate_text_size(name, &style)?.1 as i32;
            area.draw_text(name, &style, (x + of(STROKE + 6), middle - height / 2))?;
        }
        Ok(())
    }
}
