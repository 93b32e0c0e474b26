//! Beginning a run, going on with one, and looking into one.

use std::{path::Path, sync::atomic::AtomicBool};

use anyhow::{Context, Result, anyhow, bail};
use shield_api::manifest::Manifest;

use super::{
    accepted_risk::AcceptedRisk,
    build::prepare,
    folder::RunFolder,
    new_folder::NewFolder,
    recorder::{Recorder, RecorderState},
    summary::{FoundInRun, Identity, Summary},
};
use crate::{
    checkpoint::{CheckpointStore, LockedCheckpoints, PluginVersion, Provenance, last_checkpoint},
    joint_loop::{JointLoop, LoopParts},
    loop_state::LoopState,
    observer::{Fanout, Observer},
};
use shield_config::experiment::{Difference, ExperimentFile, Override, Variant, first_difference};
use shield_decisions::provenance::{fields_of, manifests, plugins_json};
use shield_host::plugin::Registry;

/// One seed of one variant of an experiment, and where it is written.
#[derive(Debug, Clone)]
pub struct Run {
    /// The variant.
    pub variant: Variant,
    /// The seed.
    pub seed: u64,
    /// The folder, which may not be there yet.
    pub folder: RunFolder,
}

/// What is left to be done of a run.
#[derive(Debug)]
pub enum Standing {
    /// Everything: there is no folder, or none in which anything was begun.
    Missing,
    /// The folder holds something else than a run.
    Foreign,
    /// Nothing.
    Finished(Box<Summary>),
    /// Something, from its last checkpoint on if it has one.
    Unfinished,
    /// The folder has a run with another configuration.
    Differs(Difference),
}

/// A run that is ready to go: its files are open, and no other process can write it.
pub struct Launch {
    pub(super) parts: LoopParts,
    pub(super) recorder: Recorder,
    /// Where it goes on; `None` if it begins.
    pub(super) state: Option<LoopState>,
    /// What this launch made; `None` if it goes on.
    pub(super) new: Option<NewFolder>,
    pub(super) warnings: Vec<String>,
}

impl Run {
    /// The run of `variant` with `seed`, in a folder of its own in `out`. Creates nothing.
    pub fn new(out: &Path, variant: Variant, seed: u64) -> Self {
        let folder = RunFolder::new(out, &identity(&variant, seed));
        Self { variant, seed, folder }
    }

    /// The run in a folder, its configuration changed by `overrides`.
    ///
    /// # Errors
    /// The folder is not that of a run, or an override does not fit.
    pub fn of_folder(folder: RunFolder, overrides: &[Override]) -> Result<Self> {
        let path = folder.path();
        let file = ExperimentFile::from_text(path.join("config.ron"), folder.config()?);
        let mut variants = file.variants(overrides, None)?;
        let (Some(mut variant), true) = (variants.pop(), variants.is_empty()) else {
            bail!("{} is not the configuration of one run", file.path.display());
        };
        let absolute = path.canonicalize().with_context(|| format!("{} cannot be read", path.display()))?;
        if let Some(parent) = absolute.parent().and_then(Path::file_name) {
            variant.name = parent.to_string_lossy().into_owned();
        }
        let seed = *variant.experiment.seeds.first().ok_or_else(|| anyhow!("the run has no seed"))?;
        Ok(Self { variant, seed, folder })
    }

    /// Its names and seed.
    pub fn identity(&self) -> Identity {
        identity(&self.variant, self.seed)
    }

    /// How far the run is.
    ///
    /// # Errors
    /// A file of it cannot be read.
    pub fn standing(&self, registry: &Registry) -> Result<Standing> {
        if !self.folder.is_begun()? {
            return Ok(Standing::Missing);
        }
        if !self.folder.has_config()? {
            return Ok(Standing::Foreign);
        }
        let config = self.folder.config()?;
        if let Some(difference) =
            first_difference(&config, &provenance(registry, &self.variant, self.seed)?.config)
        {
            return Ok(Standing::Differs(difference));
        }
        Ok(match self.folder.summary()? {
            Some(summary) if summary.complete => Standing::Finished(Box::new(summary)),
            _ => Standing::Unfinished,
        })
    }

    /// Begins the run in a new folder, with the `parts` that were [prepared](prepare) for it, or prepares them. With `overwrite`, what stood
    /// there is removed.
    ///
    /// # Errors
    /// A plugin refuses, something is there, another process writes the run, or a file cannot be written. Then nothing is left of this launch.
    pub fn begin(&self, registry: &Registry, parts: Option<LoopParts>, overwrite: bool) -> Result<Launch> {
        let parts = parts.map_or_else(|| prepare(registry, &self.variant, self.seed), Ok)?;
        let provenance = provenance(registry, &self.variant, self.seed)?;
        let plugins = self.plugins_json(registry)?;
        // No other process may write the run while it is removed.
        let replaced = LockedCheckpoints::of(self.folder.path())?;
        let new = self.folder.create(&provenance.config, &plugins, overwrite)?;
        drop(replaced);
        let recorder = self.first_recorder(registry, provenance, &parts);
        let recorder = recorder.map_err(|error| new.discard_after(error))?;
        Ok(Launch { parts, recorder, state: None, new: Some(new), warnings: Vec::new() })
    }

