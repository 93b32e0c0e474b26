//! What one robot's file provides, and the environment that is made of it.

use rand::SeedableRng;
use rand_pcg::Pcg64;
use shield_api::{
    Checkpoint, Environment, EnvironmentSpec, Error, Frame, Plugin, PluginConfig, ResetKind, Result, Setup,
    Space, Spaces, StepOutcome, check_length,
};

use crate::noise::Noise;
use crate::picture::View;
use crate::simulation::Simulation;

/// A robot's configuration. [`robot_config!`] declares one.
pub trait RobotConfig: PluginConfig + Send + 'static {
    /// Steps of an episode.
    fn horizon(&self) -> usize;

    /// How many time steps of the model one action is held.
    fn control_step(&self) -> usize;

    /// The size of the noise in the initial state.
    fn start_noise(&self) -> f64;
}

/// Declares a robot's configuration as [`shield_api::config!`] does. Among its fields are `horizon`, `start_noise` and `control_step`,
/// whose defaults and units are the robot's own.
macro_rules! robot_config {
    ($(#[$attribute:meta])* pub struct $name:ident { $($fields:tt)* }) => {
        shield_api::config! {
            $(#[$attribute])*
            pub struct $name { $($fields)* }
        }

        impl crate::task::RobotConfig for $name {
            fn horizon(&self) -> usize {
                self.horizon
            }

            fn control_step(&self) -> usize {
                self.control_step
            }

            fn start_noise(&self) -> f64 {
                self.start_noise
            }
        }
    };
}

pub(crate) use robot_config;

/// A robot's task: where it starts, what it sees, what is rewarded, what counts as reset and what cannot be undone. The
/// physics is the model's alone. A task has no state: everything follows from configuration and simulation.
pub trait Task: Send + Sized + 'static {
    /// The plugin's configuration.
    type Config: RobotConfig;

    /// Names of the starts beside the usual one.
    const STARTS: &'static [&'static str] = &[];

    /// Checks the fields that the other robots do not have.
    ///
    /// # Errors
    /// A value that cannot be.
    fn check(_config: &Self::Config) -> Result<()> {
        Ok(())
    }

    /// The model in MuJoCo's XML.
    fn model(config: &Self::Config) -> String;

    /// Alters the default pose at rest into an initial state; `start` is one of [`STARTS`](Self::STARTS) or `None`.
    fn place(start: Option<&str>, noise: &mut Noise<'_>, positions: &mut [f64], velocities: &mut [f64]);

    /// What the agents see; by default the positions, then the velocities.
    fn observe(simulation: &Simulation) -> impl Iterator<Item = f64> {
        simulation.positions().iter().chain(simulation.velocities()).copied()
    }

    /// Rewards and flags of the state that an action led to.
    fn outcome(config: &Self::Config, simulation: &Simulation) -> StepOutcome;

    /// Names and costs of the kinds of hard resets, where they differ.
    fn reset_kinds(_config: &Self::Config) -> Vec<(&'static str, f64)> {
        Vec::new()
    }

    /// Which of them a hard reset from the present state would be.
    fn reset_kind(_simulation: &Simulation) -> usize {
        0
    }

    /// Where a picture of the present state is taken from.
    fn view(simulation: &Simulation) -> View;
}

/// The environment of a task.
pub struct Robot<T: Task> {
    config: T::Config,
    simulation: Simulation,
    observation_len: usize,
    /// What every saved state begins with, so that it is not taken for a state of another model.
    save_header: [u8; 16],
}

impl<T: Task> Robot<T> {
    /// To place the robot where a test wants it.
    #[cfg(test)]
    pub fn simulation_mut(&mut self) -> &mut Simulation {
        &mut self.simulation
    }

    fn observe(&self, observation: &mut [f32]) {
        for (seen, value) in observation.iter_mut().zip(T::observe(&self.simulation)) {
            *seen = value as f32;
        }
    }

    fn start(&mut self, start: Option<&str>, seed: u64, observation: &mut [f32]) -> Result<()> {
        check_length("observation", observation, self.observation_len)?;
        let mut rng = Pcg64::seed_from_u64(seed);
        let mut noise = Noise::new(self.config.start_noise(), &mut rng);
        self.simulation.reset(|positions, velocities| T::place(start, &mut noise, positions, velocities));
        self.observe(observation);
        Ok(())
    }
}

impl<T: Task> Plugin for Robot<T> {
    type Config = T::Config;

    fn create(config: T::Config, _setup: &Setup) -> Result<Self> {
        check_start_noise(config.start_noise())?;
        T::check(&config)?;
        if config.horizon() == 0 {
            let message = "horizon is 0; an episode has at least 1 step";
            return Err(Error::invalid_config(message).in_field("horizon"));
        }
        if config.control_step() == 0 {
            let message = "control_step is 0; an action is held for at least 1 step of the model";
            return Err(Error::invalid_config(message).in_field("control_step"));
        }
        let model = T::model(&config);
        let simulation = Simulation::new(&model)?;
        let observation_len = T::observe(&simulation).count();
        Ok(Self { config, simulation, observation_len, save_header: save_header(&model) })
    }
}

impl<T: Task> Checkpoint for Robot<T> {
    fn save(&self, bytes: &mut Vec<u8>) -> Result<()> {
        bytes.extend(self.save_header);
        self.simulation.save(bytes);
        Ok(())
    }

    fn load(&mut self, bytes: &[u8]) -> Result<()> {
        let state = bytes
            .strip_prefix(&self.save_header)
            .ok_or_else(|| Error::invalid_argument("these bytes are not a state of this robot's model"))?;
        self.simulation.load(state)
    }
}

impl<T: Task> Environment for Robot<T> {
    fn spec(&self) -> EnvironmentSpec {
        EnvironmentSpec {
            spaces: Spaces {
                observation: Space::unbounded(self.observation_len),
                action: self.simulation.action_space(),
            },
            episode_length: self.config.horizon(),
            brings_reset_reward: true,
        }
    }

    fn reset(&mut self, seed: u64, observation: &mut [f32]) -> Result<()> {
        self.start(None, seed, observation)
    }

    fn step(&mut self, action: &[f32], observation: &mut [f32]) -> Result<StepOutcome> {
        check_length("observation", observation, self.observation_len)?;
        self.simulation.advance(action, self.config.control_step())?;
        self.observe(observation);
        Ok(T::outcome(&self.config, &self.simulation))
    }

    fn starts(&self) -> Vec<String> {
        T::STARTS.iter().map(ToString::to_string).collect()
    }

    fn reset_to(&mut self, start: &str, seed: u64, observation: &mut [f32]) -> Result<()> {
        if !T::STARTS.contains(&start) {
            return Err(Error::invalid_argument(format!(
                "this robot has no start named {start:?}; its starts are {:?}",
                T::STARTS
            )));
        }
        self.start(Some(start), seed, observation)
    }

    fn reset_kinds(&self) -> Vec<ResetKind> {
        let kinds = T::reset_kinds(&self.config).into_iter();
        kinds.map(|(name, cost)| ResetKind { name: name.into(), cost }).collect()
    }

    fn reset_kind(&self) -> Result<usize> {
        Ok(T::reset_kind(&self.simulation))
    }

    fn render(&mut self, frame: &mut Frame<'_>) -> Result<()> {
        let view = T::view(&self.simulation);
        self.simulation.draw(view, frame)
    }
}

fn save_header(model: &str) -> [u8; 16] {
    let mut header = *b"MJSTATE1........";
    header[8..].copy_from_slice(&fnv1a(model.as_bytes()).to_le_bytes());
    header
}

/// The 64-bit FNV-1a hash: tells two models apart, the same on every machine.
const fn fnv1a(bytes: &[u8]) -> u64 {
    let mut hash = 0xcbf2_9ce4_8422_2325;
    let mut index = 0;
    while index < bytes.len() {
        hash = (hash ^ bytes[index] as u64).wrapping_mul(0x100_0000_01b3);
        index += 1;
    }
    hash
}

/// The largest start noise, in metres and radians: far beyond every model, and far below what MuJoCo calls diverged.
const MOST_START_NOISE: f64 = 100.0;

/// Refuses a size of start noise that is negative or beyond every model.
///
/// # Errors
/// [`ErrorKind::InvalidConfig`](shield_api::ErrorKind::InvalidConfig), naming the value.
fn check_start_noise(noise: f64) -> Result<()> {
    let is_valid = (0.0..=MOST_START_NOISE).contains(&noise);
    if is_valid {
        Ok(())
    } else {
        let message = format!("start_noise is {noise}; it must be from 0 to {MOST_START_NOISE}");
        Err(Error::invalid_config(message).in_field("start_noise"))
    }
}
