//! Films what a loop executes: an observer that draws the environment and asks the reset agent for values, and changes nothing.

mod overlay;

use anyhow::{Context, Result};
use embedded_graphics::pixelcolor::RgbColor;
use shield_api::{Frame, Space, Spaces};

use crate::report::Picture;
use overlay::{Caption, Mark, ValueBar};
use shield_core::{
    events::{Counters, EpisodeEvent, Intervention},
    experience::AgentRole,
};
use shield_lab::observer::{Observer, Scene, Step};

/// Red, green and blue of every colour of the overlay, for a palette that must know them before they appear.
pub fn overlay_colours() -> impl Iterator<Item = [u8; 3]> {
    overlay::COLOURS.into_iter().map(|colour| [colour.r(), colour.g(), colour.b()])
}

/// What is filmed, and how.
pub struct FilmSettings {
    /// Width and height of the environment's picture; the environment's own choice if `None`.
    pub size: Option<[usize; 2]>,
    /// Steps before the film begins.
    pub from: u64,
    /// Every n-th step is a picture.
    pub every: u64,
    /// The threshold beside which the reset value is shown, where there is one.
    pub q_min: Option<f32>,
    /// The largest reset value that can be: the end of its bar.
    pub largest_value: f32,
}

/// Pictures that an abort, which is no step, stays in view.
const ABORT_PICTURES: u32 = 4;
/// Pictures that a hard reset's mark stays in view.
const HARD_RESET_PICTURES: u32 = 6;

/// Takes a picture of each step, with its phase, the reset value of what was executed, and marks of aborts and hard resets.
pub struct Filmer<'a> {
    spaces: Spaces,
    settings: FilmSettings,
    /// Takes each picture.
    sink: &'a mut dyn FnMut(&Picture) -> Result<()>,
    counters: Counters,
    /// Pictures for which a hard reset is still marked.
    hard_reset_left: u32,
    is_projected: bool,
    /// How often an action was aborted at each observation of a discrete space; else empty.
    aborts: Vec<u32>,
    values: Vec<f32>,
}

impl<'a> Filmer<'a> {
    /// A camera for environments with these spaces, beside a reset agent of so many members; 0 where there is none.
    pub fn new(
        spaces: Spaces,
        members: usize,
        settings: FilmSettings,
        sink: &'a mut dyn FnMut(&Picture) -> Result<()>,
    ) -> Self {
        let cells = match spaces.observation {
            Space::Discrete { n } => n,
            Space::Box { .. } => 0,
        };
        Self {
            spaces,
            settings,
            sink,
            counters: Counters::default(),
            hard_reset_left: 0,
            is_projected: false,
            aborts: vec![0; cells],
            values: vec![0.0; members],
        }
    }

    /// Films a step that no loop made, from `observation` by `action`: `phase` says who acted.
    ///
    /// # Errors
    /// The environment cannot be drawn, or the picture cannot be written.
    pub fn shoot(
        &mut self,
        phase: &'static str,
        step: u64,
        (observation, action): (&[f32], &[f32]),
        scene: &mut Scene<'_>,
    ) -> Result<()> {
        let value = self.value(scene, observation, action);
        self.picture(scene, &Caption { phase, step, ..Caption::of(&self.counters) }, value, None, 1)
    }

    /// Least, mean and largest value of an action over the reset agent's ensemble. A picture without is better than none.
    fn value(&mut self, scene: &mut Scene<'_>, observation: &[f32], action: &[f32]) -> Option<ValueBar> {
        let reset = scene.reset.as_mut()?;
        reset.q_values(observation, action, &mut self.values).ok()?;
        let range = self.values.iter().fold([f32::INFINITY, f32::NEG_INFINITY], |range, value| {
            [range[0].min(*value), range[1].max(*value)]
        });
        let mean = self.values.iter().sum::<f32>() / self.values.len() as f32;
        let FilmSettings { q_min, largest_value, .. } = self.settings;
        Some(ValueBar { range, mean, q_min, largest: largest_value })
    }

    /// For each observation of a discrete space the value of its best action, as a share of the largest possible.
    fn value_map(&mut self, scene: &mut Scene<'_>) -> Vec<f32> {
        let Space::Discrete { n: actions } = self.spaces.action else { return Vec::new() };
        let mut one_hot = vec![0.0; self.aborts.len()];
        (0..one_hot.len())
            .map(|cell| {
                one_hot.fill(0.0);
                one_hot[cell] = 1.0;
                let values = (0..actions).filter_map(|action| self.value(scene, &one_hot, &[action as f32]));
                values.map(|bar| bar.mean).fold(f32::NAN, f32::max) / self.settings.largest_value
            })
            .collect()
    }

