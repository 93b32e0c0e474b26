//! What is written under and over a picture.

use embedded_graphics::{
    Drawable,
    draw_target::DrawTarget,
    geometry::{Point, Size},
    mono_font::{MonoTextStyle, ascii::FONT_6X10},
    pixelcolor::Rgb888,
    primitives::{Primitive, PrimitiveStyle, Rectangle},
    text::{Baseline, Text},
};

use crate::report::Picture;
use shield_core::events::Counters;

const BACKGROUND: Rgb888 = Rgb888::new(24, 26, 30);
const TEXT: Rgb888 = Rgb888::new(235, 235, 235);
const FORWARD: Rgb888 = Rgb888::new(90, 170, 250);
const RESET: Rgb888 = Rgb888::new(250, 190, 60);
const GOOD: Rgb888 = Rgb888::new(80, 190, 110);
const BAD: Rgb888 = Rgb888::new(230, 60, 60);
const TRACK: Rgb888 = Rgb888::new(64, 68, 76);

/// Height of the strip under the pictures, and of the line under each of several.
const STRIP: usize = 34;
const TITLE: usize = 14;
/// Between two pictures.
const GAP: usize = 8;
/// So wide that the strip's text fits.
const LEAST_WIDTH: usize = 320;

/// All of the above.
pub(super) const COLOURS: [Rgb888; 7] = [BACKGROUND, TEXT, FORWARD, RESET, GOOD, BAD, TRACK];

/// The text of the strip.
pub(super) struct Caption {
    pub phase: &'static str,
    pub step: u64,
    pub aborts: u64,
    pub hard_resets: u64,
}

impl Caption {
    pub(super) fn of(counters: &Counters) -> Self {
        let Counters { steps, early_aborts, hard_resets, .. } = *counters;
        Self { phase: "", step: steps, aborts: early_aborts, hard_resets }
    }
}

/// Values of an ensemble beside the threshold.
#[derive(Clone, Copy)]
pub(super) struct ValueBar {
    pub range: [f32; 2],
    pub mean: f32,
    pub q_min: Option<f32>,
    pub largest: f32,
}

/// What is marked on the picture itself.
#[derive(Clone, Copy)]
pub(super) enum Mark {
    Abort,
    HardReset,
    Projected,
}

/// Puts pictures with their titles side by side, the strip under them, and a mark around them.
pub(super) fn compose(
    panels: &[(String, Picture)],
    caption: &Caption,
    value: Option<ValueBar>,
    mark: Option<Mark>,
) -> Picture {
    let has_titles = panels.iter().any(|(title, _)| !title.is_empty());
    let title = if has_titles { TITLE } else { 0 };
    let cell = panels.iter().map(|(title, picture)| picture.width().max(6 * title.len() + 6)).max();
    let cell = cell.unwrap_or(0);
    let drawn: usize = panels.iter().map(|(_, picture)| picture.height()).max().unwrap_or(0);
    let all = (panels.len() * (cell + GAP)).saturating_sub(GAP);
    let width = all.max(LEAST_WIDTH);
    let mut canvas = Picture::new(width, drawn + title + STRIP);
    canvas.fill_solid(&Rectangle::new(Point::zero(), canvas_size(&canvas)), BACKGROUND).ok();
    let left = (width - all) / 2;
    for (index, (title, picture)) in panels.iter().enumerate() {
        let at = left + index * (cell + GAP);
        canvas.paste(picture, [at + (cell - picture.width()) / 2, 0]);
        write(&mut canvas, title, [at + (cell - 6 * title.len()) / 2, drawn + 2], TEXT);
    }
    strip(&mut canvas, drawn + title, caption, value);
    if let Some(mark) = mark {
        draw_mark(&mut canvas, drawn, mark);
    }
    canvas
}

fn canvas_size(canvas: &Picture) -> Size {
    Size::new(canvas.width() as u32, canvas.height() as u32)
}

// Drawing on a picture in memory cannot fail: its error type has no values.

fn write(canvas: &mut Picture, text: &str, [left, top]: [usize; 2], colour: Rgb888) {
    let style = MonoTextStyle::new(&FONT_6X10, colour);
    Text::with_baseline(text, Point::new(left as i32, top as i32), style, Baseline::Top).draw(canvas).ok();
}

fn fill(canvas: &mut Picture, [left, top]: [usize; 2], [width, height]: [usize; 2], colour: Rgb888) {
    let area = Rectangle::new(Point::new(left as i32, top as i32), Size::new(width as u32, height as u32));
    canvas.fill_solid(&area, colour).ok();
}

fn strip(canvas: &mut Picture, top: usize, caption: &Caption, value: Option<ValueBar>) {
    let colour = if caption.phase.starts_with("FORWARD") { FORWARD } else { RESET };
    write(canvas, caption.phase, [4, top + 4], colour);
    let counts =
        format!("step {}  aborts {}  hard resets {}", caption.step, caption.aborts, caption.hard_resets);
    let left = canvas.width().saturating_sub(6 * counts.len() + 4);
    write(canvas, &counts, [left, top + 4], TEXT);
    let Some(ValueBar { range, mean, q_min, largest }) = value else { return };
    let threshold = q_min.map_or(String::new(), |q_min| format!(", Q_min {q_min}"));
    // No −0.0.
    let shown = if mean.abs() < 0.05 { 0.0 } else { mean };
    let text = format!("reset value {shown:.1}{threshold}");
    write(canvas, &text, [4, top + 19], TEXT);
    let left = 6 * text.len().max(26) + 10;
    let width = canvas.width().saturating_sub(left + 6);
    let place = |value: f32| (value / largest).clamp(0.0, 1.0) * width as f32;
    let (low, high) = (place(range[0]) as usize, place(range[1]) as usize);
    fill(canvas, [left, top + 20], [width, 8], TRACK);
    let is_safe = q_min.is_none_or(|q_min| mean >= q_min);
    fill(canvas, [left + low, top + 20], [(high - low).max(2), 8], if is_safe { GOOD } else { BAD });
    if let Some(q_min) = q_min {
        fill(canvas, [left + place(q_min) as usize, top + 17], [2, 14], TEXT);
    }
}

fn draw_mark(canvas: &mut Picture, height: usize, mark: Mark) {
    let (text, colour) = match mark {
        Mark::Abort => ("EARLY ABORT", BAD),
        Mark::HardReset => ("HARD RESET", RESET),
        Mark::Projected => ("PROJECTED", GOOD),
    };
    let area = Rectangle::new(Point::zero(), Size::new(canvas.width() as u32, height as u32));
    area.into_styled(PrimitiveStyle::with_stroke(colour, 6)).draw(canvas).ok();
    fill(canvas, [0, 0], [6 * text.len() + 12, 18], colour);
    write(canvas, text, [6, 4], BACKGROUND);
}
