#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod action_scale;
mod adam;
mod architecture;
mod ensemble;
mod kernels;
mod loss;
mod member;
mod noise;
mod normaliser;
mod pass;
mod real;

pub use action_scale::ActionScale;
pub use adam::Adam;
pub use architecture::{Activation, Architecture};
pub use ensemble::{Ensemble, EnsembleState};
pub use loss::Loss;
pub use member::Member;
pub use noise::{Noise, NoiseProcess, Schedule};
pub use normaliser::Normaliser;
pub use real::Real;

/// What cannot be built or restored.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
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
}
