//! What robots stand on: models of the ground, added to those of the robots.

use shield_api::{Error, Result};

/// A plane at z = 0, as far as one can run.
const PLANE: &str =
    r#"<geom name="floor" type="plane" size="40 40 40" conaffinity="1" rgba="0.6 0.6 0.6 1"/>"#;

/// A table of rock with a wall behind it, at x = −2, and a pit of 2 m before it. The pit's far wall is as high as the one behind:
/// nothing leads out.
#[derive(Debug, Clone, Copy)]
pub struct Cliff {
    /// Where it ends and the pit begins (x in m).
    pub edge: f64,
    /// Height of the top (z in m).
    pub top: f64,
    /// Height of the pit's bottom (z in m).
    pub bottom: f64,
}

impl Cliff {
    /// The robot's model with this cliff.
    pub fn under(self, robot: &str) -> String {
        let Self { edge, top, bottom } = self;
        let below = bottom - 0.2;
        let boxes = [
            ("cliff", [(edge - 2.0) / 2.0, (top + below) / 2.0], [(edge + 2.0) / 2.0, (top - below) / 2.0]),
            ("back_wall", [-2.1, (3.0 + below) / 2.0], [0.1, (3.0 - below) / 2.0]),
            ("pit_floor", [edge + 1.0, bottom - 0.1], [1.0, 0.1]),
            ("far_wall", [edge + 2.1, (3.0 + below) / 2.0], [0.1, (3.0 - below) / 2.0]),
        ];
        let geoms = boxes.map(|(name, [x, z], [half_length, half_height])| {
            format!(
                r#"<geom name="{name}" type="box" pos="{x} 0 {z}" size="{half_length} 0.2 {half_height}" conaffinity="1" rgba="0.6 0.6 0.6 1"/>"#
            )
        });
        with_scenery(robot, &geoms.concat())
    }
}

/// The robot's model on a plane.
pub fn on_plane(robot: &str) -> String {
    with_scenery(robot, PLANE)
}

/// MuJoCo merges sections of the same name, so another `worldbody` may follow the robot's.
fn with_scenery(robot: &str, geoms: &str) -> String {
    robot.replace("</mujoco>", &format!("<worldbody>{geoms}</worldbody></mujoco>"))
}

/// Refuses a cliff whose edge is in the reset set or nowhere.
///
/// # Errors
/// [`ErrorKind::InvalidConfig`](shield_api::ErrorKind::InvalidConfig), naming the value.
pub fn check_cliff_length(length: f64) -> Result<()> {
    let is_valid = (1.0..=1_000.0).contains(&length);
    if is_valid {
        Ok(())
    } else {
        Err(Error::invalid_config(format!("cliff_length is {length}; it must be from 1 to 1000 m")))
    }
}
