//! Beginning a run, going on with one, and looking into one.

use std::{path::Path, sync::atomic::AtomicBool};

use anyhow::{Context, Result, anyhow, bail};
use indexmap::IndexMap;
use shield_api::manifest::Manifest;

use super::{
    build::{Prepared, prepare},
    folder::RunFolder,
    recorder::{Recorder, RecorderState},
    summary::{Identity, Summary},
};
use crate::{
    checkpoint::{CheckpointStore, PluginVersion, Provenance, last_checkpoint},
    joint_loop::JointLoop,
    loop_state::LoopState,
    observer::{Fanout, Observer},
};
use shield_config::experiment::{
    Difference, Experiment, ExperimentFile, Override, Variant, first_difference,
};
use shield_host::plugin::{PluginError, Registry};

/// Which run, with everything that it is made of.
#[derive(Debug, Clone, Copy)]
pub struct Order<'a> {
    /// Where the plugins are.
    pub registry: &'a Registry,
    /// The variant.
    pub variant: &'a Variant,
    /// Its names and seed.
    pub identity: &'a Identity,
    /// Where it is written.
    pub folder: &'a RunFolder,
}

/// What is left to be done of a run.
#[derive(Debug)]
pub enum Standing {
    /// Everything: there is no folder.
    Missing,
    /// Nothing.
    Finished(Box<Summary>),
    /// Something, from its last checkpoint on.
    Unfinished,
    /// The folder has a run with another configuration.
    Differs(Difference),
}

/// A run that is ready to go.
pub struct Launch {
    prepared: Prepared,
    recorder: Recorder,
    state: Option<LoopState>,
    folder: RunFolder,
    name: String,
    warnings: Vec<String>,
}

impl Order<'_> {
    /// How far the run is.
    ///
    /// # Errors
    /// The folder is not that of a run.
    pub fn standing(&self) -> Result<Standing> {
        if !self.folder.exists() {
            return Ok(Standing::Missing);
        }
        if !self.folder.is_begun()? {
            return Ok(Standing::Unfinished);
        }
        let config = self.folder.config()?;
        if let Some(difference) = first_difference(&config, &self.provenance()?.config) {
            return Ok(Standing::Differs(difference));
        }
        Ok(match self.folder.summary()? {
            Some(summary) if summary.complete => Standing::Finished(Box::new(summary)),
            _ => Standing::Unfinished,
        })
    }

    /// Begins the run in a new folder; with `overwrite`, what stood there is removed.
    ///
    /// # Errors
    /// A plugin refuses, the folder exists, or a file cannot be written.
    pub fn begin(&self, overwrite: bool) -> Result<Launch> {
        let prepared = self.prepare()?;
        let provenance = self.provenance()?;
        CheckpointStore::ensure_free(self.folder.path())?;
        self.folder.create(&provenance.config, &self.plugins_json()?, overwrite)?;
        let recorder = self.recorder(RecorderState::default(), &prepared).and_then(|recorder| {
            Ok(match prepared.settings.checkpoint_every {
                Some(_) => {
                    recorder.with_checkpoints(CheckpointStore::create(self.folder.path(), provenance)?, true)
                }
                None => recorder,
            })
        });
        let recorder = recorder.inspect_err(|_| self.folder.discard())?;
        Ok(self.launch(prepared, recorder, None, Vec::new()))
    }

    /// Goes on with the run from its last usable checkpoint, or begins it anew where there is none.
    ///
    /// # Errors
    /// A plugin refuses, another process writes the run, a checkpoint is of other plugins, or a file cannot be written.
    pub fn proceed(&self) -> Result<Launch> {
        let mut prepared = self.prepare()?;
        let mut warnings = Vec::new();
        let memory = prepared.participants.agents.memory.as_mut();
        let experience = &mut memory.context("a run learns from nothing")?.experience;
        let found =
            CheckpointStore::resume(self.folder.path(), self.provenance()?, experience, &mut |warning| {
                warnings.push(warning);
            })?;
        let Some((store, saved)) = found else {
            warnings.push("there is no usable checkpoint: the run begins anew".into());
            return Ok(Launch { warnings, ..self.begin(true)? });
        };
        for field in saved.state.unsaved() {
            warnings.push(format!(
                "the plugin of `{field}` cannot save its state: it begins anew, after a counted hard reset"
            ));
        }
        let is_exact = saved.state.unsaved().is_empty();
        let recorder = self.recorder(saved.recorder, &prepared)?.with_checkpoints(store, is_exact);
        Ok(self.launch(prepared, recorder, Some(saved.state), warnings))
    }

    fn launch(
        &self,
        prepared: Prepared,
        recorder: Recorder,
        state: Option<LoopState>,
        warnings: Vec<String>,
    ) -> Launch {
        Launch {
            prepared,
            recorder,
            state,
            folder: self.folder.clone(),
            name: format!("{} seed {}", self.identity.variant, self.identity.seed),
            warnings,
        }
    }

    fn prepare(&self) -> Result<Prepared> {
        Ok(prepare(self.registry, self.variant, self.identity.seed)?)
    }

    fn recorder(&self, state: RecorderState, prepared: &Prepared) -> Result<Recorder> {
        let experiment = &self.variant.experiment;
        let rules = experiment.rules().map(|choice| choice.plugin.clone()).collect();
        let solved_at = experiment.evaluation.as_ref().map_or(1.0, |evaluation| evaluation.solved_at);
        let is_deterministic = experiment.shield.deadline_us.is_none()
            && manifests(self.registry, experiment)?.iter().all(|manifest| manifest.deterministic);
        let recorder = Recorder::resume(self.folder.clone(), self.identity.clone(), rules, solved_at, state)?;
        let kinds = prepared.participants.world.reset_kinds();
        Ok(recorder.reset_kinds(kinds).deterministic(is_deterministic))
    }

    /// Which plugin each field of the experiment is, with version and hash.
    fn plugins_json(&self) -> Result<String> {
        let mut identities = IndexMap::new();
        for (path, kind, choice) in self.variant.experiment.plugins() {
            identities.insert(path, self.registry.identify(&choice.selection(), kind)?);
        }
        Ok(serde_json::to_string_pretty(&identities)? + "\n")
    }

    /// What the run is made of.
    ///
    /// # Errors
    /// A plugin is missing.
    pub fn provenance(&self) -> Result<Provenance> {
        let manifests = manifests(self.registry, &self.variant.experiment)?;
        let fields_of = |id: &str| {
            let fields = manifests.iter().find(|manifest| manifest.id == id).map(|manifest| &manifest.fields);
            fields.into_iter().flatten().map(|field| (field.name.clone(), field.default.clone())).collect()
        };
        let version = |manifest: &Manifest| PluginVersion {
            id: manifest.id.clone(),
            version: manifest.version.clone(),
        };
        Ok(Provenance {
            config: self.variant.resolved_ron(self.identity.seed, &fields_of),
            plugins: manifests.iter().map(version).collect(),
        })
    }
}

