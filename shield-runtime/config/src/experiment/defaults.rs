//! The configurations of drop-ins that name none.

use shield_api::Space;

use super::{DropInFile, InputError, Override};

/// The configurations that are used where none is given.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Defaults {
    /// For a box of actions.
    Box,
    /// For a choice of actions.
    Discrete,
}

impl Defaults {
    /// Those that fit an action space.
    pub fn of(action: &Space) -> Self {
        match action {
            Space::Box { .. } => Self::Box,
            Space::Discrete { .. } => Self::Discrete,
        }
    }

    /// As RON.
    pub fn text(self) -> &'static str {
        match self {
            Self::Box => include_str!("defaults/box.ron"),
            Self::Discrete => include_str!("defaults/discrete.ron"),
        }
    }

    /// With overrides.
    ///
    /// # Errors
    /// An override does not fit.
    pub fn file(self, sets: &[Override]) -> Result<DropInFile, InputError> {
        DropInFile::from_text("the usual configuration", self.text(), sets)
    }
}
