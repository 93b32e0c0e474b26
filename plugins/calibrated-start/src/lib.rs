//! A reset task for any environment, without settings: it learns from starts and experience how near to a start is near enough.
#![forbid(unsafe_code)]

mod calibration;
mod memory;
mod state;

use shield_api::{Error, Host, Plugin, ResetSignal, ResetTask, Result, Setup, check_finite};

use crate::{
    calibration::{Aims, Calibration},
    memory::Memory,
};

shield_api::config! {
    /// Settings of the task.
    pub struct Config {
        /// The share of fresh starts that must count as reset.
        coverage: f32 = 0.95,
        /// How many observed starts are kept; later ones change nothing.
        starts: u32 = 100,
        /// From how many steps the spread of each dimension is taken; later ones change nothing.
        experience: u64 = 2_000,
        /// The radius that is granted where starts need less, in units of the spread; not if more than 1 − coverage of the experience lies within.
        least_radius: f32 = 0.35,
    }
}

/// The most starts that may be kept: each costs a distance in every step.
const MOST_STARTS: u32 = 256;

/// The task, what it has seen, and what it has concluded from that.
#[derive(Debug)]
pub struct CalibratedStart {
    memory: Memory,
    calibration: Calibration,
    /// Something was seen since the last calibration that must change it.
    is_due: bool,
    aims: Aims,
    observation_len: usize,
    action_len: usize,
    host: Host,
}

impl Plugin for CalibratedStart {
    type Config = Config;

    fn create(config: Config, setup: &Setup) -> Result<Self> {
        let spaces = setup.spaces()?;
        check(&config)?;
        let dimensions = spaces.observation_len();
        Ok(Self {
            memory: Memory::new(dimensions, config.starts as usize, config.experience),
            calibration: Calibration::new(dimensions),
            is_due: false,
            aims: Aims { coverage: config.coverage.into(), least_radius: config.least_radius.into() },
            observation_len: dimensions,
            action_len: spaces.action_len(),
            host: setup.host,
        })
    }
}

fn check(config: &Config) -> Result<()> {
    let refuse = |field: &str, message: String| Err(Error::invalid_config(message).in_field(field));
    let is_share = config.coverage > 0.0 && config.coverage < 1.0;
    if !is_share {
        let message = format!("coverage is {}, but must lie between 0 and 1", config.coverage);
        return refuse("coverage", message);
    }
    if config.starts == 0 || config.starts > MOST_STARTS {
        let message = format!("starts is {}, but must lie between 1 and {MOST_STARTS}", config.starts);
        return refuse("starts", message);
    }
    if config.experience == 0 {
        return refuse("experience", "experience is 0, but without any step nothing has a spread".into());
    }
    let is_radius = config.least_radius.is_finite() && config.least_radius >= 0.0;
    if !is_radius {
        let message = format!("least_radius is {}, but must be finite and not negative", config.least_radius);
        return refuse("least_radius", message);
    }
    Ok(())
}

impl CalibratedStart {
    fn calibrate(&mut self) {
        self.calibration.renew(self.memory.starts(), self.memory.samples(), self.aims);
        self.is_due = false;
        self.memory.forget_samples_if_complete();
    }

    fn report(&self) {
        self.host.metric("radius", self.calibration.radius);
        self.host.metric("dimensions", self.calibration.dimensions() as f64);
        if let Some(share) = self.calibration.starts_inside {
            self.host.metric("starts_inside", share);
        }
        if let Some(share) = self.calibration.experience_inside {
            self.host.metric("experience_inside", share);
        }
    }
}

impl ResetTask for CalibratedStart {
    fn evaluate(
        &mut self,
        observation: &[f32],
        action: &[f32],
        next_observation: &[f32],
    ) -> Result<ResetSignal> {
        check_finite("observation", observation, self.observation_len)?;
        check_finite("action", action, self.action_len)?;
        check_finite("next_observation", next_observation, self.observation_len)?;
        if self.memory.starts().is_empty() {
            let message =
                "no start was observed yet, so nothing can be near one; let a hard reset come first";
            return Err(Error::failed(message));
        }
        self.is_due |= self.memory.experience(next_observation);
        if self.is_due {
            self.calibrate();
        }
        self.report();
        Ok(self.calibration.judge(self.memory.starts(), next_observation))
    }

    fn observe_start(&mut self, observation: &[f32]) -> Result<()> {
        check_finite("observation", observation, self.observation_len)?;
        // Judged before it is learned from: whether a fresh start counts as reset.
        if self.calibration.starts_inside.is_some() {
            let is_inside = self.calibration.judge(self.memory.starts(), observation).in_reset_set;
            self.host.metric("start_inside", f64::from(u8::from(is_inside)));
        }
        self.is_due |= self.memory.start(observation);
        Ok(())
    }
}

shield_api::export_plugin! {
    reset_task "calibrated-start" => CalibratedStart {
        description: "Reset is an observation where starts are, to a scale learned from experience", deterministic: true
    }
}

#[cfg(test)]
mod tests;
