//! A learner with an actor and critics, around its update: acting, valuing and saving are the same whatever the update is.

use actor_critic::{AgentSettings, Policy, PolicyAgent};
use shield_api::{
    ActMode, Batch, Checkpoint, Error, Host, Learner, LearnerInfo, Plugin, PluginConfig, Result, Setup,
};

use crate::plugin_error;

/// The settings of such a learner.
pub trait AgentConfig: PluginConfig + Send {
    /// How a saved state begins, whoever computes the networks.
    const MAGIC: &'static [u8];

    /// What the learner says of itself.
    fn info(&self) -> LearnerInfo;

    /// The agent that these settings describe.
    ///
    /// # Errors
    /// A setting that cannot be, or an action space that is not a box.
    fn agent<'a>(&'a self, setup: &Setup) -> Result<AgentSettings<'a>>;
}

/// An agent's networks, and who computes them. The errors are those of [`Learner`].
#[allow(missing_docs, reason = "each method is what the learner's of the same name is")]
pub trait Backend: Send + Sized + 'static {
    fn new(settings: AgentSettings<'_>) -> Result<Self>;

    fn act(&mut self, observation: &[f32], explores: bool, action: &mut [f32]) -> Result<()>;

    fn value(
        &mut self,
        observation: &[f32],
        action: &[f32],
        values: &mut [f32],
        gradients: Option<&mut [f32]>,
    ) -> Result<()>;

    fn weights(&self, _bytes: &mut Vec<u8>) -> Result<()> {
        Err(Error::unsupported("writing its weights"))
    }

    fn onnx(&self, _bytes: &mut Vec<u8>) -> Result<()> {
        Err(Error::unsupported("writing its policy as ONNX"))
    }

    fn save(&self, magic: &[u8], bytes: &mut Vec<u8>) -> Result<()>;

    fn load(&mut self, magic: &[u8], bytes: &[u8]) -> Result<()>;
}

/// How such a learner learns, with what is kept for it between updates.
pub trait Update: Send + Sized + 'static {
    /// The learner's configuration.
    type Config: AgentConfig;

    /// Who computes its networks.
    type Agent: Backend;

    /// Before the first update.
    fn new(config: &Self::Config) -> Self;

    /// One update.
    ///
    /// # Errors
    /// As [`Learner::update`].
    fn learn(
        &mut self,
        config: &Self::Config,
        agent: &mut Self::Agent,
        batch: &Batch<'_>,
        host: &Host,
    ) -> Result<()>;
}

/// The learner that learns by the update `U`.
pub struct ActorCritic<U: Update> {
    /// Its networks.
    pub agent: U::Agent,
    /// How it learns.
    pub update: U,
    config: U::Config,
    host: Host,
}

impl<U: Update> Plugin for ActorCritic<U> {
    type Config = U::Config;

    fn create(config: U::Config, setup: &Setup) -> Result<Self> {
        let agent = U::Agent::new(config.agent(setup)?)?;
        Ok(Self { agent, update: U::new(&config), config, host: setup.host })
    }
}

impl<U: Update> Learner for ActorCritic<U> {
    fn info(&self) -> LearnerInfo {
        self.config.info()
    }

    fn act(&mut self, observation: &[f32], mode: ActMode, action: &mut [f32]) -> Result<()> {
        self.agent.act(observation, mode == ActMode::Explore, action)
    }

    fn q_values(&mut self, observation: &[f32], action: &[f32], values: &mut [f32]) -> Result<()> {
        self.agent.value(observation, action, values, None)
    }

    fn q_gradients(
        &mut self,
        observation: &[f32],
        action: &[f32],
        values: &mut [f32],
        gradients: &mut [f32],
    ) -> Result<()> {
        self.agent.value(observation, action, values, Some(gradients))
    }

    fn weights(&self, bytes: &mut Vec<u8>) -> Result<()> {
        self.agent.weights(bytes)
    }

    fn onnx(&self, bytes: &mut Vec<u8>) -> Result<()> {
        self.agent.onnx(bytes)
    }

    fn update(&mut self, batch: &Batch<'_>) -> Result<()> {
        self.update.learn(&self.config, &mut self.agent, batch, &self.host)
    }
}

impl<U: Update> Checkpoint for ActorCritic<U> {
    fn save(&self, bytes: &mut Vec<u8>) -> Result<()> {
        self.agent.save(U::Config::MAGIC, bytes)
    }

    fn load(&mut self, bytes: &[u8]) -> Result<()> {
        self.agent.load(U::Config::MAGIC, bytes)
    }
}

impl<P: Policy> Backend for PolicyAgent<P> {
    fn new(settings: AgentSettings<'_>) -> Result<Self> {
        Self::new(settings).map_err(plugin_error)
    }

    fn act(&mut self, observation: &[f32], explores: bool, action: &mut [f32]) -> Result<()> {
        self.act(observation, explores, action).map_err(plugin_error)
    }

    fn value(
        &mut self,
        observation: &[f32],
        action: &[f32],
        values: &mut [f32],
        gradients: Option<&mut [f32]>,
    ) -> Result<()> {
        self.value(observation, action, values, gradients).map_err(plugin_error)
    }

    fn weights(&self, bytes: &mut Vec<u8>) -> Result<()> {
        self.write_weights(bytes).map_err(plugin_error)
    }

    fn onnx(&self, bytes: &mut Vec<u8>) -> Result<()> {
        self.write_onnx(bytes);
        Ok(())
    }

    fn save(&self, magic: &[u8], bytes: &mut Vec<u8>) -> Result<()> {
        self.save(magic, bytes).map_err(plugin_error)
    }

    fn load(&mut self, magic: &[u8], bytes: &[u8]) -> Result<()> {
        self.load(magic, bytes).map_err(plugin_error)
    }
}
