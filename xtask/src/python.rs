//! Python environments for what compares us with others: made once under `native/`, never in the user's own Python.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};

use crate::say::say;

/// Where the environments lie, one folder each.
const FOLDER: &str = "native/python";
/// A copy of the requirements that were installed; written last, so that an interrupted set-up is begun anew.
const STAMP: &str = "installed.txt";

/// The Python program of the environment `name` with the packages of the file `requirements`: made by pip if it does not exist or the
/// file has changed, else as it is.
///
/// # Errors
/// The file cannot be read, or the environment cannot be made; with the remedy.
pub fn environment(workspace_root: &Path, name: &str, requirements: &Path) -> Result<PathBuf> {
    let wanted = fs::read(requirements).with_context(|| format!("cannot read {}", requirements.display()))?;
    let folder = workspace_root.join(FOLDER).join(name);
    let program = folder.join("bin/python");
    let stamp = folder.join(STAMP);
    if program.exists() && fs::read(&stamp).is_ok_and(|installed| installed == wanted) {
        return Ok(program);
    }
    say(format_args!("installing the Python packages of {}, once", requirements.display()));
    run(Command::new("python3").args(["-m", "venv", "--clear"]).arg(&folder))?;
    let mut pip = Command::new(&program);
    pip.args(["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--requirement"]);
    run(pip.arg(requirements))?;
    fs::write(&stamp, wanted).with_context(|| format!("cannot write {}", stamp.display()))?;
    Ok(program)
}

fn run(command: &mut Command) -> Result<()> {
    const REMEDY: &str = "this needs python3 (3.11 or newer) with venv and pip, and the network (on Debian: apt install python3-venv)";
    let status = command.status().with_context(|| format!("cannot start python3: {REMEDY}"))?;
    if !status.success() {
        bail!("a Python environment could not be made ({status}): {REMEDY}");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_environment_is_made_again_only_after_a_change() {
        let root = std::env::temp_dir().join(format!("xtask-python-{}", std::process::id()));
        fs::create_dir_all(&root).unwrap();
        let requirements = root.join("requirements.txt");
        fs::write(&requirements, "# nothing\n").unwrap();
        let program = environment(&root, "test", &requirements).unwrap();
        let mark = program.with_file_name("mark");
        fs::write(&mark, "").unwrap();
        environment(&root, "test", &requirements).unwrap();
        assert!(mark.exists(), "an unchanged environment was made again");
        fs::write(&requirements, "# something else\n").unwrap();
        environment(&root, "test", &requirements).unwrap();
        assert!(!mark.exists(), "a changed list left the environment as it was");
        fs::remove_dir_all(root).unwrap();
    }

    #[test]
    fn a_missing_list_is_refused_by_name() {
        let error = environment(Path::new("/nonexistent"), "test", Path::new("/nonexistent/list.txt"));
        assert!(error.unwrap_err().to_string().contains("list.txt"));
    }
}
