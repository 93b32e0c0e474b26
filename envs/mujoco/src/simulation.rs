//! A model and its state: stepping, placing, keeping. Knows no task.

use mujoco_rs::prelude::{MjData, MjModel, MjtState};
use shield_api::{Error, Frame, Result, Space, check_finite};

use crate::picture::{self, View};
use crate::scenery::on_stage;

/// Everything that the next step depends on, the solver's warm start included: with it, a simulation continues bit for bit.
const FULL_STATE: u32 = MjtState::mjSTATE_INTEGRATION as u32;

/// From here on MuJoCo itself calls a position or velocity bad (`mjMAXVAL`).
const DIVERGED: f64 = 1e10;

/// A MuJoCo model with its current state.
pub struct Simulation {
    data: MjData<Box<MjModel>>,
    /// Lowest and highest control of each actuator.
    control_range: Vec<[f64; 2]>,
    /// Generalised positions before the last action.
    positions_before: Vec<f64>,
}

impl Simulation {
    /// Compiles a model, on its stage, and places it in its default pose.
    ///
    /// # Errors
    /// The model does not compile, or there is no memory for it.
    pub fn new(xml: &str) -> Result<Self> {
        let failed =
            |error: &dyn std::fmt::Display| Error::failed(format!("MuJoCo refuses the model: {error}"));
        let model = MjModel::from_xml_string(&on_stage(xml)).map_err(|error| failed(&error))?;
        let control_range = model.actuator_ctrlrange().to_vec();
        let data = MjData::try_new(Box::new(model)).map_err(|error| failed(&error))?;
        let mut simulation = Self { positions_before: data.qpos().to_vec(), data, control_range };
        simulation.reset(|_, _| ());
        Ok(simulation)
    }

    /// Generalised positions, one per joint.
    pub fn positions(&self) -> &[f64] {
        self.data.qpos()
    }

    /// Generalised velocities, one per joint.
    pub fn velocities(&self) -> &[f64] {
        self.data.qvel()
    }

    /// The last action, clipped to the actuators' ranges.
    pub fn controls(&self) -> &[f64] {
        self.data.ctrl()
    }

    /// Where the model's site of this number is, in the world. Not known after [`load`](Self::load) until the next step.
    pub fn site(&self, index: usize) -> [f64; 3] {
        self.data.site_xpos()[index]
    }

    /// Sum of the squares of the last action.
    pub fn squared_control(&self) -> f64 {
        self.controls().iter().map(|control| control * control).sum()
    }

    /// How fast the first joint moved on average during the last action, which was held for `substeps`.
    pub fn mean_speed(&self, substeps: usize) -> f64 {
        let seconds = self.data.model().ffi().opt.timestep * substeps as f64;
        (self.positions()[0] - self.positions_before[0]) / seconds
    }

    /// The actuators' ranges of control.
    pub fn action_space(&self) -> Space {
        let bound = |index: usize| self.control_range.iter().map(|range| range[index] as f32).collect();
        Space::Box { low: bound(0), high: bound(1) }
    }

    /// Returns to the default pose at rest, which `place` may then alter: it is given positions and velocities.
    pub fn reset(&mut self, place: impl FnOnce(&mut [f64], &mut [f64])) {
        self.data.reset();
        let (mut positions, mut velocities) = (self.data.qpos().to_vec(), self.data.qvel().to_vec());
        place(&mut positions, &mut velocities);
        self.data.qpos_mut().copy_from_slice(&positions);
        self.data.qvel_mut().copy_from_slice(&velocities);
        self.update_sites();
    }

    /// Holds `action`, clipped to the actuators' ranges, for `substeps` of the model's time step.
    ///
    /// # Errors
    /// An action of the wrong length or that is not finite is refused, and the state is as before. A simulation that diverges
    /// is an error until the next reset.
    pub fn advance(&mut self, action: &[f32], substeps: usize) -> Result<()> {
        check_finite("action", action, self.control_range.len())?;
        for ((control, value), [low, high]) in
            self.data.ctrl_mut().iter_mut().zip(action).zip(&self.control_range)
        {
            *control = f64::from(*value).clamp(*low, *high);
        }
        self.positions_before.copy_from_slice(self.data.qpos());
        for _ in 0..substeps {
            self.data.step();
        }
        self.update_sites();
        let mut state = self.positions().iter().chain(self.velocities());
        // NaN is not below the bound either.
        if state.all(|value| value.abs() < DIVERGED) {
            Ok(())
        } else {
            Err(Error::failed("the simulation diverged; only a hard reset leads on"))
        }
    }

    /// A step of the model leaves the sites where they were before it.
    fn update_sites(&mut self) {
        if !self.data.site_xpos().is_empty() {
            self.data.kinematics();
        }
    }

    /// Draws the present state and leaves it as it is.
    ///
    /// # Errors
    /// The picture is too large, or this machine cannot draw.
    pub fn draw(&mut self, view: View, frame: &mut Frame<'_>) -> Result<()> {
        picture::draw(&mut self.data, view, frame)
    }

    /// Appends the full state.
    pub fn save(&self, bytes: &mut Vec<u8>) {
        bytes.extend(self.data.state(FULL_STATE).iter().flat_map(|value| value.to_le_bytes()));
    }

    /// Restores what [`save`](Self::save) appended. On an error the state is as before.
    ///
    /// # Errors
    /// The length is wrong, or a value is not finite.
    pub fn load(&mut self, bytes: &[u8]) -> Result<()> {
        let (values, rest) = bytes.as_chunks::<8>();
        let state: Vec<f64> = values.iter().map(|value| f64::from_le_bytes(*value)).collect();
        let expected = self.data.model().state_size(FULL_STATE);
        if state.len() != expected || !rest.is_empty() || state.iter().any(|value| !value.is_finite()) {
            return Err(Error::invalid_argument(format!(
                "a state of this model is {expected} finite numbers"
            )));
        }
        self.data.set_state(&state, FULL_STATE).map_err(|error| Error::failed(error.to_string()))
    }

    /// Simulated seconds since the last reset.
    #[cfg(test)]
    pub fn time(&self) -> f64 {
        self.data.time()
    }

    /// The compiled model, to compare with published figures.
    #[cfg(test)]
    pub fn model(&self) -> &MjModel {
        self.data.model()
    }
}
