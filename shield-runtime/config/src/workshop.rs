//! Makes the plugins that an experiment or a drop-in names, and leads what they refuse back to the user's file.

mod agents;
mod drop_in;

use std::time::Duration;

use indexmap::IndexMap;
use rand::Rng;
use rand_pcg::Pcg64;
use shield_api::{AbortRule, Learner, LearnerInfo, ResetTask, Setup, Spaces};

use crate::experiment::{ExperienceConfig, InputError, PluginChoice, RuleConfig, ShieldConfig, Source};
use shield_core::{
    controller::check_needs,
    critic::Critic,
    cycle::Memory,
    experience::Experience,
    shield::{Ladder, LadderParts, RuleTree},
};
use shield_host::plugin::{self, PluginError, Registry, Selection};

/// What draws random numbers. Each has a stream of its own, so that a change in one leaves the others alone.
#[derive(Debug, Clone, Copy)]
pub enum Stream {
    /// The environment.
    Environment,
    /// The environments of evaluations.
    EvaluationEnvironment,
    /// The forward agent.
    Forward,
    /// The reset agent.
    Reset,
    /// The reset task.
    ResetTask,
    /// The reset tasks of evaluations.
    EvaluationResetTask,
    /// The rules.
    Rules,
    /// The rules of evaluations.
    EvaluationRules,
    /// Batches of the forward agent.
    ForwardBatches,
    /// Batches of the reset agent.
    ResetBatches,
    /// Seeds of hard resets.
    HardResets,
    /// Bootstrap masks.
    Masks,
    /// Seeds of evaluation episodes.
    EvaluationSeeds,
    /// The success critic.
    Success,
    /// Batches of the success critic.
    SuccessBatches,
}

/// Where plugins are found, and what all of one run share.
pub struct Workshop<'a> {
    /// Where plugins are found.
    pub registry: &'a Registry,
    /// The text in which they are named.
    pub source: &'a Source,
    /// SHA-256 by plugin id.
    pub pins: &'a IndexMap<String, String>,
    /// Threads that each may use.
    pub threads: usize,
    /// Of every random number.
    pub seed: u64,
}

