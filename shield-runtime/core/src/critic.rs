//! The success critic as the cycle sees it.

use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};
use shield_api::{ActMode, Learner, Result, Spaces, SuccessCritic, SuccessCriticInfo, metrics::Metrics};

use crate::{
    experience::{AttemptBuffers, Experience},
    plugin_state::PluginState,
};

/// The state of a success critic.
#[derive(Serialize, Deserialize)]
pub struct CriticState {
    /// Of the plugin.
    pub plugin: PluginState,
    sampler: Pcg64,
}

/// A success critic with what it needs to learn from the experience.
pub struct Critic {
    critic: Box<dyn SuccessCritic>,
    info: SuccessCriticInfo,
    buffers: AttemptBuffers,
    /// Draws the batches.
    sampler: Pcg64,
    metrics: Metrics,
}

impl Critic {
    /// Gives a critic its batches of `batch` transitions and its own stream of random numbers.
    pub fn new(critic: Box<dyn SuccessCritic>, batch: usize, spaces: &Spaces, sampler: Pcg64) -> Self {
        let info = critic.info();
        let buffers = AttemptBuffers::new(batch, spaces, info.members);
        Self { critic, info, buffers, sampler, metrics: Metrics::default() }
    }

    /// Ensemble size.
    pub fn info(&self) -> SuccessCriticInfo {
        self.info
    }

    /// The critic itself.
    pub fn critic(&mut self) -> &mut dyn SuccessCritic {
        &mut *self.critic
    }

    /// Lets its figures go to `metrics` from now on.
    pub fn report_to(&mut self, metrics: &Metrics) {
        self.metrics = metrics.clone();
    }

    /// What it has learned, to be kept.
    ///
    /// # Errors
    /// The plugin fails to save its state.
    pub fn save(&self) -> Result<CriticState> {
        Ok(CriticState { plugin: PluginState::of(&*self.critic)?, sampler: self.sampler.clone() })
    }

    /// Goes on from what was kept.
    ///
    /// # Errors
    /// The plugin refuses its state.
    pub fn restore(&mut self, state: &CriticState) -> Result<()> {
        state.plugin.restore(&mut *self.critic)?;
        self.sampler = state.sampler.clone();
        Ok(())
    }

    /// Updates from the experience, once it holds a batch, with what the reset agent does now.
    ///
    /// # Errors
    /// The critic or the reset agent failed.
    pub fn learn(&mut self, experience: &Experience, reset: &mut dyn Learner, updates: usize) -> Result<()> {
        if experience.len_for_undo() < self.buffers.size().max(1) {
            return Ok(());
        }
        self.metrics.collect_as("success", || {
            for _ in 0..updates {
                experience.sample_undo(&mut self.buffers, &mut self.sampler);
                let act =
                    |observation: &[f32], action: &mut [f32]| reset.act(observation, ActMode::Greedy, action);
                self.critic.update(&self.buffers.complete(act)?)?;
            }
            Ok(())
        })
    }
}
