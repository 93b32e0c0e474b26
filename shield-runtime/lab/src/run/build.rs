//! From an experiment to a run that can start: every plugin loaded and configured, before anything is written.

use shield_api::{Environment, Host, Learner, Setup, Spaces};

use crate::{
    evaluation::Evaluator,
    joint_loop::{LoopParts, LoopSettings},
    lanes::Lanes,
};
use shield_config::{
    experiment::{
        EvaluatedAgent, EvaluationConfig, Experiment, Forward, InputError, Mode, PluginChoice, Variant,
        cycle_settings,
    },
    workshop::{Stream, Workshop},
};
use shield_core::{
    agent::{Agent, ForwardAgent},
    critic::Critic,
    cycle::{CycleParts, CycleSettings},
    experience::AgentRole,
    shield::Ladder,
    world::{RestartFlag, World},
};
use shield_host::plugin::{self, PluginError, Registry};

/// Instances of the environment that an evaluation has at most. A constant, so that results do not depend on the machine.
const MOST_LANES: u64 = 4;

/// Loads and configures everything that a run of `variant` with `seed` needs. Writes nothing.
///
/// # Errors
/// A plugin is missing or broken, refuses its configuration, or does not fit the others.
pub fn prepare(registry: &Registry, variant: &Variant, seed: u64) -> Result<LoopParts, InputError> {
    Builder::new(registry, variant, seed).prepare()
}

/// The rules of a variant as they judge, without projection and deadline.
pub(super) fn replay_ladder(registry: &Registry, variant: &Variant) -> Result<Ladder, InputError> {
    let mut bare = variant.clone();
    (bare.experiment.shield.projection, bare.experiment.shield.deadline_us) = (None, None);
    let seed = bare.experiment.seeds[0];
    let builder = Builder::new(registry, &bare, seed);
    let spaces =
        builder.world([Stream::Environment, Stream::ResetTask], 0, plugin::host())?.spec().spaces.clone();
    let reset = builder.reset(&spaces)?;
    let shield = &bare.experiment.shield;
    let success = builder.workshop.success_critic(shield, 0, &spaces)?;
    builder.ladder(&*reset, success.as_ref(), &spaces, Stream::Rules)
}

struct Builder<'a> {
    workshop: Workshop<'a>,
    variant: &'a Variant,
    experiment: &'a Experiment,
}

impl<'a> Builder<'a> {
    fn new(registry: &'a Registry, variant: &'a Variant, seed: u64) -> Self {
        let experiment = &variant.experiment;
        let (pins, threads) = (&experiment.pins, experiment.threads);
        let workshop = Workshop { registry, source: variant.source(), pins, threads, seed };
        Self { workshop, variant, experiment }
    }

    fn prepare(&self) -> Result<LoopParts, InputError> {
        let experiment = self.experiment;
        let world = self.world([Stream::Environment, Stream::ResetTask], 0, plugin::host())?;
        if experiment.record.states_every > 0 {
            let kept = world.save_environment(&mut Vec::new());
            kept.map_err(|error| self.workshop.refused("record.states_every", &error))?;
        }
        let spaces = world.spec().spaces.clone();
        let mode = &experiment.mode;
        let forward = match mode {
            Mode::ResetOnly { .. } => None,
            _ => Some(self.forward(&spaces)?),
        };
        let reset = match mode {
            Mode::Shielded | Mode::ResetOnly { .. } => Some(self.reset(&spaces)?),
            Mode::StatusQuo | Mode::ForwardOnly => None,
        };
        let config = &experiment.experience;
        let success = match mode {
            Mode::Shielded => self.workshop.success_critic(&experiment.shield, config.batch, &spaces)?,
            _ => None,
        };
        let ladder = match (mode, &reset) {
            (Mode::Shielded, Some(reset)) => {
                let mut ladder = self.ladder(&**reset, success.as_ref(), &spaces, Stream::Rules)?;
                // A recorded decision can be judged again by other settings.
                ladder.be_thorough(experiment.record.decisions > 0);
                Some(ladder)
            }
            _ => None,
        };
        let evaluator = match &experiment.evaluation {
            None => None,
            Some(evaluation) => {
                Some(self.evaluator(evaluation, reset.as_deref(), success.as_ref(), &spaces)?)
            }
        };
        if let Mode::ResetOnly { start: Some(start) } = mode {
            self.check_start("mode", start, &world)?;
        }
        let members = [
            forward.as_ref().map_or(0, ForwardAgent::members),
            reset.as_ref().map_or(0, |reset| reset.info().members),
        ];
        let sampler = self.workshop.generator(Stream::ResetBatches);
        let memory = self.workshop.memory(config, members, success.as_ref(), &spaces)?;
        let agents = CycleParts {
            forward,
            reset: reset.map(|reset| Agent::new(AgentRole::Reset, reset, config.batch, &spaces, sampler)),
            success,
            ladder,
            memory: Some(memory),
        };
        let resets = self.workshop.generator(Stream::HardResets);
        Ok(LoopParts { settings: loop_settings(experiment), world, agents, evaluator, resets })
    }

