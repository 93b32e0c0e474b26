//! Writes what `tests/peers/environments.py` compares with others' models: each robot without gravity and contacts, and how it moves.

use std::fmt::Write as _;
use std::path::Path;

use shield_api::PluginConfig;

use crate::scenery::on_stage;
use crate::simulation::Simulation;
use crate::suite::pseudo_random_actions;
use crate::task::{RobotConfig, Task};
use crate::{
    ball_in_cup::BallInCup, cliff_cheetah::CliffCheetah, cliff_walker::CliffWalker,
    half_cheetah::HalfCheetah, inverted_pendulum::InvertedPendulum, walker::Walker,
};

/// MuJoCo merges sections of the same name; the last value counts.
const WEIGHTLESS: &str =
    r#"<option gravity="0 0 0"><flag contact="disable" autoreset="disable"/></option></mujoco>"#;

/// One line per control step: the actions, then time, positions and velocities after it as the saved state has them.
fn free_motion(simulation: &mut Simulation, substeps: usize) -> String {
    let dimensions = simulation.controls().len();
    let state_length = 1 + simulation.positions().len() + simulation.velocities().len();
    let mut lines = String::new();
    for action in pseudo_random_actions(dimensions, 200) {
        simulation.advance(&action, substeps).unwrap();
        let mut bytes = Vec::new();
        simulation.save(&mut bytes);
        // MuJoCo's integration state begins with time, qpos, qvel.
        let (state, _) = bytes.as_chunks::<8>();
        let state = state[..state_length].iter().map(|value| f64::from_le_bytes(*value));
        let line: Vec<String> = action
            .iter()
            .map(|value| f64::from(*value))
            .chain(state)
            .map(|value| value.to_string())
            .collect();
        writeln!(lines, "{}", line.join(",")).unwrap();
    }
    lines
}

fn export<T: Task>(name: &str, folder: &Path) {
    let config = T::Config::parse("()").unwrap();
    let model = T::model(&config).replace("</mujoco>", WEIGHTLESS);
    let mut simulation = Simulation::new(&model).unwrap();
    std::fs::write(folder.join(name).with_extension("xml"), on_stage(&model)).unwrap();
    let lines = free_motion(&mut simulation, config.control_step());
    std::fs::write(folder.join(name).with_extension("csv"), lines).unwrap();
}

#[test]
#[ignore = "writes files for `cargo xtask test --peers`"]
fn export_for_peers() {
    let folder = std::env::var("SHIELD_PEERS_FOLDER").expect("`cargo xtask test --peers` sets it");
    let folder = Path::new(&folder);
    export::<HalfCheetah>("half-cheetah", folder);
    export::<CliffCheetah>("cliff-cheetah", folder);
    export::<Walker>("walker", folder);
    export::<CliffWalker>("cliff-walker", folder);
    export::<InvertedPendulum>("inverted-pendulum", folder);
    export::<BallInCup>("ball-in-cup", folder);
}
