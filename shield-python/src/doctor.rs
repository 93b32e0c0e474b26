//! What `shield.doctor` tells of an environment, and what comes of it.

use std::{path::PathBuf, sync::Mutex};

use numpy::PyReadonlyArray1;
use pyo3::{prelude::*, sync::MutexExt};
use shield_api::{ResetTask, Spaces};
use shield_runtime::{
    examination::{self, STARTS, STEPS, StepEnd, Verdict},
    experiment::Defaults,
    plugin::{Registry, SearchPath},
};

use crate::{
    config_error, failed,
    given::{Actions, Set, read, spaces},
};

/// Name, one word for how it stands, what was seen, and what to do.
type Checked = (&'static str, &'static str, String, String);

struct Inside {
    examination: examination::Examination,
    task: Option<Box<dyn ResetTask>>,
    spaces: Spaces,
}

/// An examination, with the reset task that the configuration names.
#[pyclass(frozen, module = "shield._core")]
pub struct Examination {
    inside: Mutex<Inside>,
    #[pyo3(get)]
    has_reset_task: bool,
}

impl Examination {
    fn with<R>(&self, py: Python<'_>, body: impl FnOnce(&mut Inside) -> R) -> PyResult<R> {
        let mut inside = self.inside.lock_py_attached(py).map_err(|_| failed("the examination panicked"))?;
        Ok(body(&mut inside))
    }
}

#[pymethods]
impl Examination {
    /// As many starts and random steps as are usual.
    #[classattr]
    const USUAL: (u32, u32) = (STARTS, STEPS);

    #[new]
    fn new(
        observation: (Vec<f32>, Vec<f32>),
        action: Actions,
        config: Option<PathBuf>,
        sets: Vec<Set>,
        plugins: PathBuf,
    ) -> PyResult<Self> {
        let spaces = spaces(observation, action)?;
        let file = read(config.as_deref(), Defaults::of(&spaces.action), &sets)?;
        let registry = Registry::scan(&SearchPath::beside(&plugins));
        let task = file.reset_task(&registry, &spaces).map_err(config_error)?;
        let has_reset_task = task.is_some();
        let inside = Inside { examination: examination::Examination::new(), task, spaces };
        Ok(Self { inside: Mutex::new(inside), has_reset_task })
    }

    /// The environment was reset.
    #[pyo3(signature = (observation, is_inside))]
    fn start(
        &self,
        py: Python<'_>,
        observation: PyReadonlyArray1<'_, f32>,
        is_inside: Option<bool>,
    ) -> PyResult<()> {
        let observation = observation.as_slice()?;
        self.with(py, |inside| inside.examination.start(observation, is_inside))
    }

    /// Random actions begin.
    fn walk(&self, py: Python<'_>) -> PyResult<()> {
        self.with(py, |inside| inside.examination.walk())
    }

    /// A random action led here.
    #[pyo3(signature = (observation, is_inside, terminated, truncated))]
    fn step(
        &self,
        py: Python<'_>,
        observation: PyReadonlyArray1<'_, f32>,
        is_inside: Option<bool>,
        terminated: bool,
        truncated: bool,
    ) -> PyResult<()> {
        let observation = observation.as_slice()?;
        let end = match (terminated, truncated) {
            (true, _) => StepEnd::Terminated,
            (false, true) => StepEnd::Truncated,
            (false, false) => StepEnd::Continues,
        };
        self.with(py, |inside| inside.examination.step(observation, is_inside, end))
    }

    /// Whether the walk should end after so many steps, of so many in all.
    fn is_walk_over(&self, py: Python<'_>, steps: u32, of: u32) -> PyResult<bool> {
        self.with(py, |inside| inside.examination.is_walk_over(steps, of))
    }

    /// The checks, the verdict in one word, and everything as text.
    fn conclude(&self, py: Python<'_>) -> PyResult<(Vec<Checked>, &'static str, String)> {
        self.with(py, |Inside { examination, task, spaces }| {
            if let Some(task) = task {
                let action_len = spaces.action_len();
                examination.tell(&mut **task, action_len)?;
                examination.judge(&mut **task, action_len)?;
            }
            Ok(examination.conclude())
        })?
        .map_err(|error: shield_api::Error| failed(error))
        .map(|checkup| {
            let text = checkup.to_string();
            let verdict = match checkup.verdict() {
                Verdict::Works => "works",
                Verdict::Change(_) => "change",
                Verdict::CannotHelp(_) => "cannot_help",
            };
            let checks = checkup.checks.into_iter();
            let checks =
                checks.map(|check| (check.name, check.standing.word(), check.seen, check.remedy)).collect();
            (checks, verdict, text)
        })
    }
}
