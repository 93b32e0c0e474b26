//! Learners: agents that improve from experience.

use crate::{Checkpoint, Error, Result};

/// How an action is chosen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ActMode {
    /// With the learner's exploration noise.
    Explore,
    /// The best action that it knows. Draws no random number.
    Greedy,
}

/// What a learner says of itself.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LearnerInfo {
    /// How many Q-functions its ensemble has, at least 1.
    pub members: usize,
    /// γ, the factor by which the next step's value counts, in [0, 1].
    pub discount: f32,
}

/// A batch of transitions, drawn by the host from the experience that both agents share. Row-major, `size` rows each.
#[derive(Debug, Clone, Copy)]
pub struct Batch<'a> {
    /// How many transitions there are.
    pub size: usize,
    /// States, `size × observation_len`.
    pub observations: &'a [f32],
    /// Executed actions, `size × action_len`.
    pub actions: &'a [f32],
    /// This agent's rewards, `size`.
    pub rewards: &'a [f32],
    /// States that followed, `size × observation_len`.
    pub next_observations: &'a [f32],
    /// 1 where the next state's value counts, 0 where the transition ends for this agent; `size`. A time-out is a 1.
    pub continuations: &'a [f32],
    /// Bootstrap masks: 1 where the member learns from the transition, else 0; `size × members`.
    pub masks: &'a [f32],
}

/// An off-policy actor-critic with an ensemble of Q-functions, or anything that behaves like one.
///
/// It keeps no replay memory: the host owns the experience and shares it between both agents. An instance is called by one
/// thread at a time; after the first call of each method nothing is allocated.
///
/// ```standalone_crate
/// use shield_api::*;
///
/// shield_api::config! {
///     /// One value for everything: the simplest learner that is one.
///     pub struct MeanConfig {
///         /// Share of the way towards the target that one update goes.
///         rate: f32 = 0.1,
///     }
/// }
///
/// struct Mean { rate: f32, value: f32, action_len: usize }
///
/// impl Checkpoint for Mean {}
///
/// impl Plugin for Mean {
///     type Config = MeanConfig;
///
///     fn create(config: MeanConfig, setup: &Setup) -> Result<Self> {
///         Ok(Self { rate: config.rate, value: 0.0, action_len: setup.spaces()?.action_len() })
///     }
/// }
///
/// impl Learner for Mean {
///     fn info(&self) -> LearnerInfo {
///         LearnerInfo { members: 1, discount: 0.9 }
///     }
///
///     fn act(&mut self, _observation: &[f32], _mode: ActMode, action: &mut [f32]) -> Result<()> {
///         action.fill(0.0);
///         Ok(())
///     }
///
///     fn q_values(&mut self, _observation: &[f32], _action: &[f32], values: &mut [f32]) -> Result<()> {
///         values[0] = self.value;
///         Ok(())
///     }
///
///     fn q_gradients(
///         &mut self, observation: &[f32], action: &[f32], values: &mut [f32], gradients: &mut [f32],
///     ) -> Result<()> {
///         gradients[..self.action_len].fill(0.0);
///         self.q_values(observation, action, values)
///     }
///
///     fn update(&mut self, batch: &Batch<'_>) -> Result<()> {
///         for row in 0..batch.size {
///             let target = batch.rewards[row] + 0.9 * batch.continuations[row] * self.value;
///             self.value += self.rate * batch.masks[row] * (target - self.value);
///         }
///         Ok(())
///     }
/// }
///
/// shield_api::export_plugin! {
///     learner "acme/mean" => Mean { description: "The same value everywhere", deterministic: true }
/// }
/// # let spaces = Spaces { observation: Space::unbounded(1), action: Space::uniform(1, -1.0, 1.0) };
/// # let mut mean = Mean::create(MeanConfig::default(), &Setup::with_spaces(0, 1, Host::silent(), spaces)).unwrap();
/// # let batch = Batch { size: 1, observations: &[0.0], actions: &[0.0], rewards: &[1.0], next_observations: &[0.0],
/// #     continuations: &[1.0], masks: &[1.0] };
/// # mean.update(&batch).unwrap();
/// # let mut values = [0.0];
/// # mean.q_values(&[0.0], &[0.0], &mut values).unwrap();
/// # assert!(values[0] > 0.0);
/// ```
#[allow(unused_variables, reason = "the defaults name their arguments for whoever writes others")]
pub trait Learner: Checkpoint {
    /// What the learner is. Called once, before anything else; the answer must not change.
    fn info(&self) -> LearnerInfo;

    /// Writes an action for `observation`, inside the action space.
    ///
    /// # Errors
    /// A wrong length, or a value that is not finite.
    fn act(&mut self, observation: &[f32], mode: ActMode, action: &mut [f32]) -> Result<()>;

    /// Writes Q(s, a) of each member of the ensemble into `values` (`members`).
    ///
    /// # Errors
    /// A wrong length, or a value that is not finite.
    fn q_values(&mut self, observation: &[f32], action: &[f32], values: &mut [f32]) -> Result<()>;

    /// As [`q_values`](Self::q_values), and ∂Q/∂action of each member into `gradients` (`members × action_len`, row-major).
    ///
    /// # Errors
    /// [`ErrorKind::Unsupported`](crate::ErrorKind::Unsupported) by default: right for discrete actions.
    fn q_gradients(
        &mut self,
        observation: &[f32],
        action: &[f32],
        values: &mut [f32],
        gradients: &mut [f32],
    ) -> Result<()> {
        Err(Error::unsupported("the gradient of Q with respect to the action"))
    }

    /// Appends the weights, a file in the format [safetensors](https://github.com/huggingface/safetensors).
    ///
    /// # Errors
    /// [`ErrorKind::Unsupported`](crate::ErrorKind::Unsupported) by default.
    fn weights(&self, bytes: &mut Vec<u8>) -> Result<()> {
        Err(Error::unsupported("writing its weights"))
    }

    /// Appends the greedy policy as a model in [ONNX](https://onnx.ai): one input, a row that is an observation; one output, a row that is an action in
    /// the units of its space, or for discrete actions one value of each.
    ///
    /// # Errors
    /// [`ErrorKind::Unsupported`](crate::ErrorKind::Unsupported) by default.
    fn onnx(&self, bytes: &mut Vec<u8>) -> Result<()> {
        Err(Error::unsupported("writing its policy as ONNX"))
    }

    /// Improves the agent by one step on `batch`.
    ///
    /// # Errors
    /// A batch with a value that is not finite is refused, and nothing has changed.
    fn update(&mut self, batch: &Batch<'_>) -> Result<()>;
}
