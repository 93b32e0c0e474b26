#![doc = include_str!("../README.md")]
#![deny(unsafe_code)]

mod network;
#[cfg(test)]
mod tests;

use network::Network;
use serde::Deserialize;
use shield_api::{Checkpoint, Error, Plugin, Policy, Result, Setup, Space, Spaces, check_finite};

shield_api::config! {
    /// Which network, and what its numbers mean.
    pub struct OnnxConfig {
        /// The file. A relative path counts from the working directory.
        path: String = String::new() => "\"\"",
        /// What the network's output is: Actions, in the units of the action space, or Normalised, from -1 to 1 in each dimension.
        output: Output = Output::Actions => "Actions",
    }
}

/// What the output of a network for continuous actions is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
pub enum Output {
    /// Actions in the units of the space; beyond a bound they are moved onto it, as Stable-Baselines3 does.
    Actions,
    /// Actions from -1 to 1, as of a tanh, stretched to the bounds.
    Normalised,
}

/// A finished policy.
struct Onnx {
    network: Network,
    spaces: Spaces,
    output: Output,
}

impl Checkpoint for Onnx {
    fn save(&self, _bytes: &mut Vec<u8>) -> Result<()> {
        Ok(())
    }

    fn load(&mut self, bytes: &[u8]) -> Result<()> {
        if bytes.is_empty() { Ok(()) } else { Err(Error::invalid_argument("a finished policy has no state")) }
    }
}

impl Plugin for Onnx {
    type Config = OnnxConfig;

    fn create(config: OnnxConfig, setup: &Setup) -> Result<Self> {
        let spaces = setup.spaces()?.clone();
        let network = Network::read(&config.path, spaces.observation_len())?;
        check_output(&config, &network, &spaces.action)?;
        Ok(Self { network, spaces, output: config.output })
    }
}

fn check_output(config: &OnnxConfig, network: &Network, action: &Space) -> Result<()> {
    let (shape, length) = (network.output_shape(), network.output_len());
    let expected = match action {
        Space::Box { low, .. } if length == low.len() => return Ok(()),
        Space::Box { low, .. } => format!("the environment's action has {}", low.len()),
        Space::Discrete { n } if length == *n || length == 1 => {
            if config.output == Output::Normalised {
                let message = "`output: Normalised` means nothing for discrete actions; leave it out";
                return Err(Error::invalid_config(message).in_field("output"));
            }
            return Ok(());
        }
        Space::Discrete { n } => {
            format!("the environment has {n} actions: one value for each, or the index alone")
        }
    };
    let message = format!(
        "`path`: {}: its first output has the shape {shape:?}, {length} values; {expected}",
        config.path
    );
    Err(Error::invalid_config(message).in_field("path"))
}

impl Policy for Onnx {
    fn act(&mut self, observation: &[f32], action: &mut [f32]) -> Result<()> {
        check_finite("observation", observation, self.spaces.observation_len())?;
        shield_api::check_length("action", action, self.spaces.action_len())?;
        let (space, output) = (&self.spaces.action, self.output);
        self.network.run(observation, |values| {
            check_finite("the network's output", values, values.len())?;
            match space {
                Space::Box { low, high } => scale(values, output, low, high, action),
                Space::Discrete { .. } => action[0] = index(values),
            }
            space.clamp(action);
            Ok(())
        })?
    }
}

fn scale(values: &[f32], output: Output, low: &[f32], high: &[f32], action: &mut [f32]) {
    for (index, (value, action)) in values.iter().zip(action).enumerate() {
        *action = match output {
            Output::Actions => *value,
            Output::Normalised => low[index] + 0.5 * (value + 1.0) * (high[index] - low[index]),
        };
    }
}

/// The index itself, or that of the largest value, the first of equals.
fn index(values: &[f32]) -> f32 {
    if let [index] = values {
        return *index;
    }
    let best = (0..values.len()).reduce(|best, next| if values[next] > values[best] { next } else { best });
    best.unwrap_or_default() as f32
}

shield_api::export_plugin! {
    policy "onnx" => Onnx { description: "A finished policy in ONNX", deterministic: true }
}
