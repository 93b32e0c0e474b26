#![doc = include_str!("../README.md")]
#![forbid(unsafe_code)]

mod checkpoint;
mod config;
mod critic;
#[cfg(test)]
#[path = "../../../tests/critics/support.rs"]
mod support;
#[cfg(test)]
mod tests;

use learner_kit::plugin_error;
use shield_api::{Error, Host, Plugin, Result, Setup, Space};

pub use config::TabularSuccessConfig;

/// An ensemble of tables of P(s, a) that differ in what their bootstrap masks let them learn.
#[derive(Debug)]
pub struct SuccessTables {
    config: TabularSuccessConfig,
    host: Host,
    /// The space of actions.
    space: Space,
    states: usize,
    actions: usize,
    /// P of member i: `tables[i · states · actions + s · actions + a]`.
    tables: Vec<f32>,
    /// How often each of them was learned, a mask of 0.5 counting half; laid out alike.
    visits: Vec<f32>,
    /// The transitions of a batch, kept between calls.
    transitions: Vec<Transition>,
}

/// One row of a batch as places in a table.
#[derive(Debug, Clone, Copy)]
struct Transition {
    cell: usize,
    next_cell: usize,
}

impl Plugin for SuccessTables {
    type Config = TabularSuccessConfig;

    fn create(config: TabularSuccessConfig, setup: &Setup) -> Result<Self> {
        config.validate().map_err(plugin_error)?;
        let spaces = setup.spaces()?;
        let (states, actions) =
            (alternatives("observation", &spaces.observation)?, alternatives("action", &spaces.action)?);
        let length = config.members * states * actions;
        Ok(Self {
            host: setup.host,
            space: spaces.action.clone(),
            states,
            actions,
            tables: vec![config.initial_probability; length],
            visits: vec![0.0; length],
            transitions: Vec::new(),
            config,
        })
    }
}

fn alternatives(what: &str, space: &Space) -> Result<usize> {
    match space {
        Space::Discrete { n } => Ok(*n),
        Space::Box { .. } => Err(Error::invalid_argument(format!(
            "tabular-success needs a discrete {what} space, not a box; for boxes there is success-critic"
        ))),
    }
}

shield_api::export_plugin! {
    success_critic "tabular-success" => SuccessTables { description: "An ensemble of tables that learns the undo probability from outcomes", deterministic: true }
}
