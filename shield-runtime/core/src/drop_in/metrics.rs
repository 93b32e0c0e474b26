//! What the learner reports, and what each episode comes to.

use shield_api::{Phase, Result};

use super::DropIn;
use crate::events::Counters;

/// Receives what each episode of a drop-in comes to.
pub trait EpisodeLog: Send {
    /// The named figures of an episode that is over after `step` environment steps.
    ///
    /// # Errors
    /// They cannot be kept.
    fn write(&mut self, step: u64, figures: &[(&str, f64)]) -> Result<()>;
}

impl DropIn {
    /// Tells `log` from now on what each episode comes to.
    pub fn log_episodes(&mut self, log: Box<dyn EpisodeLog>) {
        self.metrics.log = Some(log);
    }
}

/// One metric of the learner: its sum and count in the present episode, and its mean in the last one that had any.
#[derive(Debug)]
struct Metric {
    name: String,
    sum: f64,
    count: u64,
    last: f64,
}

impl Metric {
    fn mean(&self) -> f64 {
        if self.count > 0 { self.sum / self.count as f64 } else { self.last }
    }
}

/// The metrics since the last episode, and where they go.
#[derive(Default)]
pub(super) struct EpisodeMetrics {
    metrics: Vec<Metric>,
    reset_return: f64,
    log: Option<Box<dyn EpisodeLog>>,
}

impl EpisodeMetrics {
    /// Takes note of a figure that was reported.
    pub fn note(&mut self, name: &str, mean: f64) {
        let known = self.metrics.iter().position(|metric| metric.name == name);
        let index = known.unwrap_or_else(|| {
            self.metrics.push(Metric { name: name.to_owned(), sum: 0.0, count: 0, last: f64::NAN });
            self.metrics.len() - 1
        });
        let metric = &mut self.metrics[index];
        (metric.sum, metric.count) = (metric.sum + mean, metric.count + 1);
    }

    pub fn step(&mut self, in_charge: Phase, reset_reward: f32) {
        if in_charge == Phase::Reset {
            self.reset_return += f64::from(reset_reward);
        }
    }

    /// Writes what the episode came to. `has_reset`: it was a reset episode, and succeeded or not.
    pub fn episode_is_over(&mut self, counters: &Counters, has_reset: Option<bool>) -> Result<()> {
        let reset_return = std::mem::take(&mut self.reset_return);
        if let Some(log) = &mut self.log {
            let mut scalars = vec![
                ("counts/early_aborts", counters.early_aborts as f64),
                ("counts/hard_resets", counters.hard_resets as f64),
                ("counts/forward_steps", counters.forward_steps as f64),
            ];
            if let Some(has_reset) = has_reset {
                scalars.push(("reset/return", reset_return));
                scalars.push(("reset/success", f64::from(u8::from(has_reset))));
            }
            let seen = self.metrics.iter().filter(|metric| metric.count > 0);
            scalars.extend(seen.map(|metric| (metric.name.as_str(), metric.mean())));
            log.write(counters.steps, &scalars)?;
        }
        for metric in &mut self.metrics {
            metric.last = metric.mean();
            (metric.sum, metric.count) = (0.0, 0);
        }
        Ok(())
    }

    pub fn each(&self, take: &mut impl FnMut(&str, f64)) {
        self.metrics.iter().for_each(|metric| take(&metric.name, metric.mean()));
    }
}
