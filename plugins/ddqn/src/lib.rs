#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod checkpoint;
mod config;
mod learner;
#[cfg(test)]
mod tests;

use actor_critic::{Adam, Architecture, CriticStep, Ensemble, Normaliser, Schedule};
use learner_kit::plugin_error;
use rand::SeedableRng;
use rand_pcg::Pcg64;
use shield_api::{Error, Host, Plugin, Result, Setup, Space};

pub use config::DdqnConfig;

/// Double DQN with an ensemble of Q-networks, each with its own target network.
#[derive(Debug)]
pub struct Ddqn {
    config: DdqnConfig,
    host: Host,
    /// Q₁ … Qₙ with one output per action.
    networks: Ensemble<f32>,
    optimiser: Adam,
    actions: Space,
    normaliser: Option<Normaliser>,
    epsilon: Schedule,
    /// Exploring actions so far.
    explored: u64,
    rng: Pcg64,
    buffers: Buffers,
    steps: Vec<MemberStep>,
    /// Qᵢ(s, ·) of one observation, member by member.
    answers: Vec<Vec<f32>>,
}

/// Memory that is kept between calls, so that none is allocated after the first.
#[derive(Debug, Default)]
struct Buffers {
    observations: Vec<f32>,
    next_observations: Vec<f32>,
    /// The executed actions' indices.
    chosen: Vec<usize>,
    /// One observation, for everything that is not an update.
    observation: Vec<f32>,
    /// Σ Qᵢ(s, ·).
    sums: Vec<f32>,
}

/// What one network needs and returns in an update.
#[derive(Debug, Clone, Default)]
struct MemberStep {
    critic: CriticStep,
    /// argmax Q(s', ·).
    next_actions: Vec<usize>,
    /// Q(s, a).
    values: Vec<f32>,
    /// ∂L/∂Q(s, a).
    gradients: Vec<f32>,
}

impl Plugin for Ddqn {
    type Config = DdqnConfig;

    fn create(config: DdqnConfig, setup: &Setup) -> Result<Self> {
        config.validate().map_err(plugin_error)?;
        let spaces = setup.spaces()?;
        let Space::Discrete { n } = spaces.action else {
            return Err(Error::invalid_argument(
                "DDQN needs discrete actions; for a box there are ddpg and td3",
            ));
        };
        let observation_len = spaces.observation_len();
        let mut rng = Pcg64::seed_from_u64(setup.seed);
        let mut networks = Architecture::action_values(observation_len, n, &config.hidden, config.activation)
            .and_then(|network| {
                Ensemble::new(network, config.initialisation, config.members, setup.threads, &mut rng)
            })
            .map_err(plugin_error)?;
        if let Some(value) = config.initial_value {
            networks.raise_outputs(value);
        }
        Ok(Self {
            host: setup.host,
            networks,
            optimiser: Adam::new(config.rate),
            actions: spaces.action.clone(),
            normaliser: config.normalise_observations.then(|| Normaliser::new(observation_len)),
            epsilon: Schedule {
                start: config.epsilon,
                end: config.final_epsilon,
                steps: config.epsilon_steps,
            },
            explored: 0,
            rng,
            buffers: Buffers { sums: vec![0.0; n], ..Buffers::default() },
            steps: vec![MemberStep::default(); config.members],
            answers: vec![vec![0.0; n]; config.members],
            config,
        })
    }
}

shield_api::export_plugin! {
    learner "ddqn" => Ddqn { description: "Double DQN (van Hasselt et al. 2016) with an ensemble of Q-networks", deterministic: true }
}
