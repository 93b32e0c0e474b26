#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod action_scale;
mod adam;
mod agent;
mod architecture;
mod batch_renorm;
mod body;
mod checkpoint;
mod checks;
mod critic_step;
mod deterministic;
mod dropout;
mod ensemble;
mod gaussian;
mod half;
mod kernels;
mod layer;
mod layer_norm;
mod loss;
mod member;
mod noise;
mod normaliser;
mod onnx;
mod pass;
mod real;
mod state;
mod tensors;
mod workspace;

pub use action_scale::ActionScale;
pub use adam::Adam;
pub use agent::{AgentSettings, Policy, PolicyAgent, Valuation, smaller};
pub use architecture::{Activation, Architecture, Initialisation, Regularisation};
pub use batch_renorm::BatchRenorm;
pub use body::{Body, Buffers};
pub use checkpoint::{read_state, write_state};
pub use checks::{
    check_below_one, check_finite_output, check_finite_setting, check_layers, check_not_negative,
    check_positive, check_share, check_unit,
};
pub use critic_step::CriticStep;
pub use deterministic::{Agent, Deterministic, PolicyStep};
pub use ensemble::{Ensemble, EnsembleState};
pub use gaussian::{Draws, Gaussian, LOG_DEVIATION, SmallestGradients, SoftAgent, SoftStep};
pub use loss::{Loss, cross_entropy, sigmoid};
pub use member::{Group, Member};
pub use noise::{Noise, NoiseProcess, Schedule};
pub use normaliser::Normaliser;
pub use real::Real;
pub use state::{AgentState, BodyState};
pub use tensors::{Tensor, write_tensors};

/// What cannot be built or restored.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// A network needs at least one hidden layer, none of them empty, and something to see.
    #[error("a network with {inputs} inputs and the hidden layers {hidden:?} cannot be built")]
    Shape {
        /// Observation length.
        inputs: usize,
        /// Sizes of the hidden layers.
        hidden: Vec<usize>,
    },
    /// An ensemble needs a member.
    #[error("an ensemble needs at least one member")]
    NoMembers,
    /// The threads could not be started.
    #[error("the threads could not be started: {0}")]
    Threads(String),
    /// The state belongs to something of another shape.
    #[error("the saved state has {found} values, expected {expected}")]
    StateLength {
        /// Values in the state.
        found: usize,
        /// Values that belong there.
        expected: usize,
    },
    /// A saved value is NaN or infinite.
    #[error("the saved state holds a value that is not finite")]
    StateNotFinite,
    /// The bytes are not a state of this learner.
    #[error("not a state of this learner: {0}")]
    ForeignState(String),
    /// Whoever computes the networks has failed.
    #[error("{0}")]
    Backend(String),
    /// The weights cannot be written for others.
    #[error("the weights cannot be written: {0}")]
    Tensors(String),
    /// A setting has a value that cannot be.
    #[error("{name} is {value}; it must be {allowed}")]
    Setting {
        /// The setting's name.
        name: &'static str,
        /// Its value.
        value: f64,
        /// What it may be.
        allowed: &'static str,
    },
    /// The sizes of hidden layers cannot be.
    #[error("{name} is {layers:?}; it must name at least one layer, and none without units")]
    HiddenLayers {
        /// The setting's name.
        name: &'static str,
        /// Its value.
        layers: Vec<usize>,
    },
    /// An argument has the wrong length.
    #[error("{what} has {found} values, expected {expected}")]
    Length {
        /// Which argument.
        what: &'static str,
        /// Its length.
        found: usize,
        /// The length that it must have.
        expected: usize,
    },
    /// A value of an argument is NaN or infinite.
    #[error("{what}[{index}] is {value}")]
    ArgumentNotFinite {
        /// Which argument.
        what: &'static str,
        /// The first such value's place.
        index: usize,
        /// The value.
        value: f32,
    },
    /// Actions need finite bounds, the lower not above the upper.
    #[error("actions need finite bounds, not {low:?} to {high:?}")]
    Bounds {
        /// Lower bounds.
        low: Vec<f32>,
        /// Upper bounds.
        high: Vec<f32>,
    },
    /// A value that must lie in [0, 1] does not.
    #[error("{what}[{index}] is {value}, outside [0, 1]")]
    OutsideUnit {
        /// What the values are.
        what: &'static str,
        /// The first such value's place.
        index: usize,
        /// The value.
        value: f32,
    },
    /// What the networks return is not finite.
    #[error("{what} are not finite: [{index}] is {value}")]
    OutputNotFinite {
        /// What the values are.
        what: &'static str,
        /// The first such value's place.
        index: usize,
        /// The value.
        value: f32,
    },
    /// A critic's loss has overflowed.
    #[error("the loss of critic {critic} is {loss}")]
    LossNotFinite {
        /// Which critic.
        critic: usize,
        /// Its loss.
        loss: f32,
    },
    /// The actor's gradient has overflowed.
    #[error("the actor's gradient is {0}")]
    GradientNotFinite(f32),
}

/// Whose fault an [`Error`] is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ErrorKind {
    /// A setting's.
    Setting,
    /// An argument's: what was handed in is refused.
    Argument,
    /// The learner's own.
    Failure,
}

impl Error {
    /// The name of the setting that is wrong, where one is.
    pub fn setting(&self) -> Option<&'static str> {
        match self {
            Self::Setting { name, .. } | Self::HiddenLayers { name, .. } => Some(name),
            _ => None,
        }
    }

    /// Whose fault it is.
    pub fn kind(&self) -> ErrorKind {
        match self {
            Self::Shape { .. } | Self::NoMembers | Self::Setting { .. } | Self::HiddenLayers { .. } => {
                ErrorKind::Setting
            }
            Self::StateLength { .. }
            | Self::StateNotFinite
            | Self::ForeignState(_)
            | Self::Length { .. }
            | Self::ArgumentNotFinite { .. }
            | Self::Bounds { .. }
            | Self::OutsideUnit { .. } => ErrorKind::Argument,
            Self::Threads(_)
            | Self::Backend(_)
            | Self::Tensors(_)
            | Self::OutputNotFinite { .. }
            | Self::LossNotFinite { .. }
            | Self::GradientNotFinite(_) => ErrorKind::Failure,
        }
    }
}
