//! Experiments: RON files, their variants, and where in them a fault lies.

mod config;
mod defaults;
mod difference;
mod drop_in;
mod edit;
mod error;
mod overrides;
mod path;
mod pins;
mod resolved;
mod ron_text;
#[cfg(test)]
mod tests;
mod validate;
mod variant;

use std::path::{Path, PathBuf};

use shield_api::{
    notation::{Fault, Node, did_you_mean, parse},
    regular_file,
};

pub use config::{
    AttemptLength, BetweenAttempts, CheckpointConfig, DropInConfig, Endings, EvaluatedAgent,
    EvaluationConfig, ExperienceConfig, Experiment, Forward, Mode, OnAbort, OnResetFailure, OnResetSuccess,
    OnWorkerFailure, PluginChoice, ProjectionConfig, QpConfig, RecordConfig, Reset, ResetAttempts, ResetTest,
    RuleConfig, ShieldConfig, SpaceConfig, SpacesConfig, Unlimited, Updates, WorkerConfig, cycle_settings,
};
pub use defaults::Defaults;
pub use difference::{Difference, differences, first_difference};
pub use drop_in::DropInFile;
pub use error::{InputError, Location};
pub use overrides::Override;
pub use ron_text::RonText;
pub use validate::check_folder_name;
pub use variant::Source;
pub use variant::Variant;

use overrides::{Declared, declared};

/// The name of the variant of an experiment that declares none.
const ONLY_VARIANT: &str = "default";

/// The text of an experiment, and how messages name it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ExperimentFile {
    /// As the user named it.
    pub path: PathBuf,
    /// RON.
    pub text: String,
}

impl ExperimentFile {
    /// Reads a file; what it says is checked by [`variants`](Self::variants).
    ///
    /// # Errors
    /// The file cannot be read or is not UTF-8 text.
    pub fn read(path: impl AsRef<Path>) -> Result<Self, InputError> {
        let path = path.as_ref();
        let text = regular_file::read_to_string(path).map_err(|error| InputError {
            location: Location::File { file: path.display().to_string(), position: None },
            message: format!("the file cannot be read: {error}"),
            remedy: None,
        })?;
        Ok(Self::from_text(path, text))
    }

    /// An experiment that is in memory already; messages call it `name`.
    pub fn from_text(name: impl AsRef<Path>, text: impl Into<String>) -> Self {
        Self { path: name.as_ref().to_owned(), text: text.into() }
    }

    /// The variants in the order of the file, or the one that it is if it declares none, each with the overrides `sets` after its own.
    /// With `only`, just those named there.
    ///
    /// # Errors
    /// The first fault, with its place and, where known, the remedy.
    pub fn variants(&self, sets: &[Override], only: Option<&[String]>) -> Result<Vec<Variant>, InputError> {
        let root = self.tree()?;
        let declared = self.declared(&root).map_err(|fault| self.error(fault))?;
        if let Some(wanted) = only {
            self.know_all(wanted, &declared)?;
        }
        let is_wanted = |name: &str| only.is_none_or(|wanted| wanted.iter().any(|one| one == name));
        if declared.is_empty() {
            let variant = Variant::read(self, &root, ONLY_VARIANT, false, sets.to_vec())?;
            pins::check_used(std::slice::from_ref(&variant))?;
            return Ok(vec![variant]);
        }
        let read = |Declared { name, mut overrides, .. }| {
            overrides.extend_from_slice(sets);
            Variant::read(self, &root, &name, true, overrides)
        };
        let wanted = declared.into_iter().filter(|variant| is_wanted(&variant.name));
        let variants = wanted.map(read).collect::<Result<Vec<_>, _>>()?;
        if only.is_none() {
            pins::check_used(&variants)?;
        }
        Ok(variants)
    }

    /// The tree of its text.
    fn tree(&self) -> Result<Node, InputError> {
        parse(&self.text).map_err(|fault| self.error(fault))
    }

    fn error(&self, fault: Fault) -> InputError {
        let location = self.location(fault.offset());
        InputError { location, message: fault.message, remedy: fault.remedy }
    }

    fn declared(&self, root: &Node) -> Result<Vec<Declared>, Fault> {
        let declared = declared(self, root)?;
        for variant in &declared {
            validate::folder_name("", &variant.name)
                .map_err(|complaint| Fault::new(variant.name_start, complaint.message))?;
        }
        Ok(declared)
    }

    fn know_all(&self, wanted: &[String], declared: &[Declared]) -> Result<(), InputError> {
        let mut known: Vec<&str> = declared.iter().map(|variant| variant.name.as_str()).collect();
        if known.is_empty() {
            known.push(ONLY_VARIANT);
        }
        let Some(unknown) = wanted.iter().find(|name| !known.contains(&name.as_str())) else {
            return Ok(());
        };
        Err(InputError {
            location: Location::File { file: self.path.display().to_string(), position: None },
            message: format!("there is no variant `{unknown}`; there are: {}", known.join(", ")),
            remedy: did_you_mean(unknown, known.iter().copied()),
        })
    }
}
