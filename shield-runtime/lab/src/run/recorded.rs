//! The shield whose decisions a folder holds: that of a run, or a drop-in.

use std::path::Path;

use anyhow::{Result, bail};

use super::{accepted_risk::AcceptedRisk, build::replay_ladder};
use shield_config::experiment::{
    DropInFile, ExperimentFile, InputError, Mode, Override, PluginChoice, Variant,
};
use shield_core::{cycle::restore_rules, shield::Ladder};
use shield_decisions::{
    provenance::Named,
    record::{RecordSettings, is_record, kept_rules},
};
use shield_host::plugin::Registry;

/// What the configuration in such a folder says, changed by overrides.
pub enum Recorded {
    /// Of a run.
    Run(Box<Variant>),
    /// Of the record of a drop-in.
    DropIn(Box<DropInFile>),
}

impl Recorded {
    /// Reads the configuration in `folder`.
    ///
    /// # Errors
    /// There is none, or an override does not fit.
    pub fn read(folder: &Path, overrides: &[Override]) -> Result<Self, InputError> {
        let path = folder.join("config.ron");
        if is_record(folder) {
            return DropInFile::read(path, overrides).map(|file| Self::DropIn(Box::new(file)));
        }
        let mut variants = ExperimentFile::read(path)?.variants(overrides, None)?;
        Ok(Self::Run(Box::new(variants.remove(0))))
    }

    /// Every plugin that is named.
    pub fn plugins(&self) -> Vec<Named<'_>> {
        match self {
            Self::Run(variant) => variant.experiment.plugins(),
            Self::DropIn(file) => file.config.plugins(),
        }
    }

    /// The first rule that is this plugin.
    pub fn rule(&self, id: &str) -> Option<&PluginChoice> {
        match self {
            Self::Run(variant) => variant.experiment.rules().find(|rule| rule.plugin == id),
            Self::DropIn(file) => file.config.rules().find(|rule| rule.plugin == id),
        }
    }

    /// The risk that the user accepts, if a rule has one.
    pub fn accepted_risk(&self) -> Option<AcceptedRisk> {
        match self {
            Self::Run(variant) => AcceptedRisk::of(&variant.experiment),
            Self::DropIn(file) => AcceptedRisk::of_rules(file.config.rules()),
        }
    }

    /// The decisions of every n-th step were recorded.
    ///
    /// # Errors
    /// The settings of the record are damaged.
    pub fn every(&self, folder: &Path) -> Result<u64> {
        Ok(match self {
            Self::Run(variant) => variant.experiment.record.decisions,
            Self::DropIn(_) => RecordSettings::read(folder)?.decisions,
        })
    }

    /// The rules as they judge, without projection and deadline, as they were when the first decision in `folder` was made.
    pub(super) fn ladder(&self, registry: &Registry, folder: &Path) -> Result<Ladder> {
        match self {
            Self::Run(variant) if variant.experiment.mode != Mode::Shielded => {
                bail!(variant.error_at(
                    "mode",
                    None,
                    "the run had no shield whose decisions could be replayed"
                ))
            }
            Self::Run(variant) => Ok(replay_ladder(registry, variant)?),
            Self::DropIn(file) => {
                let mut ladder = file.ladder_to_replay(registry)?;
                if let Some(states) = kept_rules(folder)? {
                    restore_rules(Some(&mut ladder), &states)?;
                }
                Ok(ladder)
            }
        }
    }
}
