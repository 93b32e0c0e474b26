//! `gymnasium`: a Stable-Baselines3 agent in Gymnasium's environments, with the shield as it is and without. Its runs are made by a program in Python.

mod page;
mod record;

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result};

use self::record::Record;

/// Stands for all of them on the command line.
pub const NAME: &str = "gymnasium";
/// Where the page is, and the records.
const FOLDER: &str = "examples/gymnasium";

/// Those for which there is a target, then some for which nothing was ever tried while the shield was made.
pub const ENVIRONMENTS: [&str; 11] = [
    "HalfCheetah-v5",
    "Hopper-v5",
    "Pusher-v5",
    "Pendulum-v1",
    "MountainCarContinuous-v0",
    "InvertedPendulum-v5",
    "CartPole-v1",
    "Acrobot-v1",
    "Reacher-v5",
    "Swimmer-v5",
    "Walker2d-v5",
];
/// How many of them have a target.
const TARGETED: usize = 7;

/// Makes the runs of these environments that are not recorded, with a Python that has the package.
///
/// # Errors
/// Python cannot be started.
pub fn run(root: &Path, python: &Path, environments: &[&str], seeds: Option<&str>) -> Result<bool> {
    let mut are_all_made = true;
    for environment in environments {
        let mut train = Command::new(python);
        train.current_dir(root).arg(Path::new(FOLDER).join("train.py")).arg(environment);
        train.arg("--record").arg(path_of(environment));
        if let Some(seeds) = seeds {
            train.args(["--seeds", seeds]);
        }
        // Those of the user's would lead the package to other plugins than its own.
        train.env_remove("SHIELD_PLUGIN_PATH").env("PYTHONDONTWRITEBYTECODE", "1");
        let status = train.status().with_context(|| format!("{} could not be started", python.display()))?;
        are_all_made &= status.success();
    }
    Ok(are_all_made)
}

/// Writes the page anew, from the records that there are.
///
/// # Errors
/// A file cannot be read or written.
pub fn write_page(root: &Path) -> Result<()> {
    let read = |environment: &'static str| {
        let path = root.join(path_of(environment));
        Ok((environment, path.exists().then(|| Record::read(&path)).transpose()?))
    };
    let records = ENVIRONMENTS.into_iter().map(read).collect::<Result<Vec<_>>>()?;
    super::write_results(root, FOLDER, &page::page(&records))
}

fn path_of(environment: &str) -> PathBuf {
    Path::new(FOLDER).join("records").join(format!("{environment}.json"))
}
