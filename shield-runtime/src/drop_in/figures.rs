//! What the learner reports, and the event file for TensorBoard.

use std::path::Path;

use shield_api::{Error, Phase, Result};

use crate::{plugin, record::Counters, run::events::EventFile};

/// One figure of the learner: its sum and count in the present episode, and its mean in the last one that had any.
#[derive(Debug)]
struct Figure {
    name: String,
    sum: f64,
    count: u64,
    last: f64,
}

impl Figure {
    fn mean(&self) -> f64 {
        if self.count > 0 { self.sum / self.count as f64 } else { self.last }
    }
}

/// The figures since the last episode, and where they go.
#[derive(Default)]
pub(super) struct Figures {
    figures: Vec<Figure>,
    reset_return: f64,
    events: Option<EventFile>,
}

impl Figures {
    /// Writes an event file into the folder `tensorboard` in `folder` from now on.
    pub fn log_to(&mut self, folder: &Path) -> Result<()> {
        self.events = Some(EventFile::create(folder).map_err(failed)?);
        Ok(())
    }

    /// Takes what plugins have reported on this thread.
    pub fn take(&mut self) {
        plugin::drain_metrics(&mut |name, mean| {
            let known = self.figures.iter().position(|figure| figure.name == name);
            let index = known.unwrap_or_else(|| {
                self.figures.push(Figure { name: name.to_owned(), sum: 0.0, count: 0, last: f64::NAN });
                self.figures.len() - 1
            });
            let figure = &mut self.figures[index];
            (figure.sum, figure.count) = (figure.sum + mean, figure.count + 1);
        });
    }

    pub fn step(&mut self, in_charge: Phase, reset_reward: f32) {
        if in_charge == Phase::Reset {
            self.reset_return += f64::from(reset_reward);
        }
    }

    /// Writes what the episode came to. `has_reset`: it was a reset episode, and succeeded or not.
    pub fn episode_is_over(&mut self, counters: &Counters, has_reset: Option<bool>) -> Result<()> {
        let reset_return = std::mem::take(&mut self.reset_return);
        if let Some(events) = &mut self.events {
            let mut scalars = vec![
                ("counts/early_aborts", counters.early_aborts as f64),
                ("counts/hard_resets", counters.hard_resets as f64),
                ("counts/forward_steps", counters.forward_steps as f64),
            ];
            if let Some(has_reset) = has_reset {
                scalars.push(("reset/return", reset_return));
                scalars.push(("reset/success", f64::from(u8::from(has_reset))));
            }
            let seen = self.figures.iter().filter(|figure| figure.count > 0);
            scalars.extend(seen.map(|figure| (figure.name.as_str(), figure.mean())));
            events.scalars(counters.steps, &scalars).and_then(|()| events.flush()).map_err(failed)?;
        }
        for figure in &mut self.figures {
            figure.last = figure.mean();
            (figure.sum, figure.count) = (0.0, 0);
        }
        Ok(())
    }

    pub fn each(&self, take: &mut impl FnMut(&str, f64)) {
        self.figures.iter().for_each(|figure| take(&figure.name, figure.mean()));
    }
}

fn failed(error: anyhow::Error) -> Error {
    Error::failed(format!("{error:#}"))
}
