//! What one robot's file provides, and the environment that is made of it.

use rand::SeedableRng;
use rand_pcg::Pcg64;
use shield_api::{
    Checkpoint, Environment, EnvironmentSpec, Error, Frame, Plugin, PluginConfig, ResetKind, Result, Setup,
    Space, Spaces, StepOutcome, check_length,
};

use crate::picture::View;
use crate::simulation::Simulation;

/// A robot's task: where it starts, what it sees, what is rewarded, what counts as reset and what cannot be undone. The
/// physics is the model's alone.
pub trait Task: Send + Sized + 'static {
    /// The plugin's configuration.
    type Config: PluginConfig;

    /// Names of the starts beside the usual one.
    const STARTS: &'static [&'static str] = &[];

    /// Checks the configuration.
    ///
    /// # Errors
    /// A value that cannot be.
    fn new(config: Self::Config) -> Result<Self>;

    /// The model in MuJoCo's XML.
    fn model(&self) -> String;

    /// Steps of an episode.
    fn horizon(&self) -> usize;

    /// How many time steps of the model one action is held.
    fn control_step(&self) -> usize;

    /// Alters the default pose at rest into an initial state; `start` is one of [`STARTS`](Self::STARTS) or `None`.
    fn place(&self, start: Option<&str>, rng: &mut Pcg64, positions: &mut [f64], velocities: &mut [f64]);

    /// What the agents see; by default the positions, then the velocities.
    fn observe(&self, simulation: &Simulation) -> impl Iterator<Item = f64> {
        simulation.positions().iter().chain(simulation.velocities()).copied()
    }

    /// Rewards and flags of the state that an action led to.
    fn outcome(&self, simulation: &Simulation) -> StepOutcome;

    /// Names and costs of the kinds of hard resets, where they differ.
    fn reset_kinds(&self) -> Vec<(&'static str, f64)> {
        Vec::new()
    }

    /// Which of them a hard reset from the present state would be.
    fn reset_kind(&self, _simulation: &Simulation) -> usize {
        0
    }

    /// Where a picture of the present state is taken from.
    fn view(&self, simulation: &Simulation) -> View;
}

/// The environment of a task.
pub struct Robot<T> {
    task: T,
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
        for (seen, value) in observation.iter_mut().zip(self.task.observe(&self.simulation)) {
            *seen = value as f32;
        }
    }

    fn start(&mut self, start: Option<&str>, seed: u64, observation: &mut [f32]) -> Result<()> {
        check_length("observation", observation, self.observation_len)?;
        let mut rng = Pcg64::seed_from_u64(seed);
        let task = &self.task;
        self.simulation.reset(|positions, velocities| task.place(start, &mut rng, positions, velocities));
        self.observe(observation);
        Ok(())
    }
}

impl<T: Task> Plugin for Robot<T> {
    type Config = T::Config;

    fn create(config: T::Config, _setup: &Setup) -> Result<Self> {
        let task = T::new(config)?;
        if task.horizon() == 0 {
            let message = "horizon is 0; an episode has at least 1 step";
            return Err(Error::invalid_config(message).in_field("horizon"));
        }
        if task.control_step() == 0 {
            let message = "control_step is 0; an action is held for at least 1 step of the model";
            return Err(Error::invalid_config(message).in_field("control_step"));
        }
        let model = task.model();
        let simulation = Simulation::new(&model)?;
        let observation_len = task.observe(&simulation).count();
        Ok(Self { task, simulation, observation_len, save_header: save_header(&model) })
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
            episode_length: self.task.horizon(),
            brings_reset_reward: true,
        }
    }

    fn reset(&mut self, seed: u64, observation: &mut [f32]) -> Result<()> {
        self.start(None, seed, observation)
    }

    fn step(&mut self, action: &[f32], observation: &mut [f32]) -> Result<StepOutcome> {
        check_length("observation", observation, self.observation_len)?;
        self.simulation.advance(action, self.task.control_step())?;
        self.observe(observation);
        Ok(self.task.outcome(&self.simulation))
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
        let kinds = self.task.reset_kinds().into_iter();
        kinds.map(|(name, cost)| ResetKind { name: name.into(), cost }).collect()
    }

    fn reset_kind(&self) -> Result<usize> {
        Ok(self.task.reset_kind(&self.simulation))
    }

    fn render(&mut self, frame: &mut Frame<'_>) -> Result<()> {
        let view = self.task.view(&self.simulation);
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
pub fn check_start_noise(noise: f64) -> Result<()> {
    let is_valid = (0.0..=MOST_START_NOISE).contains(&noise);
    if is_valid {
        Ok(())
    } else {
        let message = format!("start_noise is {noise}; it must be from 0 to {MOST_START_NOISE}");
        Err(Error::invalid_config(message).in_field("start_noise"))
    }
}
