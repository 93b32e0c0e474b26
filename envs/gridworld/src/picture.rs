//! A gridworld as a picture: cells by kind, shaded by a figure of each, and the agent.

use shield_api::Frame;

use crate::map::{Cell, Map};

type Colour = [u8; 3];

const FREE: Colour = [246, 246, 242];
const WALL: Colour = [70, 72, 80];
const GRID: Colour = [200, 200, 196];
const START: Colour = [50, 110, 200];
const GOAL: Colour = [30, 150, 70];
const ABSORBING: Colour = [180, 40, 40];
const AGENT: Colour = [25, 25, 30];
/// Of a shade of 1; smaller ones lie between a free cell's colour and this.
const SHADE: Colour = [235, 125, 20];

/// Side of a cell in the picture that suits, in pixels.
const CELL: usize = 40;

/// Width and height of the picture that suits.
pub fn size(map: &Map) -> [usize; 2] {
    [map.width * CELL, map.cells.len() / map.width * CELL]
}

/// Draws every pixel by where it lies in which cell.
pub fn draw(map: &Map, agent: usize, frame: &mut Frame<'_>) {
    let (width, height, shades) = (frame.width(), frame.height(), frame.shades());
    let rows = map.cells.len() / map.width;
    // The cell of a pixel, and where in the cell it lies, from −1 to 1.
    let place = |pixel: usize, pixels: usize, cells: usize| {
        let along = (pixel as f32 + 0.5) * cells as f32 / pixels as f32;
        (along as usize, 2.0 * along.fract() - 1.0)
    };
    for (index, pixel) in frame.pixels().as_chunks_mut::<3>().0.iter_mut().enumerate() {
        let (column, x) = place(index % width, width, map.width);
        let (row, y) = place(index / width, height, rows);
        let cell = row * map.width + column;
        *pixel = colour(map.cells[cell], shades.get(cell).copied(), cell == agent, [x, y]);
    }
}

/// A pixel at `[x, y]` in a cell, each from −1 to 1.
fn colour(kind: Cell, shade: Option<f32>, has_agent: bool, [x, y]: [f32; 2]) -> Colour {
    let (from_middle, to_edge) = (x.hypot(y), x.abs().max(y.abs()));
    let is_frame = to_edge > 0.78 && to_edge < 0.92;
    match kind {
        _ if to_edge > 0.96 => GRID,
        Cell::Wall => WALL,
        _ if has_agent && from_middle < 0.45 => AGENT,
        Cell::Start if is_frame => START,
        Cell::Goal | Cell::AbsorbingGoal if is_frame => GOAL,
        Cell::Absorbing | Cell::AbsorbingGoal if to_edge < 0.6 && (x.abs() - y.abs()).abs() < 0.16 => {
            ABSORBING
        }
        _ => shaded(shade),
    }
}

fn shaded(shade: Option<f32>) -> Colour {
    let share = shade.filter(|shade| shade.is_finite()).unwrap_or(0.0).clamp(0.0, 1.0);
    let mix = |from: u8, to: u8| (f32::from(from) + share * (f32::from(to) - f32::from(from))).round() as u8;
    std::array::from_fn(|channel| mix(FREE[channel], SHADE[channel]))
}
