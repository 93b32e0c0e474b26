//! Environments: the world in which the agents act.

use crate::{
    Checkpoint, Error, Frame, Result, Spaces,
    abi::{StepView, step_flag},
};

/// What an environment says of itself.
#[derive(Debug, Clone, PartialEq)]
pub struct EnvironmentSpec {
    /// What the agents see and do.
    pub spaces: Spaces,
    /// The most steps of a forward episode and of a reset episode (the paper's `max_steps_per_episode`).
    pub episode_length: usize,
    /// Whether [`StepOutcome::reset_reward`] and [`StepOutcome::in_reset_set`] mean something. If not, the experiment
    /// must name a [`ResetTask`](crate::ResetTask).
    pub brings_reset_reward: bool,
}

/// A kind of hard reset, such as picking the robot up from the floor.
#[derive(Debug, Clone, PartialEq)]
pub struct ResetKind {
    /// Its name in the results.
    pub name: String,
    /// What one costs, in a unit of the environment's choice. Finite, not negative.
    pub cost: f64,
}

/// What a step led to, beside the observation.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct StepOutcome {
    /// Reward of the task, r_f(s, a) in the paper.
    pub forward_reward: f32,
    /// Reward of undoing the task, r_r(s) in the paper: large where initial states are likely. Within [0, 1], so that the reset value lies within
    /// [0, 1/(1−γ)] and Q_min can be chosen in advance; `shield env check` says so where it does not.
    pub reset_reward: f32,
    /// The new state is in S_reset: it counts as reset.
    pub in_reset_set: bool,
    /// The environment cannot go on from here; a hard reset must follow. Not used for irreversible states.
    pub terminated: bool,
    /// The task is achieved in the new state.
    pub success: bool,
    /// Ground truth: no action sequence leads back from here. For measuring only; no agent sees it.
    pub irreversible: bool,
}

impl From<StepOutcome> for StepView {
    fn from(outcome: StepOutcome) -> Self {
        let StepOutcome { forward_reward, reset_reward, in_reset_set, terminated, success, irreversible } =
            outcome;
        let bit = |is_set: bool, bit: u32| if is_set { bit } else { 0 };
        let flags = bit(in_reset_set, step_flag::IN_RESET_SET)
            | bit(terminated, step_flag::TERMINATED)
            | bit(success, step_flag::SUCCESS)
            | bit(irreversible, step_flag::IRREVERSIBLE);
        Self { forward_reward, reset_reward, flags }
    }
}

/// The error is the flags, if a bit of them means nothing.
impl TryFrom<StepView> for StepOutcome {
    type Error = u32;

    fn try_from(StepView { forward_reward, reset_reward, flags }: StepView) -> Result<Self, u32> {
        let is_set = |flag: u32| flags & flag != 0;
        let outcome = Self {
            forward_reward,
            reset_reward,
            in_reset_set: is_set(step_flag::IN_RESET_SET),
            terminated: is_set(step_flag::TERMINATED),
            success: is_set(step_flag::SUCCESS),
            irreversible: is_set(step_flag::IRREVERSIBLE),
        };
        if StepView::from(outcome).flags == flags { Ok(outcome) } else { Err(flags) }
    }
}

