//! A loaded success critic.

use shield_api::{
    AttemptBatch, Result, Setup, Spaces, SuccessCritic, SuccessCriticInfo,
    abi::{
        AttemptBatchView, EXTENSION_SUCCESS_CRITIC, Floats, LearnerInfoView, LearnerTable, SuccessCriticTable,
    },
};

use super::handle::{Handle, checkpoint, described_wrongly, extension, spaces, while_creating};
use crate::plugin::PluginError;

/// A success critic behind the binary interface.
#[derive(Debug)]
pub struct LoadedSuccessCritic {
    handle: Handle,
    /// Its values are probabilities.
    table: &'static LearnerTable,
    learning: &'static SuccessCriticTable,
    info: SuccessCriticInfo,
    spaces: Spaces,
}

checkpoint!(LoadedSuccessCritic);

impl LoadedSuccessCritic {
    pub(in crate::plugin) fn create(
        id: &str,
        table: &'static LearnerTable,
        config: &str,
        setup: &Setup,
    ) -> Result<Self, PluginError> {
        let spaces = spaces(id, setup)?;
        // SAFETY: under this name a success critic gives this table.
        let learning = unsafe { extension(id, &table.life, EXTENSION_SUCCESS_CRITIC)? };
        let Some(learning) = learning else {
            let message =
                format!("it has no extension {EXTENSION_SUCCESS_CRITIC:?}, by which it would learn");
            return Err(described_wrongly(id, message));
        };
        let handle = Handle::create(id, &table.life, config, setup)?;
        let mut view = LearnerInfoView { members: 0, discount: f32::NAN };
        handle
            // SAFETY: the instance is of this table; the view lives for the call.
            .call(|instance| unsafe { (table.info)(instance, &mut view) })
            .map_err(|error| while_creating(id, &error))?;
        if view.members == 0 {
            return Err(described_wrongly(id, "`info` gives an ensemble of 0 members; it has at least one"));
        }
        let info = SuccessCriticInfo { members: view.members as usize };
        Ok(Self { handle, table, learning, info, spaces })
    }

    fn check_arguments(&self, observation: &[f32], action: &[f32], probabilities: &[f32]) -> Result<()> {
        self.handle.require_step(&self.spaces, observation, action)?;
        self.handle.require_length("probabilities", probabilities, self.info.members)
    }

    fn require_probabilities(&self, function: &str, probabilities: &[f32]) -> Result<()> {
        // Written so that NaN is refused.
        match probabilities.iter().find(|value| !(0.0..=1.0).contains(*value)) {
            None => Ok(()),
            Some(value) => Err(self.handle.broken(format!("`{function}` gave {value} for a probability"))),
        }
    }
}

impl SuccessCritic for LoadedSuccessCritic {
    fn info(&self) -> SuccessCriticInfo {
        self.info
    }

    fn probabilities(
        &mut self,
        observation: &[f32],
        action: &[f32],
        probabilities: &mut [f32],
    ) -> Result<()> {
        self.check_arguments(observation, action, probabilities)?;
        probabilities.fill(f32::NAN);
        // SAFETY: the instance is of this table; the slices are as long as said and live for the call.
        self.handle.call(|instance| unsafe {
            let (pointer, members) = (probabilities.as_mut_ptr(), probabilities.len());
            (self.table.q_values)(instance, Floats::new(observation), Floats::new(action), pointer, members)
        })?;
        self.require_probabilities("probabilities", probabilities)
    }

    fn gradients(
        &mut self,
        observation: &[f32],
        action: &[f32],
        probabilities: &mut [f32],
        gradients: &mut [f32],
    ) -> Result<()> {
        self.check_arguments(observation, action, probabilities)?;
        self.handle.require_length("gradients", gradients, self.info.members * action.len())?;
        probabilities.fill(f32::NAN);
        gradients.fill(f32::NAN);
        // SAFETY: the instance is of this table; the slices are as long as said and live for the call.
        self.handle.call(|instance| unsafe {
            (self.table.q_gradients)(
                instance,
                Floats::new(observation),
                Floats::new(action),
                probabilities.as_mut_ptr(),
                probabilities.len(),
                gradients.as_mut_ptr(),
                gradients.len(),
            )
        })?;
        self.require_probabilities("gradients", probabilities)?;
        self.handle.require_finite("gradients", "gradients", gradients)
    }

    fn update(&mut self, batch: &AttemptBatch<'_>) -> Result<()> {
        let size = batch.size;
        let [observation_len, action_len] = [self.spaces.observation_len(), self.spaces.action_len()];
        for (what, slice, width) in [
            ("observations", batch.observations, observation_len),
            ("actions", batch.actions, action_len),
            ("next_observations", batch.next_observations, observation_len),
            ("next_actions", batch.next_actions, action_len),
            ("successes", batch.successes, 1),
            ("continuations", batch.continuations, 1),
            ("outcomes", batch.outcomes, 1),
            ("outcome_weights", batch.outcome_weights, 1),
            ("masks", batch.masks, self.info.members),
        ] {
            self.handle.require_length(what, slice, size * width)?;
        }
        let view = AttemptBatchView {
            struct_size: size_of::<AttemptBatchView>(),
            size,
            observations: Floats::new(batch.observations),
            actions: Floats::new(batch.actions),
            next_observations: Floats::new(batch.next_observations),
            next_actions: Floats::new(batch.next_actions),
            successes: Floats::new(batch.successes),
            continuations: Floats::new(batch.continuations),
            outcomes: Floats::new(batch.outcomes),
            outcome_weights: Floats::new(batch.outcome_weights),
            masks: Floats::new(batch.masks),
        };
        // SAFETY: the instance is of this plugin; the batch lives for the call.
        self.handle.call(|instance| unsafe { (self.learning.update)(instance, &view) })
    }
}
