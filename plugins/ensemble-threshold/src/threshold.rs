//! Q_min, which may change with the steps of a run.

use std::f64::consts::PI;

use rule_kit::require_finite;
use serde::Deserialize;
use shield_api::{Error, Result};

use crate::Config;

/// How Q_min goes from `q_min` to `final_q_min`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
pub enum Schedule {
    /// It stays at `q_min`.
    Constant,
    /// In equal steps.
    Linear,
    /// Along half a cosine: slowly at both ends.
    Cosine,
}

/// Q_min at each step.
#[derive(Debug, Clone)]
pub struct Threshold {
    first: f64,
    last: f64,
    schedule: Schedule,
    steps: u64,
    is_relative: bool,
}

impl Threshold {
    /// Refuses what is not finite, and fields that would have no effect.
    pub fn new(config: &Config) -> Result<Self> {
        let Config { q_min, final_q_min, schedule, schedule_steps, relative, .. } = *config;
        for (name, value) in [("q_min", Some(q_min)), ("final_q_min", final_q_min)] {
            if let Some(value) = value {
                require_finite(name, value)?;
            }
        }
        let last = match (schedule, final_q_min, schedule_steps) {
            (Schedule::Constant, None, 0) => q_min,
            (Schedule::Constant, ..) => {
                let message = "final_q_min and schedule_steps have no effect with `schedule: Constant`; use Linear or Cosine";
                let field = if final_q_min.is_some() { "final_q_min" } else { "schedule_steps" };
                return Err(Error::invalid_config(message).in_field(field));
            }
            (_, Some(last), 1..) => last,
            _ => {
                let message = "a schedule needs final_q_min and schedule_steps of 1 or more";
                return Err(Error::invalid_config(message).in_field("schedule"));
            }
        };
        let (first, last) = (f64::from(q_min), f64::from(last));
        Ok(Self { first, last, schedule, steps: schedule_steps, is_relative: relative })
    }

    /// Q_min at `step`; infinite, so that everything is rejected, where it is relative to values without bound (γ = 1).
    pub fn at(&self, step: u64, discount: f32) -> f32 {
        let passed = (step as f64 / self.steps.max(1) as f64).min(1.0);
        let share = match self.schedule {
            Schedule::Constant => 0.0,
            Schedule::Linear => passed,
            Schedule::Cosine => (1.0 - (PI * passed).cos()) / 2.0,
        };
        let q_min = self.first + (self.last - self.first) * share;
        if !self.is_relative {
            return q_min as f32;
        }
        let is_unbounded = discount >= 1.0;
        if is_unbounded { f32::INFINITY } else { (q_min / (1.0 - f64::from(discount))) as f32 }
    }
}
