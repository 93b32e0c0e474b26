//! A way home that was written by hand, judged by the shield. The robot is a cart on a table that slopes down from 0.6 towards its edge at 1: there
//! the way home is too weak. Nobody tells the shield; it learns from attempts that fail.
//!
//! ```console
//! $ cargo xtask build && SHIELD_PLUGIN_PATH=target/release cargo run --example reset_controller
//! ```
#![allow(clippy::print_stdout, reason = "an example")]

use shield_runtime::{
    controller::Controller,
    experiment::DropInFile,
    plugin::{Registry, SearchPath},
};

const SLOPE: f32 = 0.6;
const EDGE: f32 = 1.0;

/// The task is to go right.
fn policy(_position: f32) -> f32 {
    0.6
}

/// The way home: half of what the motor can do, towards 0.
fn go_home(position: f32) -> f32 {
    if position > 0.0 { -0.5 } else { 0.5 }
}

/// The robot: on the slope it slides, beyond the edge it lies on the floor.
fn execute(position: f32, action: f32) -> f32 {
    let slide = if position > SLOPE { 0.06 } else { 0.0 };
    if position < EDGE { position + 0.1 * action + slide } else { position }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let file = DropInFile::read(concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/c/controller.ron"), &[])?;
    let registry = Registry::scan(&SearchPath::from_environment());
    let controller = Controller::from_fn(|position, action| {
        action[0] = go_home(position[0]);
        Ok(())
    });
    let mut shield = file.open_with(&registry, None, controller)?;
    let mut position = 0.0;
    for _ in 0..6_000 {
        let mut action = [policy(position)];
        shield.filter(&[position], &mut action)?; // Whatever it decides, the buffer now holds what may be executed.
        position = execute(position, action[0]);
        shield.observe(&[position], None, position >= EDGE)?;
        if shield.needs_hard_reset() {
            position = 0.0; // Somebody carries it back.
            shield.hard_reset_done(&[position])?;
        }
    }
    shield.metrics(&mut |name, value| println!("{name:24} {value:.3}"));
    Ok(())
}
