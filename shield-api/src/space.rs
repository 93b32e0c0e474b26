//! Observation and action spaces.

use crate::{Error, Result, check_finite};

/// The set from which an observation or an action comes.
#[derive(Debug, Clone, PartialEq)]
pub enum Space {
    /// A vector with a lower and an upper bound per dimension. Bounds may be infinite for observations.
    Box {
        /// Lower bounds, one per dimension.
        low: Vec<f32>,
        /// Upper bounds, one per dimension.
        high: Vec<f32>,
    },
    /// One of `n` alternatives. As an action it travels as one `f32` that holds an exact index; as an
    /// observation it travels one-hot, in `n` values.
    Discrete {
        /// How many alternatives there are.
        n: usize,
    },
}

impl Space {
    /// A box with the same bounds in every dimension.
    pub fn uniform(dimensions: usize, low: f32, high: f32) -> Self {
        Self::Box { low: vec![low; dimensions], high: vec![high; dimensions] }
    }

    /// A box without bounds: the usual observation space.
    pub fn unbounded(dimensions: usize) -> Self {
        Self::uniform(dimensions, f32::NEG_INFINITY, f32::INFINITY)
    }

    /// How many `f32` an observation of this space occupies: the dimensions of a box, `n` (one-hot) if discrete.
    pub fn observation_len(&self) -> usize {
        match self {
            Self::Box { low, .. } => low.len(),
            Self::Discrete { n } => *n,
        }
    }

    /// How many `f32` an action of this space occupies: the dimensions of a box, 1 if discrete.
    pub fn action_len(&self) -> usize {
        match self {
            Self::Box { low, .. } => low.len(),
            Self::Discrete { .. } => 1,
        }
    }

    /// Refuses an action that has the wrong length, is not finite, lies outside a box, or is not an exact index.
    ///
    /// # Errors
    /// [`crate::ErrorKind::InvalidArgument`], naming the value and the bound.
    pub fn check_action(&self, action: &[f32]) -> Result<()> {
        check_finite("action", action, self.action_len())?;
        match self {
            Self::Box { low, high } => {
                for (index, value) in action.iter().enumerate() {
                    let is_inside = *value >= low[index] && *value <= high[index];
                    if !is_inside {
                        return Err(Error::invalid_argument(format!(
                            "action[{index}] is {value}, outside [{}, {}]",
                            low[index], high[index]
                        )));
                    }
                }
                Ok(())
            }
            Self::Discrete { .. } => self.action_index(action).map(|_| ()),
        }
    }

    /// The index that a discrete action holds.
    ///
    /// # Errors
    /// [`crate::ErrorKind::InvalidArgument`] when it is not an exact index below `n`, or the space is a box.
    pub fn action_index(&self, action: &[f32]) -> Result<usize> {
        let Self::Discrete { n } = self else {
            return Err(Error::invalid_argument("an action of a box has no index"));
        };
        check_finite("action", action, 1)?;
        let index = action[0];
        let is_exact = index >= 0.0 && index.fract() == 0.0 && (index as usize) < *n;
        if is_exact {
            Ok(index as usize)
        } else {
            Err(Error::invalid_argument(format!("action {index} is not an index below {n}")))
        }
    }

    /// Moves every value of a box action to the nearest bound where it lies outside; NaN stays NaN.
    pub fn clamp(&self, action: &mut [f32]) {
        if let Self::Box { low, high } = self {
            for ((value, low), high) in action.iter_mut().zip(low).zip(high) {
                if *value < *low {
                    *value = *low;
                } else if *value > *high {
                    *value = *high;
                }
            }
        }
    }

    /// Refuses a space that cannot exist: bounds of different lengths, NaN, low above high, or nothing in it.
    ///
    /// # Errors
    /// [`crate::ErrorKind::InvalidArgument`], naming the dimension.
    pub fn validate(&self, what: &str) -> Result<()> {
        match self {
            Self::Discrete { n: 0 } => {
                Err(Error::invalid_argument(format!("the {what} space has no alternatives")))
            }
            Self::Discrete { .. } => Ok(()),
            Self::Box { low, high } if low.len() != high.len() || low.is_empty() => {
                Err(Error::invalid_argument(format!(
                    "the {what} space has {} lower and {} upper bounds",
                    low.len(),
                    high.len()
                )))
            }
            Self::Box { low, high } => {
                match (0..low.len()).find(|i| low[*i].partial_cmp(&high[*i]).is_none_or(|o| o.is_gt())) {
                    None => Ok(()),
                    Some(index) => Err(Error::invalid_argument(format!(
                        "dimension {index} of the {what} space has the bounds [{}, {}]",
                        low[index], high[index]
                    ))),
                }
            }
        }
    }
}

/// The two spaces that everything around one environment shares.
#[derive(Debug, Clone, PartialEq)]
pub struct Spaces {
    /// What the agent sees.
    pub observation: Space,
    /// What the agent does.
    pub action: Space,
}

impl Spaces {
    /// How many `f32` an observation occupies.
    pub fn observation_len(&self) -> usize {
        self.observation.observation_len()
    }

    /// How many `f32` an action occupies.
    pub fn action_len(&self) -> usize {
        self.action.action_len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_box_refuses_outside_and_non_finite_actions() {
        let space = Space::uniform(2, -1.0, 1.0);
        assert!(space.check_action(&[0.0, 1.0]).is_ok());
        for bad in [&[0.0][..], &[0.0, 1.1], &[f32::NAN, 0.0], &[0.0, f32::INFINITY]] {
            assert!(space.check_action(bad).is_err(), "{bad:?}");
        }
    }

    #[test]
    fn a_discrete_action_is_an_exact_index() {
        let space = Space::Discrete { n: 4 };
        assert_eq!(space.action_index(&[3.0]).unwrap(), 3);
        for bad in [-1.0, 0.5, 4.0, f32::NAN, f32::INFINITY] {
            assert!(space.action_index(&[bad]).is_err(), "{bad}");
        }
    }

    #[test]
    fn impossible_spaces_are_refused() {
        for bad in [
            Space::Discrete { n: 0 },
            Space::uniform(0, 0.0, 1.0),
            Space::uniform(1, 1.0, 0.0),
            Space::uniform(1, f32::NAN, 0.0),
            Space::Box { low: vec![0.0], high: vec![1.0, 1.0] },
        ] {
            assert!(bad.validate("action").is_err(), "{bad:?}");
        }
        assert!(Space::unbounded(3).validate("observation").is_ok());
    }
}
