//! From a configuration to a shield that can decide.

use shield_api::Spaces;

use super::{Stream, Workshop};
use crate::{
    agent::Agent,
    drop_in::{DropIn, Learning},
    experience::{AgentRole, Experience},
    experiment::{DropInConfig, DropInFile, InputError, SpacesConfig},
    plugin::Registry,
    shield::{ResetSettings, Shield},
};

impl DropInFile {
    /// Loads and configures everything that the file names, for an environment with these spaces; without any, for those in the file.
    ///
    /// # Errors
    /// A plugin is missing or broken, refuses its configuration, or does not fit the others; there are no spaces, or two different ones.
    pub fn open(&self, registry: &Registry, spaces: Option<Spaces>) -> Result<DropIn, InputError> {
        let Self { config, source } = self;
        let (pins, threads, seed) = (&config.pins, config.threads, config.seed);
        let workshop = Workshop { registry, source, pins, threads, seed };
        let spaces = spaces_of(self, spaces)?;
        let task = match &config.reset_task {
            None => None,
            Some(choice) => Some(workshop.reset_task(choice, &workshop.setup(Stream::ResetTask, &spaces))?),
        };
        let learner = workshop.learner("reset", &config.reset, &workshop.setup(Stream::Reset, &spaces))?;
        let ladder = workshop.ladder(&config.shield, &*learner, &spaces, Stream::Rules)?;
        let settings = &config.experience;
        let members = [0, learner.info().members];
        let experience = Experience::new(settings.capacity, &spaces, members, settings.bootstrap_probability)
            .map_err(|error| workshop.refused("experience.capacity", &error))?;
        let sampler = workshop.generator(Stream::ResetBatches);
        let agent = Agent::new(AgentRole::Reset, learner, settings.batch, &spaces, sampler);
        let learns = settings.updates_per_step > 0;
        let shield = Shield::new(ladder, agent, resets(config), learns);
        let learning = Learning {
            experience,
            updates_per_step: settings.updates_per_step,
            updates: settings.updates,
            endings: settings.endings(),
            cost_weight: settings.cost_weight,
            masks: workshop.generator(Stream::Masks),
        };
        let drop_in = DropIn::new(shield, task).hard_reset_cost(config.hard_reset_cost);
        Ok(if learns { drop_in.learning(learning) } else { drop_in })
    }
}

fn resets(config: &DropInConfig) -> ResetSettings {
    let shield = &config.shield;
    ResetSettings {
        attempts: shield.reset_attempts.limit(),
        episode_length: config.episode_length,
        stop_on_reset: shield.stop_on_reset,
        test: shield.reset_test,
        between_attempts: shield.between_attempts,
        shield_exploration: shield.shield_exploration,
    }
}

fn spaces_of(file: &DropInFile, given: Option<Spaces>) -> Result<Spaces, InputError> {
    let written = file.config.spaces.clone().map(SpacesConfig::into_spaces);
    let error = |message: &str| file.source.error_at("spaces", None, message);
    match (given, written) {
        (Some(given), Some(written)) if given != written => {
            Err(error("these are not the spaces of the environment; leave them out"))
        }
        (Some(spaces), _) | (None, Some(spaces)) => Ok(spaces),
        (None, None) => Err(error(
            "the spaces are not known: for example `spaces: (observation: Unbounded(4), action: Box(low: [-1.0], high: [1.0]))`",
        )),
    }
}
