//! A loaded learner.

use shield_api::{
    ActMode, Batch, ErrorKind, Learner, LearnerInfo, Result, Setup, Spaces,
    abi::{BatchView, EXTENSION_WEIGHTS, Floats, LearnerInfoView, LearnerTable, WeightsTable, act_mode},
};

use super::handle::{Handle, checkpoint, described_wrongly, extension, spaces, while_creating};
use crate::plugin::PluginError;

/// A learner behind the binary interface.
#[derive(Debug)]
pub struct LoadedLearner {
    handle: Handle,
    table: &'static LearnerTable,
    weights_table: Option<&'static WeightsTable>,
    info: LearnerInfo,
    spaces: Spaces,
}

checkpoint!(LoadedLearner);

impl LoadedLearner {
    pub(in crate::plugin) fn create(
        id: &str,
        table: &'static LearnerTable,
        config: &str,
        setup: &Setup,
    ) -> Result<Self, PluginError> {
        let spaces = spaces(id, setup)?;
        let handle = Handle::create(id, &table.life, config, setup)?;
        let mut view = LearnerInfoView { members: 0, discount: f32::NAN };
        handle
            // SAFETY: the instance is of this table; the view lives for the call.
            .call(|instance| unsafe { (table.info)(instance, &mut view) })
            .map_err(|error| while_creating(id, &error))?;
        if view.members == 0 {
            return Err(described_wrongly(id, "`info` gives an ensemble of 0 members; it has at least one"));
        }
        if !(0.0..=1.0).contains(&view.discount) {
            let message = format!("`info` gives the discount {}, which is not in [0, 1]", view.discount);
            return Err(described_wrongly(id, message));
        }
        let info = LearnerInfo { members: view.members as usize, discount: view.discount };
        // SAFETY: under this name a plugin gives this table.
        let weights_table = unsafe { extension(id, &table.life, EXTENSION_WEIGHTS)? };
        Ok(Self { handle, table, weights_table, info, spaces })
    }

    fn weights_table(&self, what: &str) -> Result<&'static WeightsTable> {
        self.weights_table
            .ok_or_else(|| self.handle.error(ErrorKind::Unsupported, format!("{what} is not supported")))
    }

    fn check_arguments(&self, observation: &[f32], action: &[f32], values: &[f32]) -> Result<()> {
        self.handle.require_step(&self.spaces, observation, action)?;
        self.handle.require_length("values", values, self.info.members)
    }
}

impl Learner for LoadedLearner {
    fn info(&self) -> LearnerInfo {
        self.info
    }

    fn act(&mut self, observation: &[f32], mode: ActMode, action: &mut [f32]) -> Result<()> {
        self.handle.require_step(&self.spaces, observation, action)?;
        let mode = match mode {
            ActMode::Explore => act_mode::EXPLORE,
            ActMode::Greedy => act_mode::GREEDY,
        };
        action.fill(f32::NAN);
        // SAFETY: the instance is of this table; the slices are as long as said and live for the call.
        self.handle.call(|instance| unsafe {
            (self.table.act)(instance, Floats::new(observation), mode, action.as_mut_ptr(), action.len())
        })?;
        self.handle.require_finite("act", "action", action)
    }

    fn q_values(&mut self, observation: &[f32], action: &[f32], values: &mut [f32]) -> Result<()> {
        self.check_arguments(observation, action, values)?;
        values.fill(f32::NAN);
        // SAFETY: the instance is of this table; the slices are as long as said and live for the call.
        self.handle.call(|instance| unsafe {
            let (pointer, members) = (values.as_mut_ptr(), values.len());
            (self.table.q_values)(instance, Floats::new(observation), Floats::new(action), pointer, members)
        })?;
        self.handle.require_finite("q_values", "values", values)
    }

    fn q_gradients(
        &mut self,
        observation: &[f32],
        action: &[f32],
        values: &mut [f32],
        gradients: &mut [f32],
    ) -> Result<()> {
        self.check_arguments(observation, action, values)?;
        self.handle.require_length("gradients", gradients, self.info.members * action.len())?;
        values.fill(f32::NAN);
        gradients.fill(f32::NAN);
        // SAFETY: the instance is of this table; the slices are as long as said and live for the call.
        self.handle.call(|instance| unsafe {
            (self.table.q_gradients)(
                instance,
                Floats::new(observation),
                Floats::new(action),
                values.as_mut_ptr(),
                values.len(),
                gradients.as_mut_ptr(),
                gradients.len(),
            )
        })?;
        self.handle.require_finite("q_gradients", "values", values)?;
        self.handle.require_finite("q_gradients", "gradients", gradients)
    }

    fn weights(&self, bytes: &mut Vec<u8>) -> Result<()> {
        let table = self.weights_table("writing its weights")?;
        // SAFETY: instance and table are of the same plugin.
        self.handle.written(bytes, |instance, writer| unsafe { (table.weights)(instance, writer) })
    }

    fn onnx(&self, bytes: &mut Vec<u8>) -> Result<()> {
        let table = self.weights_table("writing its policy as ONNX")?;
        // SAFETY: as above.
        self.handle.written(bytes, |instance, writer| unsafe { (table.policy)(instance, writer) })
    }

    fn update(&mut self, batch: &Batch<'_>) -> Result<()> {
        let (size, observation_len) = (batch.size, self.spaces.observation_len());
        for (what, slice, width) in [
            ("observations", batch.observations, observation_len),
            ("actions", batch.actions, self.spaces.action_len()),
            ("rewards", batch.rewards, 1),
            ("next_observations", batch.next_observations, observation_len),
            ("continuations", batch.continuations, 1),
            ("masks", batch.masks, self.info.members),
        ] {
            self.handle.require_length(what, slice, size * width)?;
        }
        let view = BatchView {
            struct_size: size_of::<BatchView>(),
            size,
            observations: Floats::new(batch.observations),
            actions: Floats::new(batch.actions),
            rewards: Floats::new(batch.rewards),
            next_observations: Floats::new(batch.next_observations),
            continuations: Floats::new(batch.continuations),
            masks: Floats::new(batch.masks),
        };
        // SAFETY: the instance is of this table; the batch lives for the call.
        self.handle.call(|instance| unsafe { (self.table.update)(instance, &view) })
    }
}
