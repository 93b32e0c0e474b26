//! What Python gives, as the runtime takes it.

use std::path::{Path, PathBuf};

use numpy::PyReadonlyArray1;
use pyo3::{exceptions::PyValueError, prelude::*};
use shield_api::{Space, Spaces};
use shield_runtime::{
    experience::Experience,
    experiment::{Defaults, DropInFile, Override},
};

use crate::{ConfigError, config_error};

/// An action space as the package gives it.
#[derive(FromPyObject)]
pub enum Actions {
    Choices(usize),
    Bounds((Vec<f32>, Vec<f32>)),
}

/// Path, RON value, and what the user had written.
pub type Set = (String, String, String);

/// The configuration in a file, or without one the usual one, with overrides.
pub fn read(config: Option<&Path>, usual: Defaults, sets: &[Set]) -> PyResult<DropInFile> {
    let sets = sets.iter().map(|(path, value, written)| Override::new(path, value, written));
    let sets = sets.collect::<Result<Vec<_>, _>>().map_err(config_error)?;
    config.map_or_else(|| usual.file(&sets), |path| DropInFile::read(path, &sets)).map_err(config_error)
}

pub fn spaces(observation: (Vec<f32>, Vec<f32>), action: Actions) -> PyResult<Spaces> {
    let as_box = |(low, high)| Space::Box { low, high };
    let action = match action {
        Actions::Choices(n) => Space::Discrete { n },
        Actions::Bounds(bounds) => as_box(bounds),
    };
    let spaces = Spaces { observation: as_box(observation), action };
    for (name, space) in [("observation", &spaces.observation), ("action", &spaces.action)] {
        space.validate(name).map_err(|error| ConfigError::new_err(error.message().to_owned()))?;
    }
    Ok(spaces)
}

/// Copies an array, whose length the package has seen to.
pub fn copy(name: &str, array: &PyReadonlyArray1<'_, f32>, into: &mut [f32]) -> PyResult<()> {
    let array = array.as_slice()?;
    if array.len() != into.len() {
        let message = format!("{name} has {} numbers, not {}", array.len(), into.len());
        return Err(PyValueError::new_err(message));
    }
    into.copy_from_slice(array);
    Ok(())
}

fn usual(is_discrete: bool) -> Defaults {
    if is_discrete { Defaults::Discrete } else { Defaults::Box }
}

/// The configuration that is used for a box of actions, or for a choice of them.
#[pyfunction]
pub fn usual_config(is_discrete: bool) -> &'static str {
    usual(is_discrete).text()
}

/// The RON text at a path of the configuration, the overrides applied; None where nothing is written.
#[pyfunction]
pub fn written_at(
    config: Option<PathBuf>,
    is_discrete: bool,
    sets: Vec<Set>,
    path: &str,
) -> PyResult<Option<String>> {
    let file = read(config.as_deref(), usual(is_discrete), &sets)?;
    Ok(file.written_at(path).map(str::to_owned))
}

/// Bytes that the experience takes once it is full; nothing is allocated yet.
#[pyfunction]
pub fn experience_bytes(
    observation: (Vec<f32>, Vec<f32>),
    action: Actions,
    config: Option<PathBuf>,
    sets: Vec<Set>,
) -> PyResult<u64> {
    let spaces = spaces(observation, action)?;
    let file = read(config.as_deref(), Defaults::of(&spaces.action), &sets)?;
    let keeps_undo = file.config.shield.success_critic.is_some();
    let experience = &file.config.experience;
    Ok(Experience::bytes_when_full(experience.capacity, experience.observations, &spaces, keeps_undo))
}
