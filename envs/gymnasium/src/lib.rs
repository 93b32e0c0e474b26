#![doc = include_str!("../README.md")]
#![deny(unsafe_code)]

mod config;
mod protocol;
#[cfg(test)]
mod tests;

use std::{cell::RefCell, process, time::Duration};

use shield_api::{
    Checkpoint, Environment, EnvironmentSpec, Error, ErrorKind, Frame, Plugin, Result, Setup, Space, Spaces,
    StepOutcome, check_finite,
};
use shield_worker::{Options, Waiting, Worker};

use config::{GymnasiumConfig, seconds};
use protocol::{Command, Drawn, Made, SpaceSize, Wanted};

/// The program of the worker. The interpreter is given it as an argument, so that nothing must be found on disk.
const WORKER: &str = include_str!("worker.py");

/// An environment of Gymnasium in a process of its own.
struct Gymnasium {
    id: String,
    /// In a cell, since only a picture tells how large pictures are.
    worker: RefCell<Worker>,
    spec: EnvironmentSpec,
    step_limit: Duration,
}

impl Checkpoint for Gymnasium {}

impl Plugin for Gymnasium {
    type Config = GymnasiumConfig;

    fn create(config: GymnasiumConfig, _setup: &Setup) -> Result<Self> {
        if config.id.is_empty() {
            let message = "`id` names no environment; give one, for example \"Pendulum-v1\"";
            return Err(Error::invalid_config(message).in_field("id"));
        }
        let start_limit = seconds("start_timeout_s", config.start_timeout_s)?;
        let step_limit = seconds("step_timeout_s", config.step_timeout_s)?;
        let mut worker = start(&config)?;
        let wanted = Wanted { id: &config.id, import: &config.import, kwargs: config.json_kwargs()? };
        let wanted = serde_json::to_string(&wanted).map_err(|error| Error::failed(error.to_string()))?;
        if !protocol::write_text(worker.memory(), &wanted) {
            return Err(Error::invalid_config("`kwargs` is longer than a megabyte").in_field("kwargs"));
        }
        ask(&mut worker, &config.id, Command::Make, start_limit, "start_timeout_s").map_err(|error| {
            let message = format!("{error} (the interpreter is `python: {:?}`)", config.python);
            Error::invalid_config(message).in_field(error.field().unwrap_or("id"))
        })?;
        let made = protocol::read_text(worker.memory());
        let made: Made = serde_json::from_str(&made)
            .map_err(|error| Error::failed(format!("the worker's description is not one: {error}")))?;
        let spec = describe(&mut worker, &made, &config)?;
        Ok(Self { id: config.id, worker: RefCell::new(worker), spec, step_limit })
    }
}

fn start(config: &GymnasiumConfig) -> Result<Worker> {
    let mut command = process::Command::new(&config.python);
    command.args(["-c", WORKER]);
    let options =
        Options { memory: protocol::MEMORY, waiting: Waiting::Blocking, farewell: Duration::from_secs(2) };
    Worker::start(command, options).map_err(|error| {
        let message = format!(
            "`python`: {error}. Name a Python interpreter, for example \".venv/bin/python\"; a relative path counts from the \
             working directory"
        );
        Error::invalid_config(message).in_field("python")
    })
}

/// One exchange with the worker. Allocates nothing on success.
fn ask(worker: &mut Worker, id: &str, command: Command, limit: Duration, field: &str) -> Result<()> {
    worker.memory().write(protocol::COMMAND, &[command as u32]);
    if let Err(error) = worker.call(limit) {
        let remedy = match error {
            shield_worker::WorkerError::Hung { .. } => {
                format!("\nIf it only needs longer, raise `{field}`")
            }
            _ => String::new(),
        };
        let failed = Error::failed(format!("{id}: while asked to {command:?}: {error}{remedy}"));
        return Err(if remedy.is_empty() { failed } else { failed.in_field(field) });
    }
    match worker.memory().get::<u32>(protocol::STATUS) {
        protocol::OK => Ok(()),
        protocol::UNFIT => Err(Error::invalid_config(protocol::read_text(worker.memory()))),
        _ => {
            let traceback = protocol::read_text(worker.memory());
            Err(Error::failed(format!("{id}: Python raised an exception in {command:?}:\n{traceback}")))
        }
    }
}

