//! From a configuration to a shield that can decide.

use shield_api::{Learner, ResetTask, Spaces};

use super::{Stream, Workshop};
use crate::experiment::{DropInFile, InputError, SpacesConfig, cycle_settings};
use shield_core::{
    agent::Agent,
    controller::Controller,
    cycle::{CycleParts, CycleSettings, ResetCycle},
    drop_in::DropIn,
    experience::AgentRole,
    shield::Ladder,
};
use shield_host::plugin::Registry;

impl DropInFile {
    /// Loads and configures everything that the file names, for an environment with these spaces; without any, for those in the file.
    ///
    /// # Errors
    /// A plugin is missing or broken, refuses its configuration, or does not fit the others; there are no spaces, or two different ones.
    pub fn open(&self, registry: &Registry, spaces: Option<Spaces>) -> Result<DropIn, InputError> {
        self.assemble(registry, spaces, None)
    }

    /// As [`open`](Self::open), with a reset agent that the program gives and the file does not name.
    ///
    /// # Errors
    /// As for `open`; the file names a reset agent.
    pub fn open_with(
        &self,
        registry: &Registry,
        spaces: Option<Spaces>,
        reset: Controller,
    ) -> Result<DropIn, InputError> {
        self.assemble(registry, spaces, Some(reset))
    }

    fn assemble(
        &self,
        registry: &Registry,
        spaces: Option<Spaces>,
        given: Option<Controller>,
    ) -> Result<DropIn, InputError> {
        let Self { config, source } = self;
        let (pins, threads, seed) = (&config.pins, config.threads, config.seed);
        let workshop = Workshop { registry, source, pins, threads, seed };
        let spaces = spaces_of(self, spaces)?;
        let task = self.reset_task(registry, &spaces)?;
        let reset = reset_agent(self, &workshop, &spaces, given)?;
        let learned = &config.experience;
        let success = workshop.success_critic(&config.shield, learned.batch, &spaces)?;
        let ladder = workshop.ladder(&config.shield, &*reset, success.as_ref(), &spaces, Stream::Rules)?;
        let members = [0, reset.info().members];
        let memory = workshop.memory(learned, members, success.as_ref(), &spaces)?;
        let sampler = workshop.generator(Stream::ResetBatches);
        let reset = Agent::new(AgentRole::Reset, reset, learned.batch, &spaces, sampler);
        let settings = cycle_settings(&config.shield, learned);
        let learns = settings.reset_updates() > 0;
        let parts = CycleParts {
            forward: None,
            reset: Some(reset),
            success,
            ladder: Some(ladder),
            memory: learns.then_some(memory),
        };
        let settings = CycleSettings {
            episode_length: config.episode_length,
            explores: learns,
            values_attempts: false,
            stores_forward: false,
            hard_reset_cost: config.hard_reset_cost,
            ..settings
        };
        let lengths = [spaces.observation_len(), spaces.action_len()];
        DropIn::new(ResetCycle::new(settings, parts, lengths), task)
            .and_then(|drop_in| drop_in.with_calibration_resets(config.calibration_resets))
            .map_err(|error| workshop.refused("shield", &error))
    }
}

impl DropInFile {
    /// The rules as they judge, without projection and deadline, for an environment with the spaces that are written. A reset agent that the
    /// program gave is not known: in its place stands one that is not asked.
    ///
    /// # Errors
    /// As for [`open`](Self::open).
    pub fn ladder_to_replay(&self, registry: &Registry) -> Result<Ladder, InputError> {
        let Self { config, source } = self;
        let mut shield = config.shield.clone();
        (shield.projection, shield.deadline_us) = (None, None);
        let (pins, threads, seed) = (&config.pins, config.threads, config.seed);
        let workshop = Workshop { registry, source, pins, threads, seed };
        let spaces = spaces_of(self, None)?;
        let given = config.reset.is_none().then(|| Controller::from_fn(|_, _| Ok(())));
        let reset = reset_agent(self, &workshop, &spaces, given)?;
        let success = workshop.success_critic(&shield, 0, &spaces)?;
        workshop.ladder(&shield, &*reset, success.as_ref(), &spaces, Stream::Rules)
    }

    /// What says what "reset" means, without a shield around it; `None` where the caller does.
    ///
    /// # Errors
    /// It is missing or broken, or refuses its configuration.
    pub fn reset_task(
        &self,
        registry: &Registry,
        spaces: &Spaces,
    ) -> Result<Option<Box<dyn ResetTask>>, InputError> {
        let Self { config, source } = self;
        let Some(choice) = &config.reset_task else { return Ok(None) };
        let (pins, threads, seed) = (&config.pins, config.threads, config.seed);
        let workshop = Workshop { registry, source, pins, threads, seed };
        workshop.reset_task(choice, &workshop.setup(Stream::ResetTask, spaces)).map(Some)
    }
}

fn reset_agent(
    file: &DropInFile,
    workshop: &Workshop<'_>,
    spaces: &Spaces,
    given: Option<Controller>,
) -> Result<Box<dyn Learner>, InputError> {
    let error = |message: &str| Err(file.source.error_at("reset", None, message));
    match (given, &file.config.reset) {
        (Some(given), None) => Ok(Box::new(given)),
        (None, Some(reset)) => workshop.reset_agent(reset, spaces),
        (Some(_), Some(_)) => error("the program gives the reset agent: leave `reset` out"),
        (None, None) => error(
            "nothing undoes: name a reset agent, for example `reset: (plugin: \"ddpg\")` or `reset: Policy(plugin: …)`",
        ),
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
