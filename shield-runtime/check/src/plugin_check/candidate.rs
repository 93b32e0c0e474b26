//! The plugin under check: how instances of it are made, and what its file must be.

use std::time::{Duration, Instant};

use shield_api::{
    AbortRule, Environment, ErrorKind, Learner, Policy, ResetTask, Setup, Space, Spaces, SuccessCritic,
    manifest::{Manifest, ManifestField},
};

use super::probe::Finding;
use crate::environment_check::Verdict::Passed;
use shield_host::plugin::{Kind, PluginError, Registry, Selection, host, read_manifests};

const LONGEST_SCAN: Duration = Duration::from_millis(100);

/// A plugin to be checked.
pub struct Candidate<'a> {
    /// Loads it.
    pub registry: &'a Registry,
    /// Its id and file.
    pub selection: Selection,
    /// Its kind.
    pub kind: Kind,
    /// What its file says of it.
    pub manifest: &'a Manifest,
    /// RON text; empty for the defaults.
    pub config: String,
    /// Seed of instances and questions.
    pub seed: u64,
}

/// The spaces in which a plugin is tried: one that wants alternatives refuses the first.
fn spaces_to_try() -> [Spaces; 3] {
    let unbounded = Space::unbounded(4);
    let pushes = Space::uniform(2, -1.0, 1.0);
    [
        Spaces { observation: unbounded.clone(), action: pushes },
        Spaces { observation: unbounded, action: Space::Discrete { n: 3 } },
        Spaces { observation: Space::Discrete { n: 5 }, action: Space::Discrete { n: 3 } },
    ]
}

type Made<T> = Result<Box<T>, String>;

