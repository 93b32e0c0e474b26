//! Pictures of a simulation, drawn off-screen by OpenGL through EGL. The library of EGL is looked for only when the first picture is
//! drawn: a machine without it loads and steps every robot.

use std::cell::RefCell;

use mujoco_rs::prelude::{MjData, MjModel};
use mujoco_rs::renderer::MjRenderer;
use shield_api::{Error, Frame, Result};

/// The largest width and height; `stage` asks MuJoCo for room for so much.
const LARGEST: [usize; 2] = [1280, 960];

/// Where a picture is taken from.
#[derive(Debug, Clone, Copy)]
pub struct View {
    /// What is in the picture's middle, in the world.
    pub target: [f64; 3],
    /// From the target, in m.
    pub distance: f64,
    /// Of the line of sight, in degrees: at 90 it points along y, with x to the right.
    pub azimuth: f64,
    /// Of the line of sight, in degrees: negative looks down.
    pub elevation: f64,
}

impl View {
    /// From the front, a little from above: for robots that move in the plane of x and z.
    pub fn from_the_side(target: [f64; 3], distance: f64) -> Self {
        Self { target, distance, azimuth: 90.0, elevation: -8.0 }
    }
}

thread_local! {
    /// Belongs to its thread as OpenGL's contexts do, and serves every robot that is drawn there.
    static RENDERER: RefCell<Option<([usize; 2], MjRenderer)>> = const { RefCell::new(None) };
}

/// Draws the present positions. Alters only what follows from them, which the next step computes anew.
pub fn draw(data: &mut MjData<Box<MjModel>>, view: View, frame: &mut Frame<'_>) -> Result<()> {
    let size = [frame.width(), frame.height()];
    if size[0] > LARGEST[0] || size[1] > LARGEST[1] {
        return Err(Error::invalid_argument(format!(
            "a picture of {} × {} pixels is too large; at most {} × {}",
            size[0], size[1], LARGEST[0], LARGEST[1]
        )));
    }
    // A step leaves them where they were before its last integration.
    data.kinematics();
    data.com_pos();
    data.camlight();
    data.tendon_comp();
    RENDERER.with_borrow_mut(|kept| {
        if kept.as_ref().is_none_or(|(kept_size, _)| *kept_size != size) {
            // The old context goes first, else it would end the new one's being current.
            *kept = None;
            *kept = Some((size, open(data.model(), size)?));
        }
        let Some((_, renderer)) = kept else { return Err(Error::failed("no renderer was kept")) };
        let failed = |error: &dyn std::fmt::Display| Error::failed(format!("MuJoCo cannot draw: {error}"));
        let camera = renderer.camera_mut();
        (camera.lookat, camera.distance) = (view.target, view.distance);
        (camera.azimuth, camera.elevation) = (view.azimuth, view.elevation);
        renderer.sync_data(data).map_err(|error| failed(&error))?;
        renderer.render().map_err(|error| failed(&error))?;
        let drawn = renderer.rgb_flat().ok_or_else(|| Error::failed("MuJoCo drew no colours"))?;
        frame.pixels().copy_from_slice(drawn);
        Ok(())
    })
}

fn open(model: &MjModel, [width, height]: [usize; 2]) -> Result<MjRenderer> {
    MjRenderer::new(model, width, height, 0).map_err(|error| {
        Error::failed(format!(
            "this machine cannot draw off-screen: {error}. MuJoCo draws with OpenGL through EGL (on Debian: apt install libegl1 \
             libgl1-mesa-dri); stepping works without"
        ))
    })
}