    fn abort_map(&self) -> Vec<f32> {
        let most = self.aborts.iter().copied().max().unwrap_or(0).max(1);
        self.aborts.iter().map(|count| *count as f32 / most as f32).collect()
    }

    fn draw(&mut self, scene: &mut Scene<'_>, shades: &[f32]) -> Result<Picture> {
        // Kept: some environments draw a picture to answer how large it is.
        let [width, height] = *self.settings.size.get_or_insert_with(|| scene.world.frame_size());
        let mut picture = Picture::new(width, height);
        let mut frame = Frame::new(width, height, picture.pixels_mut())?.with_shades(shades);
        scene.world.render(&mut frame).context("the environment was not drawn")?;
        Ok(picture)
    }

    /// Draws, lays the caption under it, and hands it over so many times.
    fn picture(
        &mut self,
        scene: &mut Scene<'_>,
        caption: &Caption,
        value: Option<ValueBar>,
        mark: Option<Mark>,
        times: u32,
    ) -> Result<()> {
        let panels = if self.aborts.is_empty() || scene.reset.is_none() {
            vec![(String::new(), self.draw(scene, &[])?)]
        } else {
            let (values, aborts) = (self.value_map(scene), self.abort_map());
            let most = self.aborts.iter().max().copied().unwrap_or(0);
            vec![
                (format!("reset value, 0 to {}", self.settings.largest_value), self.draw(scene, &values)?),
                (format!("early aborts, at most {most} a cell"), self.draw(scene, &aborts)?),
            ]
        };
        let picture = overlay::compose(&panels, caption, value, mark);
        for _ in 0..times {
            (self.sink)(&picture)?;
        }
        Ok(())
    }

    fn is_filming(&self, steps: u64) -> bool {
        steps > self.settings.from
    }
}

impl Observer for Filmer<'_> {
    fn on_step(&mut self, step: &Step<'_>, scene: &mut Scene<'_>) -> Result<()> {
        let counters = step.counters;
        let is_warm_up = counters.warm_up_decisions > self.counters.warm_up_decisions;
        self.counters = *counters;
        let is_projected = std::mem::take(&mut self.is_projected);
        if !self.is_filming(counters.steps)
            || !(counters.steps - self.settings.from).is_multiple_of(self.settings.every)
        {
            return Ok(());
        }
        let phase = match (step.role, is_warm_up) {
            (AgentRole::Forward, true) => "FORWARD (warm-up)",
            (AgentRole::Forward, false) => "FORWARD",
            (AgentRole::Reset, _) => "RESET",
        };
        let mark = if self.hard_reset_left > 0 {
            self.hard_reset_left -= 1;
            Some(Mark::HardReset)
        } else {
            is_projected.then_some(Mark::Projected)
        };
        let value = self.value(scene, step.observation, step.action);
        self.picture(scene, &Caption { phase, ..Caption::of(counters) }, value, mark, 1)
    }

    fn on_intervention(&mut self, intervention: &Intervention<'_>, scene: &mut Scene<'_>) -> Result<()> {
        if intervention.role != AgentRole::Forward {
            return Ok(());
        }
        if intervention.executed.is_some() {
            self.is_projected = true;
            return Ok(());
        }
        let observation = scene.world.observation().to_vec();
        if let Some(cell) = observation.iter().position(|value| *value == 1.0)
            && let Some(count) = self.aborts.get_mut(cell)
        {
            *count += 1;
        }
        self.counters.early_aborts += 1;
        if !self.is_filming(intervention.step + 1) {
            return Ok(());
        }
        let value = self.value(scene, &observation, intervention.proposed);
        let caption = Caption { phase: "FORWARD", ..Caption::of(&self.counters) };
        self.picture(scene, &caption, value, Some(Mark::Abort), ABORT_PICTURES)
    }

    fn on_episode(&mut self, episode: &EpisodeEvent, _counters: &Counters) -> Result<()> {
        if episode.hard_reset.is_some() {
            self.hard_reset_left = HARD_RESET_PICTURES;
        }
        Ok(())
    }
}
