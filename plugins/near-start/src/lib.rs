//! A reset task for any environment: an observation near those of the starts counts as reset.
#![forbid(unsafe_code)]

mod state;

use shield_api::{
    Checkpoint, Error, Host, Plugin, ResetSignal, ResetTask, Result, Setup, check_finite, check_length,
};

use crate::state::Starts;

shield_api::config! {
    /// Settings of the task.
    pub struct Config {
        /// The observation that counts as the start. None: the mean of the first observed starts.
        target: Option<Vec<f32>> = None,
        /// How many observed starts make the mean; later ones no longer move it. Not used with a target.
        average_over: u32 = 100,
        /// How much each dimension of the observation counts; 0 leaves it out. None: all the same.
        weights: Option<Vec<f32>> = None,
        /// The largest distance that counts as reset, in the observation's units (root of the weighted mean square).
        radius: f32 = 0.1,
        /// How far beyond the radius the reward has fallen from 1 to 0.05, in the same units.
        margin: f32 = 1.0,
    }
}

/// The task, and what it has seen of the starts.
#[derive(Debug)]
pub struct NearStart {
    starts: Starts,
    has_target: bool,
    average_over: u32,
    /// One per dimension, with the sum 1.
    weights: Vec<f64>,
    radius: f64,
    /// artanh(√0.95) / margin.
    steepness: f64,
    action_len: usize,
    host: Host,
}

impl Plugin for NearStart {
    type Config = Config;

    fn create(config: Config, setup: &Setup) -> Result<Self> {
        let spaces = setup.spaces()?;
        let dimensions = spaces.observation_len();
        let is_margin = config.margin.is_finite() && config.margin > 0.0;
        let is_radius = config.radius.is_finite() && config.radius >= 0.0;
        if !is_margin {
            let message = format!("margin is {}, but must be finite and above 0", config.margin);
            return Err(Error::invalid_config(message).in_field("margin"));
        }
        if !is_radius {
            let message = format!("radius is {}, but must be finite and not negative", config.radius);
            return Err(Error::invalid_config(message).in_field("radius"));
        }
        if config.average_over == 0 {
            let message = "average_over is 0, but at least one start makes a mean";
            return Err(Error::invalid_config(message).in_field("average_over"));
        }
        let mut starts = Starts::new(dimensions);
        if let Some(target) = &config.target {
            check_finite("target", target, dimensions)
                .map_err(|error| Error::invalid_config(error.message()).in_field("target"))?;
            starts.observe(target);
        }
        Ok(Self {
            starts,
            has_target: config.target.is_some(),
            average_over: config.average_over,
            weights: normalised(config.weights, dimensions)?,
            radius: config.radius.into(),
            steepness: 0.95f64.sqrt().atanh() / f64::from(config.margin),
            action_len: spaces.action_len(),
            host: setup.host,
        })
    }
}

fn normalised(weights: Option<Vec<f32>>, dimensions: usize) -> Result<Vec<f64>> {
    let weights = weights.unwrap_or_else(|| vec![1.0; dimensions]);
    check_finite("weights", &weights, dimensions)
        .map_err(|error| Error::invalid_config(error.message()).in_field("weights"))?;
    if let Some(negative) = weights.iter().position(|weight| *weight < 0.0) {
        let message = format!("weights[{negative}] is {}, but must not be negative", weights[negative]);
        return Err(Error::invalid_config(message).in_field(format!("weights[{negative}]")));
    }
    let sum: f64 = weights.iter().copied().map(f64::from).sum();
    if sum == 0.0 {
        let message = "weights are all 0, so that no dimension counts";
        return Err(Error::invalid_config(message).in_field("weights"));
    }
    Ok(weights.into_iter().map(|weight| f64::from(weight) / sum).collect())
}

impl NearStart {
    /// √(Σ wᵢ (xᵢ − sᵢ)²), where the weights add up to 1: independent of how many dimensions there are.
    fn distance(&self, start: &[f64], observation: &[f32]) -> f64 {
        let squares = self.weights.iter().zip(start).zip(observation).map(|((weight, start), value)| {
            let difference = f64::from(*value) - start;
            weight * difference * difference
        });
        squares.sum::<f64>().sqrt()
    }
}

impl ResetTask for NearStart {
    fn evaluate(
        &mut self,
        observation: &[f32],
        action: &[f32],
        next_observation: &[f32],
    ) -> Result<ResetSignal> {
        check_length("observation", observation, self.weights.len())?;
        check_length("action", action, self.action_len)?;
        check_finite("next_observation", next_observation, self.weights.len())?;
        let start = self.starts.mean().ok_or_else(|| {
            Error::failed(
                "no start was observed yet, so nothing can be near it; let a hard reset come first, or set `target`",
            )
        })?;
        let distance = self.distance(start, next_observation);
        // 1 inside the radius, else 1 − tanh²(w·d): dm_control's tolerance, as the robots' reset rewards have it.
        let beyond = (distance - self.radius).max(0.0);
        let reward = 1.0 - (self.steepness * beyond).tanh().powi(2);
        Ok(ResetSignal { reward: reward as f32, in_reset_set: distance <= self.radius })
    }

    fn observe_start(&mut self, observation: &[f32]) -> Result<()> {
        check_finite("observation", observation, self.weights.len())?;
        // Before this start moves the mean: whether a fresh start counts as reset.
        if let Some(start) = self.starts.mean() {
            let is_inside = self.distance(start, observation) <= self.radius;
            self.host.metric("start_inside", f64::from(u8::from(is_inside)));
        }
        if !self.has_target && self.starts.count() < u64::from(self.average_over) {
            self.starts.observe(observation);
        }
        Ok(())
    }
}

impl Checkpoint for NearStart {
    fn save(&self, bytes: &mut Vec<u8>) -> Result<()> {
        self.starts.write(bytes);
        Ok(())
    }

    fn load(&mut self, bytes: &[u8]) -> Result<()> {
        self.starts = Starts::read(bytes, self.weights.len())?;
        Ok(())
    }
}

shield_api::export_plugin! {
    reset_task "near-start" => NearStart {
        description: "Reset is an observation near those of the starts", deterministic: true
    }
}

#[cfg(test)]
mod tests;
