//! How robots move without gravity and contacts. `cargo xtask test --peers` has it written, with the models, for
//! `tests/peers/environments.py` to compare with others' models.

use std::fmt::Write as _;
use std::path::Path;

use shield_api::PluginConfig;

use crate::scenery::on_stage;
use crate::simulation::Simulation;
use crate::task::{RobotConfig, Task};
use crate::testing::pseudo_random_actions;
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

/// Writes model and motion too, if a folder is named.
fn check<T: Task>(name: &str) {
    let config = T::Config::parse("()").unwrap();
    let model = T::model(&config).replace("</mujoco>", WEIGHTLESS);
    let motion = || free_motion(&mut Simulation::new(&model).unwrap(), config.control_step());
    let lines = motion();
    assert_eq!(lines, motion(), "{name}");
    assert!(
        lines.trim_end().split([',', '\n']).all(|number| number.parse().is_ok_and(f64::is_finite)),
        "{name}"
    );
    if let Some(folder) = std::env::var_os("SHIELD_PEERS_FOLDER") {
        let file = Path::new(&folder).join(name);
        std::fs::write(file.with_extension("xml"), on_stage(&model)).unwrap();
        std::fs::write(file.with_extension("csv"), lines).unwrap();
    }
}

#[test]
fn free_motion_is_finite_and_repeats_exactly() {
    check::<HalfCheetah>("half-cheetah");
    check::<CliffCheetah>("cliff-cheetah");
    check::<Walker>("walker");
    check::<CliffWalker>("cliff-walker");
    check::<InvertedPendulum>("inverted-pendulum");
    check::<BallInCup>("ball-in-cup");
}
