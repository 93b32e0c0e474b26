//! Actions as the networks see them.

use actor_critic::ActionScale;
use learner_kit::plugin_error;
use shield_api::{Result, Space, check_finite, check_length};

/// How an action of the space enters a network.
#[derive(Debug)]
pub(crate) enum ActionInput {
    /// An action of a box, scaled to [-1, 1].
    Scaled(ActionScale),
    /// An index of so many alternatives, as a one-hot row.
    OneHot { space: Space, alternatives: usize },
}

impl ActionInput {
    pub(crate) fn new(space: &Space) -> Result<Self> {
        match space {
            Space::Box { low, high } => ActionScale::new(low, high).map(Self::Scaled).map_err(plugin_error),
            Space::Discrete { n } => Ok(Self::OneHot { space: space.clone(), alternatives: *n }),
        }
    }

    /// How many inputs of a network an action takes.
    pub(crate) fn input_len(&self) -> usize {
        match self {
            Self::Scaled(scale) => scale.len(),
            Self::OneHot { alternatives, .. } => *alternatives,
        }
    }

    /// Writes `size` actions of the space into `inputs`, row by row.
    pub(crate) fn take_rows(
        &self,
        what: &str,
        actions: &[f32],
        size: usize,
        inputs: &mut Vec<f32>,
    ) -> Result<()> {
        inputs.clear();
        inputs.resize(size * self.input_len(), 0.0);
        match self {
            Self::Scaled(scale) => {
                check_finite(what, actions, size * scale.len())?;
                scale.to_unit(actions, inputs);
            }
            Self::OneHot { space, alternatives } => {
                check_length(what, actions, size)?;
                for (row, action) in actions.chunks_exact(1).enumerate() {
                    inputs[row * alternatives + space.action_index(action)?] = 1.0;
                }
            }
        }
        Ok(())
    }

    /// Whether an action can be moved a little.
    pub(crate) fn is_continuous(&self) -> bool {
        matches!(self, Self::Scaled(_))
    }

    /// Turns the derivative with respect to a network's input into that with respect to the action of a box.
    pub(crate) fn gradient_to_action(&self, gradient: &mut [f32]) {
        if let Self::Scaled(scale) = self {
            scale.gradient_to_box(gradient);
        }
    }
}
