//! A row per variant: each seed, the middle half, and the median.

use plotters::{
    chart::ChartBuilder,
    element::{Circle, PathElement},
    prelude::{DrawingAreaErrorKind, DrawingBackend, Rectangle},
    style::{Color, ShapeStyle},
};

use super::{COLOURS, Canvas, GRID, TEXT, TEXT_SIZE, TICKS, TITLE_SIZE, label};
use crate::report::figures::{Dots, visible};

/// What stands under the runs in which it did not happen.
const NEVER: &str = "never";

pub(super) fn draw<B: DrawingBackend>(
    canvas: &Canvas<'_, B>,
    figure: &Dots,
) -> Result<(), DrawingAreaErrorKind<B::ErrorType>> {
    let text = canvas.text(TEXT_SIZE);
    let mut names = 0;
    for row in &figure.rows {
        names = names.max(canvas.area.estimate_text_size(&row.name, &text)?.0);
    }
    let seeds = || figure.rows.iter().flat_map(|row| row.seeds.iter().copied());
    let (low, high) = seeds()
        .filter(|seed| seed.is_finite())
        .fold((0.0, 0.0_f64), |(low, high): (f64, f64), seed| (low.min(seed), high.max(seed)));
    let [low, high] = visible([low, high + (high - low) * 0.03]);
    // What never happened stands beyond the end of the axis.
    let is_never = seeds().any(f64::is_infinite);
    let (never, right) =
        (high + (high - low) * 0.08, high + (high - low) * if is_never { 0.14 } else { 0.0 });
    let place = |figure: f64| if figure.is_finite() { figure } else { never };
    let count = figure.rows.len() as f64;
    let names = names.min(canvas.area.dim_in_pixel().0 / 2);
    let mut chart = ChartBuilder::on(&canvas.area)
        .caption(&figure.title, canvas.text(TITLE_SIZE))
        .margin(canvas.points(10))
        .margin_right(canvas.points(24))
        .x_label_area_size(canvas.points(44))
        .y_label_area_size(names + canvas.points(12))
        .build_cartesian_2d(low..right, count..0.0)?;
    chart
        .configure_mesh()
        .disable_y_mesh()
        .disable_y_axis()
        .y_labels(0)
        .bold_line_style(ShapeStyle { color: GRID.to_rgba(), filled: false, stroke_width: canvas.scale })
        .light_line_style(GRID.mix(0.0))
        .axis_style(ShapeStyle { color: TEXT.to_rgba(), filled: false, stroke_width: canvas.scale })
        .set_all_tick_mark_size(canvas.points(4))
        .x_labels(TICKS.into())
        .x_label_formatter(&|figure| {
            if *figure <= high { label(*figure, [low, high]) } else { String::new() }
        })
        .x_desc(&figure.axis)
        .label_style(text.clone())
        .axis_desc_style(text.clone())
        .draw()?;
    if is_never {
        let (x, y) = chart.backend_coord(&(never, count));
        let width = canvas.area.estimate_text_size(NEVER, &text)?.0;
        canvas.area.draw_text(NEVER, &text, (x - width as i32 / 2, y + canvas.points(8) as i32))?;
    }
    let colour = COLOURS[0];
    for (index, row) in figure.rows.iter().enumerate() {
        let middle = index as f64 + 0.5;
        let [lower, median, upper] = [row.spread.lower, row.spread.median, row.spread.upper].map(place);
        let half = [(lower, middle - 0.28), (upper, middle + 0.28)];
        chart.draw_series([Rectangle::new(half, colour.mix(0.25).filled())])?;
        let median = vec![(median, middle - 0.36), (median, middle + 0.36)];
        let style = ShapeStyle { color: colour.to_rgba(), filled: true, stroke_width: canvas.points(3) };
        chart.draw_series([PathElement::new(median, style)])?;
        let seed =
            |seed: &f64| Circle::new((place(*seed), middle), canvas.points(3), TEXT.mix(0.45).filled());
        chart.draw_series(row.seeds.iter().map(seed))?;
        let (x, y) = chart.backend_coord(&(low, middle));
        let (width, height) = canvas.area.estimate_text_size(&row.name, &text)?;
        let place =
            (x - width as i32 - canvas.points(8) as i32, y - height as i32 / 2 + canvas.points(2) as i32);
        canvas.area.draw_text(&row.name, &text, place)?;
    }
    Ok(())
}
