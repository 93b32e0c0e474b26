//! Counts over a plane, with their scale beside it.

use plotters::{
    chart::ChartBuilder,
    prelude::{DrawingAreaErrorKind, DrawingBackend, Rectangle},
    style::{Color, RGBColor, ShapeStyle},
};

use super::{Canvas, TEXT, TEXT_SIZE, TICKS, TITLE_SIZE, label};
use crate::report::figures::HeatMap;

/// From few to many: lightness falls evenly, so that it reads in grey as well.
const SCALE: [RGBColor; 5] = [
    RGBColor(255, 255, 255),
    RGBColor(198, 219, 239),
    RGBColor(107, 174, 214),
    RGBColor(33, 113, 181),
    RGBColor(8, 48, 107),
];

pub(super) fn draw<B: DrawingBackend>(
    canvas: &Canvas<'_, B>,
    figure: &HeatMap,
) -> Result<(), DrawingAreaErrorKind<B::ErrorType>> {
    let text = canvas.text(TEXT_SIZE);
    let width = canvas.area.dim_in_pixel().0;
    let (plot, beside) = canvas.area.split_horizontally(width - canvas.points(86));
    let [[left, right], [bottom, top]] = figure.ranges;
    let most = figure.counts.iter().copied().fold(1.0, f64::max);
    let below_title =
        plot.margin(canvas.points(8), 0, 0, 0).titled(&figure.title, canvas.text(TITLE_SIZE))?;
    let mut chart = ChartBuilder::on(&below_title)
        .margin(canvas.points(10))
        .x_label_area_size(canvas.points(44))
        .y_label_area_size(canvas.points(64))
        .build_cartesian_2d(left..right, bottom..top)?;
    chart
        .configure_mesh()
        .disable_mesh()
        .axis_style(ShapeStyle { color: TEXT.to_rgba(), filled: false, stroke_width: canvas.scale })
        .set_all_tick_mark_size(canvas.points(4))
        .x_labels(TICKS.into())
        .y_labels(TICKS.into())
        .x_label_formatter(&|figure| label(*figure, [left, right]))
        .y_label_formatter(&|figure| label(*figure, [bottom, top]))
        .x_desc(&figure.axes[0])
        .y_desc(&figure.axes[1])
        .label_style(text.clone())
        .axis_desc_style(text)
        .draw()?;
    let fields = figure.fields;
    let cell = [(right - left) / fields as f64, (top - bottom) / fields as f64];
    let occupied = figure.counts.iter().enumerate().filter(|(_, count)| **count > 0.0);
    chart.draw_series(occupied.map(|(at, count)| {
        let corner = (left + (at % fields) as f64 * cell[0], bottom + (at / fields) as f64 * cell[1]);
        // The square root, or a few fields would take all the colours.
        let colour = shade((count / most).sqrt());
        Rectangle::new([corner, (corner.0 + cell[0], corner.1 + cell[1])], colour.filled())
    }))?;
    let mut scale = ChartBuilder::on(&beside)
        .margin_top(canvas.points(44))
        .margin_bottom(canvas.points(54))
        .margin_left(canvas.points(4))
        .right_y_label_area_size(canvas.points(58))
        .build_cartesian_2d(0.0..1.0, 0.0..1.0)?;
    let strips = 40;
    scale.draw_series((0..strips).map(|strip| {
        let [from, to] = [strip, strip + 1].map(|at| f64::from(at) / f64::from(strips));
        Rectangle::new([(0.0, from), (1.0, to)], shade(to).filled())
    }))?;
    let style = canvas.text(TEXT_SIZE);
    for share in [0.0, 0.25, 0.5, 0.75, 1.0_f64] {
        let (x, y) = scale.backend_coord(&(1.0, share));
        let name = format!("{:.0}", share * share * most);
        let height = canvas.area.estimate_text_size(&name, &style)?.1 as i32;
        canvas.area.draw_text(&name, &style, (x + canvas.points(6) as i32, y - height / 2))?;
    }
    Ok(())
}

/// The colour of a share of the most.
fn shade(share: f64) -> RGBColor {
    let place = share.clamp(0.0, 1.0) * (SCALE.len() - 1) as f64;
    let below = (place.floor() as usize).min(SCALE.len() - 2);
    let (low, high) = (SCALE[below], SCALE[below + 1]);
    let mix = |low: u8, high: u8| {
        (f64::from(low) + (f64::from(high) - f64::from(low)) * (place - below as f64)) as u8
    };
    RGBColor(mix(low.0, high.0), mix(low.1, high.1), mix(low.2, high.2))
}