    fn first_recorder(
        &self,
        registry: &Registry,
        provenance: Provenance,
        parts: &LoopParts,
    ) -> Result<Recorder> {
        // The lock comes first: until it is taken, another process may replace the folder.
        let store = match parts.settings.checkpoint_every {
            Some(_) => Some(CheckpointStore::create(self.folder.path(), provenance)?),
            None => None,
        };
        let recorder = self.recorder(registry, None, parts)?;
        Ok(match store {
            Some(store) => recorder.with_checkpoints(store, true),
            None => recorder,
        })
    }

    /// The recorder of a run that begins, or of one that goes on from `state`.
    pub(super) fn recorder(
        &self,
        registry: &Registry,
        state: Option<RecorderState>,
        parts: &LoopParts,
    ) -> Result<Recorder> {
        let experiment = &self.variant.experiment;
        let rules = experiment.rules().map(|choice| choice.plugin.clone()).collect();
        let solved_at = experiment.evaluation.as_ref().map_or(1.0, |evaluation| evaluation.solved_at);
        let is_deterministic = experiment.shield.deadline_us.is_none()
            && manifests(registry, &experiment.plugins())?.iter().all(|manifest| manifest.deterministic);
        let (folder, identity) = (self.folder.clone(), self.identity());
        let recorder = match state {
            None => Recorder::new(folder, identity, rules, solved_at)?,
            Some(state) => Recorder::reopen(folder, identity, rules, solved_at, state)?,
        };
        let kinds = parts.world.reset_kinds();
        let accepted = AcceptedRisk::of(experiment);
        Ok(recorder.reset_kinds(kinds).accepted_risk(accepted).deterministic(is_deterministic))
    }

    /// Which plugin each field of the experiment is, with version and hash.
    fn plugins_json(&self, registry: &Registry) -> Result<String> {
        plugins_json(registry, &self.variant.experiment.plugins())
    }
}

fn identity(variant: &Variant, seed: u64) -> Identity {
    Identity { experiment: variant.experiment.name.clone(), variant: variant.name.clone(), seed }
}

/// What a run of `variant` with `seed` is made of.
///
/// # Errors
/// A plugin is missing.
pub fn provenance(registry: &Registry, variant: &Variant, seed: u64) -> Result<Provenance> {
    let manifests = manifests(registry, &variant.experiment.plugins())?;
    let version =
        |manifest: &Manifest| PluginVersion { id: manifest.id.clone(), version: manifest.version.clone() };
    Ok(Provenance {
        config: variant.resolved_ron(seed, &|id| fields_of(&manifests, id)),
        plugins: manifests.iter().map(version).collect(),
    })
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
        let Self { parts, recorder, state, new, .. } = self;
        let budget = parts.settings.steps;
        let name = recorder.identity().to_string();
        let mut observer = Fanout(recorder, progress);
        let mut joint = JointLoop::new(parts, &mut observer, stop);
        if let Some(state) = &state {
            joint.go_on(state);
        }
        let ran = joint.run();
        let counters = *joint.counters();
        let findings = joint.findings().map(FoundInRun::from).collect();
        drop(joint);
        let ran = ran.with_context(|| format!("{name} failed after {} steps", counters.steps));
        let error = ran.as_ref().err().map(|error| format!("{error:#}"));
        // The run stays locked until it is decided whether its folder stays.
        let checkpoints = observer.0.take_checkpoints();
        let can_go_on = checkpoints.as_ref().is_some_and(CheckpointStore::has_checkpoint);
        observer.0.found(findings);
        let summary = observer.0.finish(&counters, budget, error);
        match new.filter(|_| counters.steps == 0 && (ran.is_err() || !can_go_on)) {
            None => ran.and(summary),
            Some(new) => match ran.and(summary) {
                Ok(summary) => new.discard().map(|()| summary),
                Err(error) => Err(new.discard_after(error)),
            },
        }
    }
}

/// A run as its last checkpoint has it, to look at or to try out. Nothing of it is written.
pub struct Restored {
    /// Which run it is.
    pub run: Run,
    /// The agents and rules have what they had learned; the worlds are new, the experience is empty.
    pub parts: LoopParts,
    /// Everything else that was saved.
    pub state: LoopState,
}

/// Reads a run's last checkpoint and gives its agents and rules what they had learned. `overrides` change the configuration of what is
/// tried out, for example of its evaluation.
///
/// # Errors
/// The folder is not that of a run, has no usable checkpoint, or a plugin cannot be loaded or refuses its state.
pub fn restore(registry: &Registry, folder: &RunFolder, overrides: &[Override]) -> Result<Restored> {
    let run = Run::of_folder(folder.clone(), overrides)?;
    let saved = last_checkpoint::<RecorderState>(folder.path())?;
    let mut parts = prepare(registry, &run.variant, run.seed)?;
    parts.restore_agents(&saved.state)?;
    Ok(Restored { run, parts, state: saved.state })
}