impl Launch {
    /// Environment steps that were made before.
    pub fn steps_before(&self) -> u64 {
        self.state.as_ref().map_or(0, |state| state.counters().steps)
    }

    /// What the user should know before it goes on.
    pub fn warnings(&self) -> &[String] {
        &self.warnings
    }

    /// Runs until the steps are used up or `stop` is set. `progress` hears what the recorder hears.
    ///
    /// # Errors
    /// A plugin failed, or a file could not be written. The summary says so, where it can be written.
    pub fn run(self, progress: impl Observer, stop: &AtomicBool) -> Result<Summary> {
        let Self { prepared, recorder, state, folder, name, .. } = self;
        let budget = prepared.settings.steps;
        let mut observer = Fanout(recorder, progress);
        let mut joint =
            JointLoop::new(prepared.settings, prepared.participants, prepared.resets, &mut observer, stop);
        let restored = state.map_or(Ok(()), |state| joint.restore(&state));
        let ran = restored.map_err(anyhow::Error::from).and_then(|()| joint.run());
        let counters = *joint.counters();
        drop(joint);
        let ran = ran.with_context(|| format!("{name} failed after {} steps", counters.steps));
        let error = ran.as_ref().err().map(|error| format!("{error:#}"));
        let summary = observer.0.finish(&counters, budget, error);
        if ran.is_err() && counters.steps == 0 {
            folder.discard();
        }
        ran.and(summary)
    }
}

/// A run as its last checkpoint has it, to look at or to try out. Nothing of it is written.
pub struct Restored {
    /// Its names and seed.
    pub identity: Identity,
    /// Its configuration.
    pub variant: Variant,
    /// The agents and rules have what they had learned; the worlds are new, the experience is empty.
    pub prepared: Prepared,
    /// Everything else that was saved.
    pub state: LoopState,
}

/// Reads a run's last checkpoint and gives its agents and rules what they had learned. `overrides` change the configuration of what is
/// tried out, for example of its evaluation.
///
/// # Errors
/// The folder is not that of a run, has no usable checkpoint, or a plugin cannot be loaded or refuses its state.
pub fn restore(registry: &Registry, folder: &RunFolder, overrides: &[Override]) -> Result<Restored> {
    let (identity, variant) = of_folder(folder, overrides)?;
    let saved = last_checkpoint::<RecorderState>(folder.path())?;
    let mut prepared = prepare(registry, &variant, identity.seed)?;
    prepared.participants.restore_agents(&saved.state)?;
    Ok(Restored { identity, variant, prepared, state: saved.state })
}

/// The names and the configuration of the run in a folder, changed by `overrides`.
///
/// # Errors
/// The folder is not that of a run, or an override does not fit.
pub fn of_folder(folder: &RunFolder, overrides: &[Override]) -> Result<(Identity, Variant)> {
    let path = folder.path();
    let file = ExperimentFile::from_text(path.join("config.ron"), folder.config()?);
    let mut variants = file.variants(overrides, None)?;
    let (Some(mut variant), true) = (variants.pop(), variants.is_empty()) else {
        bail!("{} is not the configuration of one run", file.path.display());
    };
    let absolute = path.canonicalize().with_context(|| format!("{} cannot be read", path.display()))?;
    let parent = absolute.parent().and_then(Path::file_name);
    variant.name = parent.map_or_else(|| variant.name.clone(), |name| name.to_string_lossy().into_owned());
    let seed = *variant.experiment.seeds.first().ok_or_else(|| anyhow!("the run has no seed"))?;
    let identity =
        Identity { experiment: variant.experiment.name.clone(), variant: variant.name.clone(), seed };
    Ok((identity, variant))
}

/// The manifests of every plugin that the experiment names, from the file that it is loaded from.
fn manifests(registry: &Registry, experiment: &Experiment) -> Result<Vec<Manifest>, PluginError> {
    let plugins = experiment.plugins().into_iter();
    plugins
        .map(|(_, kind, choice)| registry.entry(&choice.selection(), kind).map(|entry| entry.manifest))
        .collect()
}