impl Workshop<'_> {
    /// A stream's random numbers.
    pub fn generator(&self, stream: Stream) -> Pcg64 {
        Pcg64::new(u128::from(self.seed), stream as u128)
    }

    /// A stream's first number, to seed a plugin.
    pub fn derived_seed(&self, stream: Stream) -> u64 {
        self.generator(stream).next_u64()
    }

    /// What a plugin is told when it is made.
    pub fn setup(&self, stream: Stream, spaces: &Spaces) -> Setup {
        // What the rules of an evaluation would report is none of the training's figures.
        let host = match stream {
            Stream::EvaluationRules => plugin::host_without_metrics(),
            _ => plugin::host(),
        };
        Setup::with_spaces(self.derived_seed(stream), self.threads, host, spaces.clone())
    }

    /// Which file a choice may come from.
    pub fn selection(&self, choice: &PluginChoice) -> Selection {
        let sha256 = self.pins.get(&choice.plugin).cloned();
        Selection { sha256, ..choice.selection() }
    }

    /// Makes the reset task.
    ///
    /// # Errors
    /// It is missing or refuses its configuration.
    pub fn reset_task(&self, choice: &PluginChoice, setup: &Setup) -> Result<Box<dyn ResetTask>, InputError> {
        let task = self.registry.reset_task(&self.selection(choice), choice.config.get_ron(), setup);
        Ok(Box::new(task.map_err(|error| self.input_error("reset_task", error))?))
    }

    /// The memory of agents with so many members, of the forward and of the reset agent.
    ///
    /// # Errors
    /// The memory does not have that much room.
    pub fn memory(
        &self,
        config: &ExperienceConfig,
        members: [usize; 2],
        success: Option<&Critic>,
        spaces: &Spaces,
    ) -> Result<Memory, InputError> {
        let kept = config.observations;
        kept.check(&spaces.observation).map_err(|error| self.refused("experience.observations", &error))?;
        let experience = Experience::new(config.capacity, spaces, members, config.bootstrap_probability)
            .and_then(|experience| experience.keeping(kept))
            .map(|experience| experience.with_abort_lifetime(config.abort_lifetime))
            .and_then(|experience| match success {
                None => Ok(experience),
                Some(_) => experience.with_undo(config.undo()),
            })
            .map_err(|error| self.refused("experience.capacity", &error))?;
        Ok(Memory { experience, masks: self.generator(Stream::Masks) })
    }

    /// What decides, for a reset agent and a success critic like these.
    pub fn ladder(
        &self,
        config: &ShieldConfig,
        reset: &dyn Learner,
        success: Option<&Critic>,
        spaces: &Spaces,
        stream: Stream,
    ) -> Result<Ladder, InputError> {
        let setup = &mut self.setup(stream, spaces);
        let rules = self.rules(&config.rules, "shield.rules", setup, reset.info())?;
        let parts = LadderParts {
            rules,
            warm_up_steps: config.warm_up_steps,
            fallback_action: config.fallback_action.clone(),
            projection: config.projection.clone(),
            deadline: config.deadline_us.map(Duration::from_micros),
        };
        parts.build(spaces, reset, success.map(Critic::info)).map_err(|error| match error.field() {
            Some("success_critic") => {
                let message = "a rule needs undo probabilities: name what estimates them, for example \
                               `success_critic: Some(plugin: \"success-critic\")`";
                self.source.error_at("shield", None, message)
            }
            _ => self.refused("shield", &error),
        })
    }

    fn rules(
        &self,
        rules: &[RuleConfig],
        path: &str,
        setup: &mut Setup,
        reset: LearnerInfo,
    ) -> Result<Vec<RuleTree>, InputError> {
        let mut trees = Vec::with_capacity(rules.len());
        for (index, rule) in rules.iter().enumerate() {
            let path = format!("{path}[{index}]");
            trees.push(match rule {
                RuleConfig::Rule(choice) => RuleTree::Rule(self.rule(choice, &path, setup, reset)?),
                RuleConfig::Soft { priority, rule } => {
                    RuleTree::soft(*priority, self.rule(rule, &format!("{path}.rule"), setup, reset)?)
                }
                RuleConfig::All(parts) => RuleTree::All(self.rules(parts, &path, setup, reset)?),
                RuleConfig::Any(parts) => RuleTree::Any(self.rules(parts, &path, setup, reset)?),
            });
        }
        Ok(trees)
    }

    fn rule(
        &self,
        choice: &PluginChoice,
        path: &str,
        setup: &mut Setup,
        reset: LearnerInfo,
    ) -> Result<Box<dyn AbortRule>, InputError> {
        setup.seed = setup.seed.wrapping_add(1);
        let rule = self.registry.abort_rule(&self.selection(choice), choice.config.get_ron(), setup);
        let rule = rule.map_err(|error| self.input_error(path, error))?;
        check_needs(rule.needs(), reset).map_err(|error| {
            let message = format!("`{path}` (`{}`): {}", choice.plugin, error.message());
            self.source.error_at(path, None, message)
        })?;
        Ok(Box::new(rule))
    }

    /// What a plugin says, at the place in the user's file that it speaks of.
    pub fn input_error(&self, path: &str, error: PluginError) -> InputError {
        match error.config_fault() {
            Some((message, position)) => self.source.error_at(&format!("{path}.config"), position, message),
            None if matches!(error, PluginError::NotPinned { .. }) => {
                self.source.error_at("pins", None, error.to_string())
            }
            None => self.source.error_at(&format!("{path}.plugin"), None, error.to_string()),
        }
    }

    /// What cannot be done with the value at `path`, at the field of it that the error names.
    pub fn refused(&self, path: &str, error: &shield_api::Error) -> InputError {
        let path = error.field().map_or_else(|| path.to_owned(), |field| format!("{path}.{field}"));
        self.source.error_at(&path, None, error.message())
    }
}
