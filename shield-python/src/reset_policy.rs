//! A reset policy that is a function of the user's.

use std::{
    sync::{Arc, Mutex, PoisonError},
    thread::{self, ThreadId},
};

use numpy::{PyArray1, PyReadonlyArray1};
use pyo3::{PyTraverseError, PyVisit, prelude::*};
use shield_api::Error;
use shield_runtime::controller::Controller;

/// The function, and what came of its calls. It takes a flat observation and gives a flat action, both of 32-bit floats.
pub struct ResetPolicy {
    function: Py<PyAny>,
    /// What it raised; from then on it is not called until somebody has taken note.
    raised: Mutex<Option<PyErr>>,
    /// The thread that is in it.
    caller: Mutex<Option<ThreadId>>,
}

impl ResetPolicy {
    pub fn new(function: Py<PyAny>) -> Arc<Self> {
        Arc::new(Self { function, raised: Mutex::default(), caller: Mutex::default() })
    }

    /// As a reset agent. What it raises is a failure there, and waits to be [taken](Self::take_raised).
    pub fn controller(self: Arc<Self>) -> Controller {
        Controller::from_fn(move |observation, action| {
            let mut raised = self.raised.lock().unwrap_or_else(PoisonError::into_inner);
            if raised.is_some() {
                return Err(Error::failed("the reset policy raised an exception before"));
            }
            self.set_caller(Some(thread::current().id()));
            let called = Python::attach(|py| self.call(py, observation, action));
            self.set_caller(None);
            called.map_err(|error| {
                let message = format!("the reset policy raised {error}");
                *raised = Some(error);
                Error::failed(message)
            })
        })
    }

    fn call(&self, py: Python<'_>, observation: &[f32], action: &mut [f32]) -> PyResult<()> {
        let given = self.function.bind(py).call1((PyArray1::from_slice(py, observation),))?;
        super::given::copy(
            "the action of reset_policy",
            &given.extract::<PyReadonlyArray1<'_, f32>>()?,
            action,
        )
    }

    fn set_caller(&self, caller: Option<ThreadId>) {
        *self.caller.lock().unwrap_or_else(PoisonError::into_inner) = caller;
    }

    /// Whether this thread is in the function: the shield waits for it, and cannot be asked anything.
    pub fn is_calling(&self) -> bool {
        *self.caller.lock().unwrap_or_else(PoisonError::into_inner) == Some(thread::current().id())
    }

    /// What the function raised since the last time.
    pub fn take_raised(&self) -> Option<PyErr> {
        self.raised.lock().unwrap_or_else(PoisonError::into_inner).take()
    }

    pub fn traverse(&self, visit: &PyVisit<'_>) -> Result<(), PyTraverseError> {
        visit.call(&self.function)
    }
}
