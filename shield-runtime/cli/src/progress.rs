//! What a person sees while runs go on: one line per run, on the terminal only.

use std::{fmt, thread, time::Duration};

use anyhow::Result;
use indicatif::{MultiProgress, ProgressBar, ProgressState, ProgressStyle};
use shield_core::{
    events::{Counters, EpisodeEvent, EvaluationEvent},
    experience::AgentRole,
};
use shield_lab::observer::{Observer, Scene, Step};

/// Steps between two updates of the line.
const EVERY: u64 = 64;
/// How often the clock of the line goes on while a step takes long.
const TICK: Duration = Duration::from_millis(500);

/// The line of one run.
pub struct Progress {
    bar: ProgressBar,
    last_return: f64,
    has_evaluation: bool,
}

impl Progress {
    /// A line among others, for a run of `steps` of which `steps_before` were made before.
    pub fn new(display: &MultiProgress, name: String, steps: u64, steps_before: u64) -> Self {
        let style = ProgressStyle::with_template(
            "{prefix:24} {bar:16} {percent:>3}% {speed:>10} {wide_msg} {eta:>4} left",
        )
        .unwrap_or_else(|_| ProgressStyle::default_bar())
        .with_key("speed", |state: &ProgressState, out: &mut dyn fmt::Write| {
            // A line that cannot be drawn is no reason to stop a run.
            write!(out, "{:.0}/s", state.per_sec()).ok();
        });
        let bar = display.add(ProgressBar::new(steps).with_style(style).with_prefix(name));
        bar.set_position(steps_before);
        bar.reset_eta();
        if !display.is_hidden() {
            tick(&bar);
        }
        Self { bar, last_return: f64::NAN, has_evaluation: false }
    }
}

/// Draws the line anew until it is finished. `enable_steady_tick` would panic where no thread can be started; here the clock stands still.
fn tick(bar: &ProgressBar) {
    let bar = bar.downgrade();
    let draw = move || {
        while let Some(bar) = bar.upgrade().filter(|bar| !bar.is_finished()) {
            bar.tick();
            drop(bar);
            thread::sleep(TICK);
        }
    };
    thread::Builder::new().name("progress".into()).spawn(draw).ok();
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}

impl Observer for Progress {
    fn on_step(&mut self, step: &Step<'_>, _: &mut Scene<'_>) -> Result<()> {
        let counters = step.counters;
        if counters.steps.is_multiple_of(EVERY) {
            self.bar.set_position(counters.steps);
            let Counters { early_aborts, hard_resets, .. } = counters;
            self.bar.set_message(format!(
                "return {:.1} · {early_aborts} aborts · {hard_resets} hard resets",
                self.last_return
            ));
        }
        Ok(())
    }

    fn on_episode(&mut self, episode: &EpisodeEvent, _counters: &Counters) -> Result<()> {
        if episode.role == AgentRole::Forward && !self.has_evaluation {
            self.last_return = episode.forward_return;
        }
        Ok(())
    }

    fn on_evaluation(&mut self, evaluation: &EvaluationEvent, _counters: &Counters) -> Result<()> {
        self.has_evaluation = true;
        self.last_return = evaluation.figures.mean_return;
        Ok(())
    }
}
