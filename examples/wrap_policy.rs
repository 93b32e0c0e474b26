//! A policy and a robot of one's own, with a shield in between. The robot is a cart on a table: once it is beyond the edge, a person has to
//! carry it back.
//!
//! ```console
//! $ cargo xtask build && SHIELD_PLUGIN_PATH=target/release cargo run --example wrap_policy
//! ```
#![allow(clippy::print_stdout, reason = "an example")]

use shield_runtime::{
    experiment::DropInFile,
    plugin::{Registry, SearchPath},
};

const EDGE: f32 = 1.0;

/// The policy wants to go right.
fn policy(_position: f32) -> f32 {
    0.6
}

/// The robot: beyond the edge it lies on the floor and does not move any more.
fn execute(position: f32, action: f32) -> f32 {
    if position < EDGE { (position + 0.1 * action).max(-EDGE) } else { position }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let file = DropInFile::read(concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/c/cart.ron"), &[])?;
    let mut shield = file.open(&Registry::scan(&SearchPath::from_environment()), None)?;
    let mut position = 0.0;
    for _ in 0..6_000 {
        let mut action = [policy(position)];
        shield.filter(&[position], &mut action)?; // Whatever it decides, the buffer now holds what may be executed.
        position = execute(position, action[0]);
        shield.observe(&[position], None, false)?; // The reset agent learns.
        if shield.needs_hard_reset() {
            position = 0.0; // Somebody carries it back.
            shield.hard_reset_done(&[position])?;
        }
    }
    shield.metrics(&mut |name, value| println!("{name:24} {value:.3}"));
    Ok(())
}
