#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod checkpoint;
mod config;
mod learner;
#[cfg(test)]
mod tests;

use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use shield_api::{Error, Host, Plugin, Result, Setup, Space};

pub use config::TabularQConfig;

/// Q-learning (Watkins 1989) with an ensemble of tables that begin differently.
#[derive(Debug)]
pub struct TabularQ {
    config: TabularQConfig,
    host: Host,
    states: usize,
    actions: usize,
    /// Q of member i: `tables[i · states · actions + s · actions + a]`.
    tables: Vec<f32>,
    /// Exploring actions so far.
    explored: u64,
    rng: Pcg64,
    /// The transitions of a batch as indices, kept between calls.
    transitions: Vec<Transition>,
}

/// One row of a batch. States are counted by the offset of their first action's value.
#[derive(Debug, Clone, Copy)]
struct Transition {
    state: usize,
    action: usize,
    next_state: usize,
}

impl Plugin for TabularQ {
    type Config = TabularQConfig;

    fn create(config: TabularQConfig, setup: &Setup) -> Result<Self> {
        config.validate()?;
        let spaces = setup.spaces()?;
        let (states, actions) =
            (alternatives("observation", &spaces.observation)?, alternatives("action", &spaces.action)?);
        let mut rng = Pcg64::seed_from_u64(setup.seed);
        let (low, high) = (config.initial_low, config.initial_high);
        let tables = (0..config.members * states * actions).map(|_| rng.random_range(low..=high)).collect();
        Ok(Self {
            config,
            host: setup.host,
            states,
            actions,
            tables,
            explored: 0,
            rng,
            transitions: Vec::new(),
        })
    }
}

fn alternatives(what: &str, space: &Space) -> Result<usize> {
    match space {
        Space::Discrete { n } => Ok(*n),
        Space::Box { .. } => Err(Error::invalid_argument(format!(
            "tabular-q needs a discrete {what} space, not a box; for boxes there is ddpg"
        ))),
    }
}

shield_api::export_plugin! {
    learner "tabular-q" => TabularQ { description: "Tabular Q-learning with an ensemble of tables", deterministic: true }
}
