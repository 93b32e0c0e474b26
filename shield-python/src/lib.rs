//! `shield._core`: the runtime's drop-in shield, for the package `shield` around it.
//!
//! Arrays are copied before anything is done with them, and the interpreter is let go while the shield decides and learns.
#![forbid(unsafe_code)]

mod doctor;
mod given;
mod inside;
mod record;
mod reset_policy;
mod verdict;

use std::{
    path::PathBuf,
    sync::{Arc, Mutex, MutexGuard},
};

use numpy::{PyReadonlyArray1, PyReadwriteArray1};
use pyo3::{
    PyTraverseError, PyVisit, create_exception,
    exceptions::{PyRuntimeError, PyValueError},
    prelude::*,
    sync::MutexExt,
    types::PyDict,
};
use shield_api::{Phase, ResetSignal, USUAL_ACCEPTED_RISK};
use shield_runtime::{
    cycle::HardResetDue,
    drop_in::{DropIn, Frozen},
    drop_in_files,
    experiment::{Defaults, DropInFile, InputError},
    plugin::{Registry, SearchPath},
    record::RecordSettings,
};

use self::{
    given::{Actions, Set, copy, read, spaces},
    inside::Inside,
    record::Record,
    reset_policy::ResetPolicy,
    verdict::{Verdict, verdict},
};

