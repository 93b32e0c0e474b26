//! Whether a shield can help in an environment, before anything is trained: a few starts, a few hundred random steps, nothing learned.
//!
//! A caller resets and steps an environment and tells an [`Examination`] what it sees; [`conclude`](Examination::conclude) checks it.

mod checks;
mod checkup;
#[cfg(test)]
mod tests;

pub use checkup::{Check, Checkup, Standing, Verdict};

use shield_api::{ResetTask, Result, metrics::Metrics};

/// Starts that are looked at before the first step: as many as "calibrated-start" needs to promise 95%.
pub const STARTS: u32 = 20;
/// Random steps, if the user names no other number.
pub const STEPS: u32 = 500;
/// Steps of all walks but the first, which takes half of all: a long one shows clocks and ends, many show how starts are left.
const SHORT_WALK: u32 = 50;

/// How a step leaves a walk of random actions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StepEnd {
    /// It goes on.
    Continues,
    /// The environment cannot go on.
    Terminated,
    /// The environment ends its episode by a clock of its own.
    Truncated,
}

/// An observation, and whether it counts as reset; `None` where nobody says so.
#[derive(Debug, Clone)]
struct Seen {
    observation: Vec<f32>,
    is_inside: Option<bool>,
}

/// A start and random actions after it.
#[derive(Debug, Clone, Default)]
struct Walk {
    states: Vec<Seen>,
    has_terminated: bool,
    has_truncated: bool,
}

/// What was seen of an environment.
#[derive(Debug, Clone, Default)]
pub struct Examination {
    starts: Vec<Seen>,
    walks: Vec<Walk>,
    /// Observations with a number that is not finite.
    not_finite: u64,
    /// What the reset task says of its starts, of those left out one by one.
    starts_inside: Option<f64>,
}

impl Examination {
    /// Nothing was seen yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// After so many steps of the present walk and in all, of so many at most: whether a new walk is due.
    pub fn is_walk_over(&self, steps: u32, of: u32) -> bool {
        let limit = if self.walks.len() <= 1 { (of / 2).max(SHORT_WALK) } else { SHORT_WALK };
        steps >= limit
    }

    /// The environment was reset, and this is seen. `is_inside`: whether it counts as reset, where the caller can say so.
    pub fn start(&mut self, observation: &[f32], is_inside: Option<bool>) {
        let seen = self.look(observation, is_inside);
        self.starts.extend(seen);
    }

    /// Random actions begin at the last start.
    pub fn walk(&mut self) {
        self.walks.push(Walk::default());
    }

    /// A random action led here.
    pub fn step(&mut self, observation: &[f32], is_inside: Option<bool>, end: StepEnd) {
        let seen = self.look(observation, is_inside);
        let Some(walk) = self.walks.last_mut() else { return };
        walk.states.extend(seen);
        walk.has_terminated |= end == StepEnd::Terminated;
        walk.has_truncated |= end == StepEnd::Truncated;
    }

    fn look(&mut self, observation: &[f32], is_inside: Option<bool>) -> Option<Seen> {
        let is_finite = observation.iter().all(|value| value.is_finite());
        self.not_finite += u64::from(!is_finite);
        is_finite.then(|| Seen { observation: observation.to_vec(), is_inside })
    }

    /// Tells a new reset task of everything that was seen: the starts, and the random steps as experience.
    ///
    /// # Errors
    /// The task failed.
    pub fn tell(&self, task: &mut dyn ResetTask, action_len: usize) -> Result<()> {
        let action = vec![0.0; action_len];
        self.starts.iter().try_for_each(|seen| task.observe_start(&seen.observation))?;
        for walk in &self.walks {
            for pair in walk.states.windows(2) {
                task.evaluate(&pair[0].observation, &action, &pair[1].observation)?;
            }
        }
        Ok(())
    }

    /// Asks a reset task about everything that was seen, now that it knows starts and experience.
    ///
    /// # Errors
    /// The task failed.
    pub fn judge(&mut self, task: &mut dyn ResetTask, action_len: usize) -> Result<()> {
        let (metrics, action) = (Metrics::default(), vec![0.0; action_len]);
        let states = self.walks.iter_mut().flat_map(|walk| &mut walk.states);
        for seen in states.chain(&mut self.starts) {
            let at = &seen.observation;
            let signal = metrics.collect(|| task.evaluate(at, &action, at))?;
            seen.is_inside = Some(signal.in_reset_set);
        }
        self.starts_inside = metrics.waiting("starts_inside");
        Ok(())
    }

    /// Checks what was seen.
    pub fn conclude(&self) -> Checkup {
        Checkup::of(vec![
            self.observations(),
            self.starts_check(),
            self.states_check(),
            self.leaving(),
            self.spread(),
            self.termination(),
            self.truncation(),
        ])
    }
}
