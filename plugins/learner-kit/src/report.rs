//! What a learner reports of an update.

use actor_critic::CriticStep;
use shield_api::{Host, Result};

use crate::plugin_error;

/// What a step of the critics came to, over all of them.
#[derive(Debug, Clone, Copy)]
pub struct CriticReport {
    /// Their mean loss.
    pub loss: f64,
    /// Their mean value of the batch.
    pub value: f64,
}

impl CriticReport {
    /// Of these steps.
    ///
    /// # Errors
    /// A loss is not finite.
    pub fn of<'a>(steps: impl ExactSizeIterator<Item = &'a CriticStep> + Clone) -> Result<Self> {
        CriticStep::check(steps.clone()).map_err(plugin_error)?;
        let (loss, value) = CriticStep::means(steps);
        Ok(Self { loss, value })
    }

    /// Tells the host.
    pub fn send(&self, host: &Host) {
        host.metric("critic_loss", self.loss);
        host.metric("q_mean", self.value);
    }
}