create_exception!(shield, ConfigError, PyValueError, "A setting that must be changed, with its place.");
/// A finding: its name and its sentence.
type Told = (&'static str, String);

create_exception!(shield, ShieldError, PyRuntimeError, "The shield or a plugin of it failed.");

fn config_error(error: InputError) -> PyErr {
    ConfigError::new_err(error.to_string())
}

fn failed(error: impl std::fmt::Display) -> PyErr {
    ShieldError::new_err(error.to_string())
}

/// A drop-in shield. The package's `Shield` gives it arrays of the right shape and type.
#[pyclass(frozen, module = "shield._core")]
struct Core {
    inside: Arc<Mutex<Inside>>,
    /// Another environment, in which nothing is learned.
    other: Option<Mutex<Frozen>>,
    /// Where it was made: its threads do not follow a fork.
    process: u32,
    /// The ids of the rules, in the order in which the shield counts them.
    #[pyo3(get)]
    rules: Vec<String>,
    #[pyo3(get)]
    has_reset_task: bool,
    /// The user's, in the place of a reset agent that learns.
    reset_policy: Option<Arc<ResetPolicy>>,
    /// What it was made from: the configuration, and the folder of the wheel's plugins.
    origin: Arc<(DropInFile, PathBuf)>,
}

impl Core {
    fn lock(&self, py: Python<'_>) -> PyResult<MutexGuard<'_, Inside>> {
        if self.process != std::process::id() {
            return Err(failed(
                "the shield was made in another process; a forked one needs a shield of its own",
            ));
        }
        if self.reset_policy.as_ref().is_some_and(|policy| policy.is_calling()) {
            return Err(failed("reset_policy used the shield that asked it, which waits for its action"));
        }
        self.inside.lock_py_attached(py).map_err(|_| failed("the shield panicked"))
    }

    /// Hands the shield to `body` without holding the interpreter.
    fn with<R: Send>(&self, py: Python<'_>, body: impl FnOnce(&mut DropIn) -> R + Send) -> PyResult<R> {
        let mut inside = self.lock(py)?;
        let inside: &mut Inside = &mut inside;
        Ok(py.detach(move || inside.enter(self.other.as_ref(), |drop_in, _, _| body(drop_in))))
    }

    fn look<R>(&self, py: Python<'_>, body: impl FnOnce(&DropIn) -> R) -> PyResult<R> {
        self.look_mut(py, |drop_in| body(drop_in))
    }

    fn look_mut<R>(&self, py: Python<'_>, body: impl FnOnce(&mut DropIn) -> R) -> PyResult<R> {
        let mut inside = self.lock(py)?;
        Ok(inside.enter(self.other.as_ref(), |drop_in, _, _| body(drop_in)))
    }

    /// Looks at the shield that learns, whichever environment this is.
    fn look_at_learning<R>(&self, py: Python<'_>, body: impl FnOnce(&DropIn) -> R) -> PyResult<R> {
        Ok(body(&self.lock(py)?.drop_in))
    }
}

#[pymethods]
impl Core {
    /// `observation`: lower and upper bounds. `action`: the same, or a number of choices. `config`: a RON file; without one, the usual
    /// configuration. `plugins`: the folder of the wheel. `reset_policy`: a function from a flat observation to a flat action, if the
    /// configuration names no reset agent.
    #[new]
    #[pyo3(signature = (observation, action, config, sets, plugins, tensorboard, reset_policy))]
    #[expect(clippy::too_many_arguments, reason = "Python's keyword arguments")]
    fn new(
        py: Python<'_>,
        observation: (Vec<f32>, Vec<f32>),
        action: Actions,
        config: Option<PathBuf>,
        sets: Vec<Set>,
        plugins: PathBuf,
        tensorboard: Option<PathBuf>,
        reset_policy: Option<Py<PyAny>>,
    ) -> PyResult<Self> {
        let spaces = spaces(observation, action)?;
        let reset_policy = reset_policy.map(ResetPolicy::new);
        py.detach(move || {
            let file = read(config.as_deref(), Defaults::of(&spaces.action), &sets)?;
            let registry = Registry::scan(&SearchPath::beside(&plugins));
            let opened = match &reset_policy {
                None => file.open(&registry, Some(spaces)),
                Some(policy) => file.open_with(&registry, Some(spaces), Arc::clone(policy).controller()),
            };
            let mut drop_in = opened.map_err(config_error)?;
            if let Some(folder) = tensorboard {
                drop_in_files::log_to(&mut drop_in, &folder).map_err(failed)?;
            }
            let rules = file.config.rules().map(|choice| choice.plugin.clone()).collect();
            let observation = vec![0.0; drop_in.spaces().observation_len()];
            let action = vec![0.0; drop_in.spaces().action_len()];
            let inside = Arc::new(Mutex::new(Inside { drop_in, record: None, observation, action }));
            Ok(Self {
                inside,
                other: None,
                process: std::process::id(),
                rules,
                has_reset_task: file.config.reset_task.is_some(),
                reset_policy,
                origin: Arc::new((file, plugins)),
            })
        })
    }

    /// Begins a record of what is decided, in a folder that is new or empty. `every`: the decisions of every n-th step, and every rejection;
    /// `limit`: decisions after which it ends.
    #[pyo3(signature = (folder, every, limit))]
    fn record(
        &self,
        py: Python<'_>,
        folder: PathBuf,
        every: Option<u64>,
        limit: Option<u64>,
    ) -> PyResult<Record> {
        let usual = RecordSettings::default();
        let settings = RecordSettings {
            decisions: every.unwrap_or(usual.decisions),
            limit: limit.unwrap_or(usual.limit),
        };
        let mut inside = self.lock(py)?;
        let inside: &mut Inside = &mut inside;
        let begun = py.detach(|| {
            let (file, plugins) = &*self.origin;
            let registry = Registry::scan(&SearchPath::beside(plugins));
            let drop_in = &mut inside.drop_in;
            let begun = shield_runtime::record::Record::begin(drop_in, file, &registry, &folder, settings);
            begun.map(|record| Arc::clone(inside.record.insert(Arc::new(record))))
        });
        begun.map(Record::new).map_err(|error| ConfigError::new_err(format!("record: {error:#}")))
    }

    /// Decides on an action; afterwards `action` holds what may be executed.
    fn filter(
        &self,
        py: Python<'_>,
        observation: PyReadonlyArray1<'_, f32>,
        mut action: PyReadwriteArray1<'_, f32>,
    ) -> PyResult<Verdict<'static>> {
        let mut inside = self.lock(py)?;
        let inside: &mut Inside = &mut inside;
        copy("the observation", &observation, &mut inside.observation)?;
        copy("the action", &action, &mut inside.action)?;
        let decided = py.detach(|| {
            inside.enter(self.other.as_ref(), |drop_in, observation, action| {
                let decided = drop_in.filter(observation, action);
                decided.map(|decision| verdict(drop_in, decision))
            })
        });
        action.as_slice_mut()?.copy_from_slice(&inside.action);
        self.raise(inside)?;
        decided.map_err(failed)
    }

    /// The same shield for another environment, in which nothing is learned or counted.
    fn frozen(&self, py: Python<'_>) -> PyResult<Self> {
        let other = self.look_at_learning(py, DropIn::freeze)?;
        Ok(Self {
            inside: Arc::clone(&self.inside),
            other: Some(Mutex::new(other)),
            process: self.process,
            rules: self.rules.clone(),
            has_reset_task: self.has_reset_task,
            reset_policy: self.reset_policy.clone(),
            origin: Arc::clone(&self.origin),
        })
    }

    /// Tells of the reward of the forward step that was just observed, and of that of an abort.
    fn note_reward(&self, py: Python<'_>, reward: f64, abort_reward: f64) -> PyResult<()> {
        self.look_mut(py, |drop_in| drop_in.note_reward(reward, abort_reward))
    }

    /// What was executed led to this observation. Returns how many findings there are, and one more if the record has something to tell. `signal`:
    /// reset reward and whether it is in the reset set, if there is no reset task. `irreversible`: nothing follows but a count.
    fn observe(
        &self,
        py: Python<'_>,
        observation: PyReadonlyArray1<'_, f32>,
        signal: Option<(f32, bool)>,
        terminated: bool,
        irreversible: bool,
    ) -> PyResult<usize> {
        let signal = signal.map(|(reward, in_reset_set)| ResetSignal { reward, in_reset_set });
        self.seen(py, &observation, |drop_in, seen| {
            drop_in.observe_and_count(seen, signal, terminated, irreversible)
        })
    }

    /// Shows the reset task one more start; nothing else follows.
    fn observe_start(&self, py: Python<'_>, observation: PyReadonlyArray1<'_, f32>) -> PyResult<usize> {
        self.seen(py, &observation, DropIn::observe_start)
    }

    /// Everything is at its start, where this is observed. `is_inside`: whether it counts as reset, if there is no reset task.
    #[pyo3(signature = (observation, is_inside))]
    fn hard_reset_done(
        &self,
        py: Python<'_>,
        observation: PyReadonlyArray1<'_, f32>,
        is_inside: Option<bool>,
    ) -> PyResult<usize> {
        self.seen(py, &observation, |drop_in, seen| drop_in.hard_reset_done_at(seen, is_inside))
    }

    /// What keeps the shield from helping, as name and sentence, but for the first `told`.
    fn findings(&self, py: Python<'_>, told: usize) -> PyResult<Vec<Told>> {
        self.look_at_learning(py, |drop_in| {
            let new = drop_in.findings().skip(told);
            new.map(|finding| (finding.name(), finding.to_string())).collect()
        })
    }

    /// Hands over to the reset agent; returns whether it is in charge.
    fn begin_reset(&self, py: Python<'_>) -> PyResult<bool> {
        self.with(py, DropIn::begin_reset)
    }

    /// `has_ended`: the environment does not go on from here. `is_requested`: the caller wants one, though none may be due. Else where the
    /// environment stands is not known.
    fn require_hard_reset(&self, py: Python<'_>, has_ended: bool, is_requested: bool) -> PyResult<()> {
        self.with(py, |drop_in| {
            let cause = match (has_ended, is_requested) {
                (true, _) => HardResetDue::Terminated,
                (false, true) => drop_in.hard_reset_due().unwrap_or(HardResetDue::Requested),
                (false, false) => HardResetDue::Lost,
            };
            drop_in.require_hard_reset(cause);
        })
    }

    #[getter]
    fn is_resetting(&self, py: Python<'_>) -> PyResult<bool> {
        self.look(py, |drop_in| drop_in.phase() == Phase::Reset)
    }

    #[getter]
    fn needs_hard_reset(&self, py: Python<'_>) -> PyResult<bool> {
        self.look(py, DropIn::needs_hard_reset)
    }

    /// Why a hard reset is needed; empty if none is.
    #[getter]
    fn hard_reset_due(&self, py: Python<'_>) -> PyResult<&'static str> {
        self.look(py, |drop_in| drop_in.hard_reset_due().map_or("", HardResetDue::name))
    }

    /// Steps of the present episode.
    #[getter]
    fn episode_length(&self, py: Python<'_>) -> PyResult<u64> {
        self.look(py, DropIn::episode_length)
    }

    /// Starts that `observe_start` is still to be told before the first step.
    #[getter]
    fn calibration_resets(&self, py: Python<'_>) -> PyResult<u32> {
        self.look(py, DropIn::calibration_resets)
    }

    #[getter]
    fn is_placed(&self, py: Python<'_>) -> PyResult<bool> {
        self.look(py, DropIn::is_placed)
    }

    /// Steps after which irreversible states were entered, as far as `observe` was told.
    #[getter]
    fn irreversible_entries(&self, py: Python<'_>) -> PyResult<u64> {
        self.look_at_learning(py, |drop_in| drop_in.counters().irreversible_entries)
    }

    fn metrics<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let metrics = PyDict::new(py);
        let mut taken = Ok(());
        self.look_at_learning(py, |drop_in| {
            drop_in.metrics(&mut |name, value| {
                if taken.is_ok() {
                    taken = metrics.set_item(name, value);
                }
            });
        })?;
        taken.map(|()| metrics)
    }

    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        self.with(py, |drop_in| drop_in_files::save(drop_in, &path))?.map_err(failed)
    }

    fn __traverse__(&self, visit: PyVisit<'_>) -> Result<(), PyTraverseError> {
        self.reset_policy.as_ref().map_or(Ok(()), |policy| policy.traverse(&visit))
    }

    fn load(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        self.with(py, |drop_in| drop_in_files::load(drop_in, &path))?.map_err(failed)
    }
}