    /// The environment with its reset task, each with a stream of its own. `instance` tells several of one stream apart.
    fn world(
        &self,
        [environment, task]: [Stream; 2],
        instance: u64,
        host: Host,
    ) -> Result<World, InputError> {
        let choice = &self.experiment.environment;
        let seed = |stream| self.workshop.derived_seed(stream).wrapping_add(instance);
        let setup = Setup::new(seed(environment), self.experiment.threads, host);
        let (environment, restarts) = self
            .environment(choice, &setup)
            .map_err(|error| self.workshop.input_error("environment", error))?;
        let spaces = environment.spec().spaces;
        let setup = Setup::with_spaces(seed(task), self.experiment.threads, host, spaces);
        let task = match &self.experiment.reset_task {
            None => None,
            Some(choice) => Some(self.workshop.reset_task(choice, &setup)?),
        };
        let world =
            World::new(environment, task).map_err(|error| self.workshop.refused("environment", &error))?;
        Ok(world.restarted_by(restarts))
    }

    /// The environment and, if it can be put in the place of a lost one, the flag that says so.
    fn environment(
        &self,
        choice: &PluginChoice,
        setup: &Setup,
    ) -> Result<(Box<dyn Environment>, Option<RestartFlag>), PluginError> {
        let (selection, config) = (self.workshop.selection(choice), choice.config.get_ron());
        Ok(match choice.isolation() {
            None => (Box::new(self.workshop.registry.environment(&selection, config, setup)?), None),
            Some(isolation) => {
                let environment =
                    self.workshop.registry.isolated_environment(&selection, config, setup, isolation)?;
                let restarts = environment.was_restarted();
                (Box::new(environment), Some(restarts))
            }
        })
    }

    fn forward(&self, spaces: &Spaces) -> Result<ForwardAgent, InputError> {
        let setup = self.workshop.setup(Stream::Forward, spaces);
        match &self.experiment.forward {
            Forward::Learner(choice) => {
                let learner = self.workshop.learner("forward", choice, &setup)?;
                let sampler = self.workshop.generator(Stream::ForwardBatches);
                let batch = self.experiment.experience.batch;
                let agent = Agent::new(AgentRole::Forward, learner, batch, spaces, sampler);
                Ok(ForwardAgent::Learner(Box::new(agent)))
            }
            Forward::Policy(choice) => {
                Ok(ForwardAgent::Policy(self.workshop.policy("forward", choice, &setup)?))
            }
        }
    }

    fn reset(&self, spaces: &Spaces) -> Result<Box<dyn Learner>, InputError> {
        let reset = self.experiment.reset.as_ref().expect("validated: modes with a reset agent name one");
        self.workshop.reset_agent(reset, spaces)
    }

    fn ladder(
        &self,
        reset: &dyn Learner,
        success: Option<&Critic>,
        spaces: &Spaces,
        stream: Stream,
    ) -> Result<Ladder, InputError> {
        self.workshop.ladder(&self.experiment.shield, reset, success, spaces, stream)
    }

    fn evaluator(
        &self,
        config: &EvaluationConfig,
        reset: Option<&dyn Learner>,
        success: Option<&Critic>,
        spaces: &Spaces,
    ) -> Result<Evaluator, InputError> {
        // An isolated environment costs a process each.
        let is_isolated = self.experiment.environment.isolate;
        let lanes = if is_isolated { 1 } else { u64::from(config.episodes).clamp(1, MOST_LANES) };
        let streams = [Stream::EvaluationEnvironment, Stream::EvaluationResetTask];
        let host = plugin::host_without_metrics();
        let worlds = (0..lanes).map(|lane| self.world(streams, lane, host));
        let worlds = worlds.collect::<Result<Vec<World>, InputError>>()?;
        if let Some(start) = &config.start {
            self.check_start("evaluation.start", start, &worlds[0])?;
        }
        let batch = Lanes::new(worlds, self.experiment.threads)
            .map_err(|error| self.workshop.refused("threads", &error))?;
        let ladder = match reset {
            Some(reset) if self.experiment.is_evaluated_with_shield() => {
                Some(self.ladder(reset, success, spaces, Stream::EvaluationRules)?)
            }
            _ => None,
        };
        // Where only the reset agent exists, it is the one to be evaluated.
        let agent = match self.experiment.mode {
            Mode::ResetOnly { .. } => EvaluatedAgent::Reset,
            _ => config.agent,
        };
        let seed = self.workshop.derived_seed(Stream::EvaluationSeeds);
        Evaluator::new(batch, ladder, agent, config.start.clone(), config.episodes, seed)
            .map_err(|error| self.workshop.refused("evaluation", &error))
    }

    fn check_start(&self, path: &str, start: &str, world: &World) -> Result<(), InputError> {
        let known = world.starts();
        if known.iter().any(|name| name == start) {
            return Ok(());
        }
        let known =
            if known.is_empty() { "it has none".into() } else { format!("it has {}", known.join(", ")) };
        let message = format!("the environment has no start named {start:?}; {known}");
        Err(self.variant.error_at(path, None, message))
    }
}

fn loop_settings(experiment: &Experiment) -> LoopSettings {
    let cycle = CycleSettings {
        mode: experiment.mode.clone(),
        hard_reset_cost: experiment.hard_reset_cost,
        ..cycle_settings(&experiment.shield, &experiment.experience)
    };
    LoopSettings {
        cycle,
        calibration_resets: experiment.calibration_resets,
        steps: experiment.steps,
        record: experiment.record,
        checkpoint_every: experiment.checkpoint.as_ref().map(|checkpoint| checkpoint.every),
        evaluate_every: experiment.evaluation.as_ref().map(|evaluation| evaluation.every),
    }
}
