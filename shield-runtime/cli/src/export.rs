//! `shield export`: what the agents of a run learned, for other programs.

use std::path::{Path, PathBuf};

use anyhow::Result;
use clap::Args;
use shield_api::{ErrorKind, Learner};
use shield_host::plugin::Registry;
use shield_lab::run::{restore, write_in_folder};

use super::{Failure, eval::one_run, output};

/// Arguments of `shield export`.
#[derive(Args)]
pub struct ExportArguments {
    /// The folder of a run, <OUT>/<experiment>/<variant>/seed-<n>. Its last checkpoint counts.
    run: PathBuf,
    /// Folder of the files: <agent>.safetensors, and <agent>.onnx, which `plugins/onnx` plays.
    #[arg(long, default_value = "export")]
    out: PathBuf,
}

/// Writes whatever the learners of a run can write; it is an error if that is nothing.
pub fn export(arguments: &ExportArguments, registry: &Registry) -> Result<(), Failure> {
    let input = |error: anyhow::Error| Failure::Input(format!("{error:#}"));
    let folder = one_run(&arguments.run)?;
    let mut agents = restore(registry, &folder, &[]).map_err(input)?.parts.agents;
    let forward = agents.forward.as_mut().and_then(|agent| agent.learner());
    let reset = agents.reset.as_mut().map(|agent| agent.learner());
    let mut count = 0;
    for (name, learner) in [("forward", forward), ("reset", reset)] {
        if let Some(learner) = learner {
            count += write(name, learner, &arguments.out)
                .map_err(|error| Failure::Run(format!("{name}: {error:#}")))?;
        }
    }
    if count == 0 {
        let message = format!("{} has no learner that writes anything", arguments.run.display());
        return Err(Failure::Input(message));
    }
    Ok(())
}

/// A learner's files; returns how many there are.
fn write(name: &str, learner: &dyn Learner, out: &Path) -> Result<u32> {
    type Writer = fn(&dyn Learner, &mut Vec<u8>) -> shield_api::Result<()>;
    let kinds: [(&str, Writer); 2] = [
        ("safetensors", |learner, bytes| learner.weights(bytes)),
        ("onnx", |learner, bytes| learner.onnx(bytes)),
    ];
    let mut count = 0;
    for (extension, write) in kinds {
        let mut bytes = Vec::new();
        match write(learner, &mut bytes) {
            Ok(()) => {
                let path = out.join(format!("{name}.{extension}"));
                write_in_folder(&path, &bytes)?;
                output::note(path.display());
                count += 1;
            }
            Err(error) if error.kind() == ErrorKind::Unsupported => {
                output::message(format_args!("no {name}.{extension}: {error}"));
            }
            Err(error) => return Err(error.into()),
        }
    }
    Ok(count)
}