impl Candidate<'_> {
    pub(crate) fn environment(&self) -> Made<dyn Environment> {
        let setup = Setup::new(self.seed, 1, host());
        let made = self.registry.environment(&self.selection, &self.config, &setup);
        made.map(|made| Box::new(made) as _).map_err(|error| error.to_string())
    }

    pub(crate) fn learner(&self, spaces: &Spaces, seed: u64, threads: usize) -> Made<dyn Learner> {
        let made = self.registry.learner(&self.selection, &self.config, &setup(spaces, seed, threads));
        made.map(|made| Box::new(made) as _).map_err(|error| error.to_string())
    }

    pub(crate) fn policy(&self, spaces: &Spaces, seed: u64, threads: usize) -> Made<dyn Policy> {
        let made = self.registry.policy(&self.selection, &self.config, &setup(spaces, seed, threads));
        made.map(|made| Box::new(made) as _).map_err(|error| error.to_string())
    }

    pub(crate) fn abort_rule(&self, spaces: &Spaces, seed: u64, threads: usize) -> Made<dyn AbortRule> {
        let made = self.registry.abort_rule(&self.selection, &self.config, &setup(spaces, seed, threads));
        made.map(|made| Box::new(made) as _).map_err(|error| error.to_string())
    }

    pub(crate) fn reset_task(&self, spaces: &Spaces, seed: u64, threads: usize) -> Made<dyn ResetTask> {
        let made = self.registry.reset_task(&self.selection, &self.config, &setup(spaces, seed, threads));
        made.map(|made| Box::new(made) as _).map_err(|error| error.to_string())
    }

    pub(crate) fn success_critic(
        &self,
        spaces: &Spaces,
        seed: u64,
        threads: usize,
    ) -> Made<dyn SuccessCritic> {
        let setup = setup(spaces, seed, threads);
        let made = self.registry.success_critic(&self.selection, &self.config, &setup);
        made.map(|made| Box::new(made) as _).map_err(|error| error.to_string())
    }

    /// The first spaces that the plugin accepts.
    pub(crate) fn spaces(&self) -> Result<Spaces, String> {
        // The first are the usual ones, so that their refusal says most.
        let mut refusals = Vec::new();
        for spaces in spaces_to_try() {
            match self.make(&self.config, &spaces) {
                Ok(()) => return Ok(spaces),
                Err(error) => refusals.push(error.to_string()),
            }
        }
        let refusal = refusals.first().map_or("", String::as_str);
        Err(format!(
            "no instance can be made: {refusal}; `--config` gives it the configuration that it needs"
        ))
    }

    /// Whether an instance can be made.
    fn make(&self, config: &str, spaces: &Spaces) -> Result<(), PluginError> {
        let (registry, selection) = (self.registry, &self.selection);
        let setup = setup(spaces, self.seed, 1);
        match self.kind {
            Kind::Environment => {
                registry.environment(selection, config, &Setup::new(self.seed, 1, host())).map(drop)
            }
            Kind::Learner => registry.learner(selection, config, &setup).map(drop),
            Kind::Policy => registry.policy(selection, config, &setup).map(drop),
            Kind::AbortRule => registry.abort_rule(selection, config, &setup).map(drop),
            Kind::ResetTask => registry.reset_task(selection, config, &setup).map(drop),
            Kind::SuccessCritic => registry.success_critic(selection, config, &setup).map(drop),
        }
    }

    pub(super) fn scan(&self) -> Finding {
        let path = self.selection.path.as_deref().ok_or("the file is not known")?;
        let start = Instant::now();
        let manifests = read_manifests(path).map_err(|error| error.to_string())?;
        let time = start.elapsed();
        if time > LONGEST_SCAN {
            return Err(format!("reading the manifest takes {} ms", time.as_millis()));
        }
        Ok(Passed(format!("{} in the file, {} µs", manifests.len(), time.as_micros())))
    }

    pub(super) fn load(&self) -> Finding {
        let spaces = self.spaces()?;
        Ok(Passed(match self.kind {
            Kind::Environment => String::new(),
            _ => format!("with {}", described(&spaces)),
        }))
    }

    pub(super) fn manifest(&self) -> Finding {
        let Manifest { version, description, license, fields, .. } = self.manifest;
        for (what, text) in [("version", version), ("description", description), ("licence", license)] {
            if text.trim().is_empty() {
                return Err(format!("its {what} is empty"));
            }
        }
        if let Some(field) = fields.iter().find(|field| field.doc.is_empty()) {
            return Err(format!("nothing says what the field `{}` does", field.name));
        }
        let spaces = self.spaces()?;
        // Fields that a plugin must be given have no default that makes an instance.
        let are_given = |field: &&ManifestField| !self.config.contains(&format!("{}:", field.name));
        let defaults =
            fields.iter().filter(are_given).map(|field| format!("{}: {}", field.name, field.default));
        let config = with_fields(&self.config, &defaults.collect::<Vec<_>>().join(", "));
        self.make(&config, &spaces)
            .map_err(|error| format!("its own defaults {config} are refused: {error}"))?;
        Ok(Passed(format!("{} fields", fields.len())))
    }

    pub(super) fn unknown_field(&self) -> Finding {
        let spaces = self.spaces()?;
        for config in [with_fields(&self.config, "no_such_field: 1"), "(((".into()] {
            match self.make(&config, &spaces) {
                Ok(()) => return Err(format!("the configuration {config} is accepted")),
                Err(error) if error.config_fault().is_some() => {}
                Err(PluginError::Create { kind: ErrorKind::Panicked, message, .. }) => {
                    return Err(format!("it panics at the configuration {config}: {message}"));
                }
                Err(error) => {
                    return Err(format!(
                        "the configuration {config} is refused, but not as a wrong one: {error}"
                    ));
                }
            }
        }
        Ok(Passed(String::new()))
    }
}

fn setup(spaces: &Spaces, seed: u64, threads: usize) -> Setup {
    Setup::with_spaces(seed, threads, host(), spaces.clone())
}

/// `(a: 1)` with more fields.
fn with_fields(config: &str, more: &str) -> String {
    let config = config.trim();
    let inside =
        if config.len() > 2 { config[1..config.len() - 1].trim_end().trim_end_matches(',') } else { "" };
    let comma = if inside.is_empty() || more.is_empty() { "" } else { ", " };
    format!("({inside}{comma}{more})")
}

fn described(spaces: &Spaces) -> String {
    let one = |space: &Space| match space {
        Space::Box { low, .. } => format!("{} numbers", low.len()),
        Space::Discrete { n } => format!("one of {n}"),
    };
    format!("observations of {} and actions of {}", one(&spaces.observation), one(&spaces.action))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_are_added_inside_the_outermost_brackets() {
        for (config, expected) in [
            ("", "(x: 1)"),
            ("()", "(x: 1)"),
            ("(a: 2)", "(a: 2, x: 1)"),
            (" (a: Some((b: 1)),) ", "(a: Some((b: 1)), x: 1)"),
        ] {
            assert_eq!(with_fields(config, "x: 1"), expected);
        }
        assert_eq!(with_fields("(a: 2)", ""), "(a: 2)");
    }
}
