//! What a shield of Python consists of, behind one lock.

use std::sync::{Arc, Mutex, PoisonError};

use shield_runtime::{
    drop_in::{DropIn, Frozen},
    record::Record,
};

/// A drop-in with its record and its buffers.
pub struct Inside {
    pub drop_in: DropIn,
    pub record: Option<Arc<Record>>,
    pub observation: Vec<f32>,
    pub action: Vec<f32>,
}

impl Inside {
    /// Lets `body` use the shield, for another environment if there is one.
    pub fn enter<R>(
        &mut self,
        other: Option<&Mutex<Frozen>>,
        body: impl FnOnce(&mut DropIn, &[f32], &mut [f32]) -> R,
    ) -> R {
        let Self { drop_in, observation, action, .. } = self;
        match other {
            None => body(drop_in, observation, action),
            Some(other) => {
                let mut other = other.lock().unwrap_or_else(PoisonError::into_inner);
                drop_in.frozen(&mut other, |drop_in| body(drop_in, observation, action))
            }
        }
    }

    /// How many findings there are, and whether the record has something to tell, which counts as one.
    pub fn told(&self) -> usize {
        let has_trouble = self.record.as_ref().is_some_and(|record| record.has_trouble());
        self.drop_in.findings().count() + usize::from(has_trouble)
    }
}
