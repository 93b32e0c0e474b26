//! The record of a shield's decisions, as far as Python is concerned with it.

use std::sync::Arc;

use pyo3::prelude::*;
use shield_runtime::record;

/// What is recorded of a shield, until the shield is gone.
#[pyclass(frozen, module = "shield._core")]
pub struct Record(Arc<record::Record>);

impl Record {
    pub fn new(record: Arc<record::Record>) -> Self {
        Self(record)
    }
}

#[pymethods]
impl Record {
    /// Writes what waits in memory.
    fn flush(&self, py: Python<'_>) {
        py.detach(|| self.0.flush());
    }

    /// Why it has ended, if it has and this was not told yet.
    fn take_trouble(&self) -> Option<String> {
        self.0.take_trouble()
    }
}