/// A world with observations, actions, a task and a way back.
///
/// An instance is called by one thread at a time. The host promises: [`reset`](Self::reset) comes before the first
/// [`step`](Self::step) and after each step that returned [`StepOutcome::terminated`]; every action it passes has the right
/// length, and was allowed by the shield or proposed by the reset agent.
///
/// ```standalone_crate
/// use shield_api::*;
///
/// shield_api::config! {
///     /// A point on a line; beyond 1 it falls off.
///     pub struct LineConfig {
///         /// How far one step leads.
///         stride: f32 = 0.1,
///     }
/// }
///
/// struct Line { stride: f32, position: f32 }
///
/// impl Checkpoint for Line {
///     fn save(&self, bytes: &mut Vec<u8>) -> Result<()> {
///         bytes.extend(self.position.to_le_bytes());
///         Ok(())
///     }
///
///     fn load(&mut self, bytes: &[u8]) -> Result<()> {
///         let bytes = bytes.try_into().map_err(|_| Error::invalid_argument("a saved line has 4 bytes"))?;
///         self.position = f32::from_le_bytes(bytes);
///         Ok(())
///     }
/// }
///
/// impl Plugin for Line {
///     type Config = LineConfig;
///
///     fn create(config: LineConfig, _setup: &Setup) -> Result<Self> {
///         Ok(Self { stride: config.stride, position: 0.0 })
///     }
/// }
///
/// impl Environment for Line {
///     fn spec(&self) -> EnvironmentSpec {
///         let spaces = Spaces { observation: Space::unbounded(1), action: Space::uniform(1, -1.0, 1.0) };
///         EnvironmentSpec { spaces, episode_length: 50, brings_reset_reward: true }
///     }
///
///     fn reset(&mut self, _seed: u64, observation: &mut [f32]) -> Result<()> {
///         self.position = 0.0;
///         observation[0] = 0.0;
///         Ok(())
///     }
///
///     fn step(&mut self, action: &[f32], observation: &mut [f32]) -> Result<StepOutcome> {
///         check_finite("action", action, 1)?;
///         if self.position <= 1.0 {
///             self.position += self.stride * action[0].clamp(-1.0, 1.0);
///         }
///         observation[0] = self.position;
///         Ok(StepOutcome {
///             forward_reward: self.position.clamp(0.0, 1.0),
///             reset_reward: 1.0 - self.position.abs().min(1.0),
///             in_reset_set: self.position.abs() < 0.1,
///             success: self.position > 0.9,
///             irreversible: self.position > 1.0,
///             ..StepOutcome::default()
///         })
///     }
/// }
///
/// shield_api::export_plugin! {
///     environment "acme/line" => Line { description: "A point on a line with an edge", deterministic: true }
/// }
///
/// let setup = Setup::new(0, 1, Host::silent());
/// let mut line = Line::create(LineConfig::default(), &setup).unwrap();
/// let mut observation = [f32::NAN];
/// line.reset(0, &mut observation).unwrap();
/// let outcome = line.step(&[1.0], &mut observation).unwrap();
/// assert!(!outcome.irreversible && observation[0] > 0.0);
/// ```
#[allow(unused_variables, reason = "the defaults name their arguments for whoever writes others")]
pub trait Environment: Checkpoint {
    /// What the environment is. Called once, before the first reset; the answer must not change.
    fn spec(&self) -> EnvironmentSpec;

    /// A hard reset: draws an initial state with `seed` and writes its observation. The same seed gives the same state.
    ///
    /// # Errors
    /// The environment could not be reset.
    fn reset(&mut self, seed: u64, observation: &mut [f32]) -> Result<()>;

    /// Executes `action` and writes the observation that follows. Allocates nothing.
    ///
    /// # Errors
    /// An action that is of the wrong length or not finite is refused, and the state is as before.
    fn step(&mut self, action: &[f32], observation: &mut [f32]) -> Result<StepOutcome>;

    /// Names of other initial states than the usual one, for [`reset_to`](Self::reset_to). None by default.
    fn starts(&self) -> Vec<String> {
        Vec::new()
    }

    /// A hard reset to one of [`starts`](Self::starts).
    ///
    /// # Errors
    /// There is no such start.
    fn reset_to(&mut self, start: &str, seed: u64, observation: &mut [f32]) -> Result<()> {
        Err(Error::invalid_argument(format!("this environment has no start named {start:?}")))
    }

    /// The kinds of hard reset, where they differ in what they cost. Called once; the answer must not change. None by default: every
    /// hard reset then costs the same.
    fn reset_kinds(&self) -> Vec<ResetKind> {
        Vec::new()
    }

    /// Which of [`reset_kinds`](Self::reset_kinds) a hard reset from the present state would be, as an index. Asked before a hard reset,
    /// and only where there are kinds.
    ///
    /// # Errors
    /// The environment cannot tell.
    fn reset_kind(&self) -> Result<usize> {
        Err(Error::unsupported("kinds of hard resets"))
    }

    /// Width and height in pixels of a picture that suits [`render`](Self::render).
    fn frame_size(&self) -> [usize; 2] {
        [320, 240]
    }

    /// Draws the present state. Changes nothing: with pictures or without, the environment goes on bit for bit the same.
    ///
    /// # Errors
    /// [`ErrorKind::Unsupported`](crate::ErrorKind::Unsupported) by default; the picture is too large, or this machine cannot draw.
    fn render(&mut self, frame: &mut Frame<'_>) -> Result<()> {
        Err(Error::unsupported("drawing"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_flag_crosses_the_interface_and_an_unknown_one_is_refused() {
        for flags in 0..16 {
            let view = StepView { forward_reward: 1.0, reset_reward: 2.0, flags };
            let outcome = StepOutcome::try_from(view).unwrap();
            let StepOutcome { in_reset_set, terminated, success, irreversible, .. } = outcome;
            assert_eq!((outcome.forward_reward, outcome.reset_reward), (1.0, 2.0));
            let bits = [(in_reset_set, 1), (terminated, 2), (success, 4), (irreversible, 8)];
            assert_eq!(bits.iter().filter(|(is_set, _)| *is_set).map(|(_, bit)| bit).sum::<u32>(), flags);
            assert_eq!(StepView::from(outcome).flags, flags);
        }
        assert_eq!(StepOutcome::try_from(StepView { flags: 17, ..StepView::default() }), Err(17));
    }
}
