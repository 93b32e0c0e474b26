//! What surrounds robots: models of the ground, and the stage on which pictures of them are taken.

use shield_api::{Error, Result};

/// A plane at z = 0, as far as one can run.
const PLANE: &str = r#"<geom name="floor" type="plane" size="40 40 40" conaffinity="1" material="ground"/>"#;

/// Light, sky and the ground's checks. Weightless and without contacts: for pictures alone.
const STAGE: &str = r#"
  <visual>
    <headlight ambient="0.4 0.4 0.4" diffuse="0.4 0.4 0.4" specular="0.1 0.1 0.1"/>
    <global offwidth="1280" offheight="960"/>
  </visual>
  <asset>
    <texture name="sky" type="skybox" builtin="gradient" rgb1="0.75 0.85 0.95" rgb2="1 1 1" width="64" height="64"/>
    <texture name="ground" type="2d" builtin="checker" rgb1="0.55 0.57 0.6" rgb2="0.63 0.65 0.68" width="64" height="64"/>
    <material name="ground" texture="ground" texrepeat="1 1" texuniform="true"/>
  </asset>
  <worldbody>
    <light directional="true" pos="0 -2 4" dir="0.3 0.5 -1" diffuse="0.4 0.4 0.4" castshadow="false"/>
  </worldbody>
"#;

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
                r#"<geom name="{name}" type="box" pos="{x} 0 {z}" size="{half_length} 0.2 {half_height}" conaffinity="1" material="ground"/>"#
            )
        });
        with_section(robot, &format!("<worldbody>{}</worldbody>", geoms.concat()))
    }
}

/// The robot's model on a plane.
pub fn on_plane(robot: &str) -> String {
    with_section(robot, &format!("<worldbody>{PLANE}</worldbody>"))
}

/// A model with light, sky and colours for pictures of it.
pub fn on_stage(model: &str) -> String {
    with_section(model, STAGE)
}

/// MuJoCo merges sections of the same name, so another `worldbody` may follow the robot's.
fn with_section(model: &str, section: &str) -> String {
    model.replace("</mujoco>", &format!("{section}</mujoco>"))
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
        let message = format!("cliff_length is {length}; it must be from 1 to 1000 m");
        Err(Error::invalid_config(message).in_field("cliff_length"))
    }
}
