//! The two agents as the loop sees them.

use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};
use shield_api::{ActMode, Learner, LearnerInfo, Policy, Result, Spaces, metrics::Metrics};

use crate::{
    experience::{AgentRole, BatchBuffers, Experience},
    plugin_state::PluginState,
};

/// The state of an agent or a policy.
#[derive(Serialize, Deserialize)]
pub struct AgentState {
    /// Of the learner or the policy.
    pub plugin: PluginState,
    /// `None` for a policy.
    sampler: Option<Pcg64>,
}

/// A learner with what it needs to learn from the experience.
pub struct Agent {
    role: AgentRole,
    learner: Box<dyn Learner>,
    info: LearnerInfo,
    buffers: BatchBuffers,
    /// Draws the batches.
    sampler: Pcg64,
    metrics: Metrics,
}

impl Agent {
    /// Gives a learner its role, its batches of `batch` transitions and its own stream of random numbers.
    pub fn new(
        role: AgentRole,
        learner: Box<dyn Learner>,
        batch: usize,
        spaces: &Spaces,
        sampler: Pcg64,
    ) -> Self {
        let info = learner.info();
        let buffers = BatchBuffers::new(batch, spaces, info.members);
        Self { role, learner, info, buffers, sampler, metrics: Metrics::default() }
    }

    /// Ensemble size and discount.
    pub fn info(&self) -> LearnerInfo {
        self.info
    }

    /// Whether it values actions and learns. A [reset controller](crate::controller) does neither.
    pub fn learns(&self) -> bool {
        self.info.members > 0
    }

    /// The learner itself.
    pub fn learner(&mut self) -> &mut dyn Learner {
        &mut *self.learner
    }

    /// What its learner reports while it learns, each name preceded by the agent's role, such as `reset/critic_loss`.
    pub fn metrics(&self) -> &Metrics {
        &self.metrics
    }

    /// Lets its figures go to `metrics` from now on.
    pub fn report_to(&mut self, metrics: &Metrics) {
        self.metrics = metrics.clone();
    }

    /// What it has learned, to be kept.
    ///
    /// # Errors
    /// The plugin fails to save its state.
    pub fn save(&self) -> Result<AgentState> {
        let plugin = PluginState::of(&*self.learner)?;
        Ok(AgentState { plugin, sampler: Some(self.sampler.clone()) })
    }

    /// Goes on from what was kept.
    ///
    /// # Errors
    /// The plugin refuses its state.
    pub fn restore(&mut self, state: &AgentState) -> Result<()> {
        state.plugin.restore(&mut *self.learner)?;
        if let Some(sampler) = &state.sampler {
            self.sampler = sampler.clone();
        }
        Ok(())
    }

    /// Updates from the experience, once it holds a batch for this agent, if it [learns](Self::learns).
    ///
    /// # Errors
    /// The learner failed.
    pub fn learn(&mut self, experience: &Experience, updates: usize) -> Result<()> {
        if !self.learns() || experience.len_for(self.role) < self.buffers.size().max(1) {
            return Ok(());
        }
        self.metrics.collect_as(self.role.name(), || {
            for _ in 0..updates {
                let batch = experience.sample(self.role, &mut self.buffers, &mut self.sampler);
                self.learner.update(&batch)?;
            }
            Ok(())
        })
    }
}

/// Who does the task: an agent that learns, or a finished policy.
pub enum ForwardAgent {
    /// Learns.
    Learner(Box<Agent>),
    /// Does not.
    Policy(Box<dyn Policy>),
}

impl ForwardAgent {
    /// Proposes an action.
    ///
    /// # Errors
    /// The plugin failed.
    pub fn act(&mut self, observation: &[f32], mode: ActMode, action: &mut [f32]) -> Result<()> {
        match self {
            Self::Learner(agent) => agent.learner.act(observation, mode, action),
            Self::Policy(policy) => policy.act(observation, action),
        }
    }

    /// What values the task; `None` for a policy.
    pub fn learner(&mut self) -> Option<&mut dyn Learner> {
        match self {
            Self::Learner(agent) => Some(&mut *agent.learner),
            Self::Policy(_) => None,
        }
    }

    /// The forward ensemble's size; 0 for a policy, which has none.
    pub fn members(&self) -> usize {
        match self {
            Self::Learner(agent) => agent.info.members,
            Self::Policy(_) => 0,
        }
    }

    /// Lets the figures of a learner go to `metrics` from now on.
    pub fn report_to(&mut self, metrics: &Metrics) {
        match self {
            Self::Learner(agent) => agent.report_to(metrics),
            Self::Policy(_) => {}
        }
    }

    /// What it has learned, to be kept.
    ///
    /// # Errors
    /// The plugin fails to save its state.
    pub fn save(&self) -> Result<AgentState> {
        match self {
            Self::Learner(agent) => agent.save(),
            Self::Policy(policy) => Ok(AgentState { plugin: PluginState::of(&**policy)?, sampler: None }),
        }
    }

    /// Goes on from what was kept.
    ///
    /// # Errors
    /// The plugin refuses its state.
    pub fn restore(&mut self, state: &AgentState) -> Result<()> {
        match self {
            Self::Learner(agent) => agent.restore(state),
            Self::Policy(policy) => state.plugin.restore(&mut **policy),
        }
    }

    /// Updates from the experience; a policy does nothing.
    ///
    /// # Errors
    /// The plugin failed.
    pub fn learn(&mut self, experience: &Experience, updates: usize) -> Result<()> {
        match self {
            Self::Learner(agent) => agent.learn(experience, updates),
            Self::Policy(_) => Ok(()),
        }
    }
}