impl Core {
    fn seen(
        &self,
        py: Python<'_>,
        observation: &PyReadonlyArray1<'_, f32>,
        body: impl FnOnce(&mut DropIn, &[f32]) -> shield_api::Result<()> + Send,
    ) -> PyResult<usize> {
        let mut inside = self.lock(py)?;
        let inside: &mut Inside = &mut inside;
        copy("the observation", observation, &mut inside.observation)?;
        let seen = py.detach(|| {
            inside.enter(self.other.as_ref(), |drop_in, observation, _| body(drop_in, observation))
        });
        self.raise(inside)?;
        seen.map_err(failed)?;
        // Nobody is told anything of an environment in which nothing is counted.
        Ok(if self.other.is_some() { 0 } else { inside.told() })
    }

    /// What the user's reset policy raised reaches the user as it is. Nothing may move then before a hard reset.
    fn raise(&self, inside: &mut Inside) -> PyResult<()> {
        let raised = self.reset_policy.as_ref().and_then(|policy| policy.take_raised());
        raised.map_or(Ok(()), |error| {
            inside.enter(self.other.as_ref(), |drop_in, _, _| drop_in.require_hard_reset(HardResetDue::Lost));
            Err(error)
        })
    }
}

#[pymodule]
fn _core(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<Core>()?;
    module.add_class::<doctor::Examination>()?;
    module.add_class::<Record>()?;
    module.add_function(wrap_pyfunction!(given::usual_config, module)?)?;
    module.add_function(wrap_pyfunction!(given::written_at, module)?)?;
    module.add_function(wrap_pyfunction!(given::experience_bytes, module)?)?;
    module.add("ConfigError", module.py().get_type::<ConfigError>())?;
    module.add("ShieldError", module.py().get_type::<ShieldError>())?;
    module.add("USUAL_RISK", USUAL_ACCEPTED_RISK)?;
    module.add("__version__", env!("CARGO_PKG_VERSION"))
}
