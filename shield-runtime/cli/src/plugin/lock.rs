//! `shield plugin lock`: pins the plugins of an experiment.

use std::{collections::BTreeMap, io::Write as _, path::PathBuf};

use anyhow::Context as _;
use clap::Args;
use shield_config::{atomic_file::AtomicFile, experiment::ExperimentFile};
use shield_host::plugin::{Identity, Registry};

use super::super::{Failure, output};

/// Arguments of `shield plugin lock`.
#[derive(Args)]
pub struct LockArguments {
    /// The experiment, a RON file.
    experiment: PathBuf,
}

/// Writes the pins of every plugin that some variant uses, and prints them.
pub fn lock(arguments: &LockArguments, registry: &Registry) -> Result<(), Failure> {
    let file = ExperimentFile::read(&arguments.experiment)?;
    // Pins that are there already may name plugins that are no longer used; they are about to be replaced.
    let bare = ExperimentFile::from_text(&file.path, file.with_pins(&[])?);
    let mut identities: BTreeMap<String, Identity> = BTreeMap::new();
    for variant in bare.variants(&[], None)? {
        for (path, kind, choice) in variant.experiment.plugins() {
            let identity = registry
                .identify(&choice.selection(), kind)
                .map_err(|error| variant.error_at(&format!("{path}.plugin"), None, error.to_string()))?;
            if let Some(other) = identities.insert(choice.plugin.clone(), identity.clone())
                && other != identity
            {
                let message = format!("{:?} comes from two different files; a pin names one", choice.plugin);
                return Err(variant.error_at(&format!("{path}.plugin"), None, message).into());
            }
        }
    }
    let pins: Vec<_> =
        identities.iter().map(|(id, identity)| (id.clone(), identity.sha256.clone())).collect();
    replace(&file, &file.with_pins(&pins)?).map_err(|error| Failure::Run(format!("{error:#}")))?;
    for Identity { id, version, sha256, .. } in identities.values() {
        output::note(format_args!("{sha256}  {id} {version}"));
    }
    output::note(format_args!("{} plugins are pinned in {}.", identities.len(), file.path.display()));
    Ok(())
}

/// The file is there whole at every moment: as it was, or as it shall be. If its name is a link, the link stays.
fn replace(file: &ExperimentFile, text: &str) -> anyhow::Result<()> {
    let context = || format!("{} cannot be written", file.path.display());
    let path = file.path.canonicalize().with_context(context)?;
    let write = || {
        let mut out = AtomicFile::create(&path)?;
        out.write_all(text.as_bytes())?;
        out.sync()?;
        out.commit()
    };
    write().with_context(context)
}