fn describe(worker: &mut Worker, made: &Made, config: &GymnasiumConfig) -> Result<EnvironmentSpec> {
    let mut offset = protocol::NUMBERS;
    let mut bounds = |length: usize| {
        let mut numbers = vec![0.0_f32; length];
        if offset + 4 * length > protocol::MEMORY {
            return Err(Error::failed("the worker's description is longer than the shared memory"));
        }
        worker.memory().read(offset, &mut numbers);
        offset += 4 * length;
        Ok(numbers)
    };
    let mut space = |size: &SpaceSize| {
        Ok::<_, Error>(match *size {
            SpaceSize::Discrete { length } => Space::Discrete { n: length },
            SpaceSize::Box { length } => Space::Box { low: bounds(length)?, high: bounds(length)? },
        })
    };
    let spaces = Spaces { observation: space(&made.observation)?, action: space(&made.action)? };
    let episode_length = config.episode_length.or(made.time_limit).ok_or_else(|| {
        let message = format!(
            "{} is registered without a time limit; give `episode_length`, the most steps of an episode",
            config.id
        );
        Error::invalid_config(message).in_field("id")
    })?;
    if episode_length == 0 {
        let message = "`episode_length` is 0; an episode has at least one step";
        return Err(Error::invalid_config(message).in_field("episode_length"));
    }
    Ok(EnvironmentSpec { spaces, episode_length, brings_reset_reward: false })
}

impl Gymnasium {
    fn ask(&mut self, command: Command) -> Result<()> {
        ask(self.worker.get_mut(), &self.id, command, self.step_limit, "step_timeout_s")
    }

    /// A picture of the present state, red, green and blue of each pixel, and its size.
    fn draw(&self) -> Result<(Drawn, Vec<u8>)> {
        let mut worker = self.worker.borrow_mut();
        ask(&mut worker, &self.id, Command::Render, self.step_limit, "step_timeout_s").map_err(|error| {
            match error.kind() {
                ErrorKind::InvalidConfig => Error::unsupported(error.to_string()),
                _ => error,
            }
        })?;
        let drawn: Drawn = serde_json::from_str(&protocol::read_text(worker.memory()))
            .map_err(|error| Error::failed(format!("the worker's picture has no size: {error}")))?;
        let offset =
            protocol::NUMBERS + 4 * (self.spec.spaces.action_len() + self.spec.spaces.observation_len());
        let length = drawn.width.checked_mul(drawn.height).and_then(|pixels| pixels.checked_mul(3));
        let length = length.filter(|length| (1..=protocol::MEMORY - offset).contains(length));
        let mut pixels =
            vec![0; length.ok_or_else(|| Error::failed(format!("{drawn:?} is no size of a picture")))?];
        worker.memory().read(offset, &mut pixels);
        Ok((drawn, pixels))
    }

    fn read_observation(&mut self, observation: &mut [f32]) -> Result<()> {
        let offset = protocol::NUMBERS + 4 * self.spec.spaces.action_len();
        self.worker.get_mut().memory().read(offset, observation);
        let what = "the environment's observation";
        check_finite(what, observation, self.spec.spaces.observation_len())
            .map_err(|error| Error::failed(format!("{}: {error}", self.id)))
    }
}

impl Environment for Gymnasium {
    fn spec(&self) -> EnvironmentSpec {
        self.spec.clone()
    }

    fn reset(&mut self, seed: u64, observation: &mut [f32]) -> Result<()> {
        shield_api::check_length("observation", observation, self.spec.spaces.observation_len())?;
        self.worker.get_mut().memory().write(protocol::SEED, &[seed]);
        self.ask(Command::Reset)?;
        self.read_observation(observation)
    }

    fn step(&mut self, action: &[f32], observation: &mut [f32]) -> Result<StepOutcome> {
        self.spec.spaces.action.check_action(action)?;
        shield_api::check_length("observation", observation, self.spec.spaces.observation_len())?;
        self.worker.get_mut().memory().write(protocol::NUMBERS, action);
        self.ask(Command::Step)?;
        self.read_observation(observation)?;
        let memory = self.worker.get_mut().memory();
        let reward = memory.get::<f64>(protocol::REWARD) as f32;
        if !reward.is_finite() {
            return Err(Error::failed(format!("{}: the environment's reward is {reward}", self.id)));
        }
        let flags: u32 = memory.get(protocol::FLAGS);
        Ok(StepOutcome {
            forward_reward: reward,
            terminated: flags & protocol::TERMINATED != 0,
            success: flags & protocol::SUCCESS != 0,
            ..StepOutcome::default()
        })
    }

    fn frame_size(&self) -> [usize; 2] {
        // Before its first reset an environment draws nothing; the picture is scaled then.
        self.draw().map_or([320, 240], |(drawn, _)| [drawn.width, drawn.height])
    }

    fn render(&mut self, frame: &mut Frame<'_>) -> Result<()> {
        let (drawn, picture) = self.draw()?;
        let (width, height) = (frame.width(), frame.height());
        for (index, pixel) in frame.pixels().chunks_exact_mut(3).enumerate() {
            let (column, row) = (index % width * drawn.width / width, index / width * drawn.height / height);
            let start = 3 * (row * drawn.width + column);
            pixel.copy_from_slice(&picture[start..start + 3]);
        }
        Ok(())
    }
}

shield_api::export_plugin! {
    environment "gymnasium" => Gymnasium { description: "Any Gymnasium environment, in a process of your own Python", deterministic: true }
}
