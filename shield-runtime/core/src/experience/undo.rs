//! What a success critic learns from: where each step led, how attempts ended, and how batches are drawn.

use std::ops::Range;

use rand::{Rng, RngExt};
use serde::{Deserialize, Serialize};
use shield_api::{AttemptBatch, Error, Result, Spaces};

use super::{
    Experience,
    attempts::{Attempt, AttemptLog, Outcome},
    failures::{Failures, FailuresState, Label, WINDOW},
    put, rows,
};

/// Where a step led.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fate {
    /// Somewhere outside the reset set.
    GoesOn,
    /// Into the reset set: the action was undone.
    InResetSet,
    /// Where the environment cannot go on, whatever it shows.
    Terminated,
}

/// Stands for the fate of an action that was never executed.
const NEVER: f32 = -1.0;

impl Fate {
    /// Of a step with this outcome. A terminated step is never a success: some environments show their start then.
    pub fn of(outcome: &shield_api::StepOutcome) -> Self {
        match (outcome.terminated, outcome.in_reset_set) {
            (true, _) => Self::Terminated,
            (false, true) => Self::InResetSet,
            (false, false) => Self::GoesOn,
        }
    }

    /// Whether a column says where a step led that was made.
    pub(super) fn is_executed(column: f32) -> bool {
        [Self::GoesOn, Self::InResetSet, Self::Terminated]
            .map(|fate| Self::column(Some(fate)))
            .contains(&column)
    }

    pub(super) fn column(fate: Option<Self>) -> f32 {
        match fate {
            None => NEVER,
            Some(Self::GoesOn) => 0.0,
            Some(Self::InResetSet) => 1.0,
            Some(Self::Terminated) => 2.0,
        }
    }
}

/// How batches for a success critic are drawn.
#[derive(Debug, Clone, Copy)]
pub struct UndoSettings {
    /// Probability that a member learns from a transition.
    pub bootstrap_probability: f64,
    /// The share of a batch that is drawn around the starts of failed attempts.
    pub failure_share: f64,
    /// The share that is drawn from the last steps of successful attempts.
    pub success_share: f64,
    /// Attempts after which an outcome counts half.
    pub outcome_half_life: f64,
}

/// What is kept beside the transitions.
#[derive(Debug)]
pub(super) struct UndoMemory {
    settings: UndoSettings,
    fates: Vec<f32>,
    /// How many of the transitions were executed.
    executed: usize,
    log: AttemptLog,
    failures: Failures,
}

/// The attempts and the failures of an [`Experience`], to be kept.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct UndoMemoryState {
    attempts: Vec<Attempt>,
    ended: u64,
    failures: FailuresState,
}

/// Where a batch for a success critic is gathered; reused for every update.
#[derive(Debug)]
pub struct AttemptBuffers {
    size: usize,
    lengths: [usize; 2],
    members: usize,
    observations: Vec<f32>,
    actions: Vec<f32>,
    next_observations: Vec<f32>,
    next_actions: Vec<f32>,
    successes: Vec<f32>,
    continuations: Vec<f32>,
    outcomes: Vec<f32>,
    outcome_weights: Vec<f32>,
    masks: Vec<f32>,
}

impl AttemptBuffers {
    /// Room for `size` transitions and the masks of `members`.
    pub fn new(size: usize, spaces: &Spaces, members: usize) -> Self {
        let lengths @ [observation, action] = [spaces.observation_len(), spaces.action_len()];
        let zeros = |length: usize| vec![0.0; size * length];
        Self {
            size,
            lengths,
            members,
            observations: zeros(observation),
            actions: zeros(action),
            next_observations: zeros(observation),
            next_actions: zeros(action),
            successes: zeros(1),
            continuations: zeros(1),
            outcomes: zeros(1),
            outcome_weights: zeros(1),
            masks: vec![1.0; size * members],
        }
    }

    /// Transitions per batch.
    pub fn size(&self) -> usize {
        self.size
    }

    /// Asks `act` what the reset agent does in each next state that counts, and gives the batch.
    ///
    /// # Errors
    /// `act` failed.
    pub fn complete(
        &mut self,
        mut act: impl FnMut(&[f32], &mut [f32]) -> Result<()>,
    ) -> Result<AttemptBatch<'_>> {
        let [observation, action] = self.lengths;
        for row in 0..self.size {
            let next_action = &mut self.next_actions[row * action..(row + 1) * action];
            next_action.fill(0.0);
            if self.continuations[row] > 0.0 {
                act(&self.next_observations[row * observation..(row + 1) * observation], next_action)?;
            }
        }
        Ok(AttemptBatch {
            size: self.size,
            observations: &self.observations,
            actions: &self.actions,
            next_observations: &self.next_observations,
            next_actions: &self.next_actions,
            successes: &self.successes,
            continuations: &self.continuations,
            outcomes: &self.outcomes,
            outcome_weights: &self.outcome_weights,
            masks: &self.masks,
        })
    }

    /// Where observation, action and next observation of a row stand.
    fn parts(&mut self, row: usize) -> [&mut [f32]; 3] {
        let [observation, action] = self.lengths;
        let of = |length: usize| row * length..(row + 1) * length;
        [
            &mut self.observations[of(observation)],
            &mut self.actions[of(action)],
            &mut self.next_observations[of(observation)],
        ]
    }

    fn label(&mut self, row: usize, label: Label) {
        self.successes[row] = f32::from(u8::from(label.fate == Fate::column(Some(Fate::InResetSet))));
        self.continuations[row] = f32::from(u8::from(label.fate == Fate::column(Some(Fate::GoesOn))));
        (self.outcomes[row], self.outcome_weights[row]) = (label.outcome, label.weight);
    }
}

impl UndoMemory {
    pub fn new(settings: UndoSettings, capacity: usize, width: usize) -> Result<Self> {
        Ok(Self {
            settings,
            fates: rows(capacity, 1)?,
            executed: 0,
            log: AttemptLog::new(capacity),
            failures: Failures::new(capacity, width),
        })
    }

    /// Notes where the transition of a slot led.
    pub fn put(&mut self, slot: usize, fate: Option<Fate>) {
        self.executed -= usize::from(self.fates.get(slot).is_some_and(|fate| *fate != NEVER));
        self.executed += usize::from(fate.is_some());
        put(&mut self.fates, slot, &[Fate::column(fate)]);
    }

    pub fn fate(&self, slot: usize) -> f32 {
        self.fates[slot]
    }

    /// Becomes the memory of so many transitions that follow through [`read`](Self::read).
    pub fn expect(&mut self, length: usize) {
        self.fates.clear();
        self.fates.resize(length, NEVER);
        self.executed = 0;
    }

    pub fn read(&mut self, slot: usize, fate: f32) {
        self.fates[slot] = fate;
        self.executed += usize::from(fate != NEVER);
    }

    /// Keeps what belongs to the transitions `kept`, and counts their numbers from `back` on.
    pub fn renumber(&mut self, kept: Range<u64>, back: u64) {
        self.log.forget_before(kept.start);
        self.log.forget_from(kept.end);
        self.log.renumber(back);
        self.failures.renumber(back);
    }

    /// What is known of a kept transition.
    fn label(&self, slot: usize, number: u64) -> Label {
        let Outcome { value, weight, age } = self.log.outcome_of(number);
        let ended = self.log.ended().saturating_sub(age);
        Label { number, ended, fate: self.fates[slot], outcome: value, weight }
    }

    /// A reset agent that improves makes old outcomes stale. As they fade, what the critic thinks of the next state takes their place.
    fn faded(&self, label: Label) -> Label {
        let age = self.log.ended().saturating_sub(label.ended) as f64 / self.settings.outcome_half_life;
        Label { weight: label.weight * (-age).exp2() as f32, ..label }
    }

    /// Whether a member learns from a transition: the same answer each time it is drawn, without a bit being kept.
    fn learns(&self, number: u64, member: usize) -> bool {
        let probability = self.settings.bootstrap_probability;
        probability >= 1.0 || (mixed(number, member as u64) as f64) < probability * u64::MAX as f64
    }
}

/// Observation, action and next observation of a row in which they follow one another.
fn split(row: &mut [f32], observation_len: usize, action_len: usize) -> [&mut [f32]; 3] {
    let (observation, rest) = row.split_at_mut(observation_len);
    let (action, next) = rest.split_at_mut(action_len);
    [observation, action, next]
}

/// The finaliser of SplitMix64 (Steele et al. 2014) over both numbers.
fn mixed(number: u64, member: u64) -> u64 {
    let mut z = number.wrapping_add(member.wrapping_mul(0x9e37_79b9_7f4a_7c15));
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

impl Experience {
    /// Notes how an attempt ended whose transitions are all stored. Of a failed one, the steps around its start are kept apart.
    pub fn note_attempt(&mut self, attempt: Attempt) {
        let kept = self.kept();
        let Some(mut undo) = self.undo.take() else { return };
        undo.log.forget_before(kept.start);
        undo.log.push(attempt);
        if !attempt.succeeded {
            let window = attempt.first.saturating_sub(WINDOW)..attempt.first.saturating_add(WINDOW);
            for number in window.start.max(kept.start)..window.end.min(attempt.end.max(attempt.first)) {
                let slot = self.slot(number);
                if undo.fates[slot] != NEVER {
                    let label = undo.label(slot, number);
                    let row = undo.failures.place(label);
                    self.read_parts(slot, split(row, self.observation_len, self.action_len));
                }
            }
        }
        self.undo = Some(undo);
    }

    /// Whether it keeps [what a success critic learns from](Self::with_undo).
    pub fn keeps_undo(&self) -> bool {
        self.undo.is_some()
    }

    /// How many transitions a success critic learns from.
    pub fn len_for_undo(&self) -> usize {
        self.undo.as_ref().map_or(0, |undo| undo.executed)
    }

    /// The attempts and the failures; `None` where no success critic learns.
    pub fn save_undo(&self) -> Option<UndoMemoryState> {
        let undo = self.undo.as_ref()?;
        let (attempts, ended) = (undo.log.to_vec(), undo.log.ended());
        Some(UndoMemoryState { attempts, ended, failures: undo.failures.save() })
    }

    /// Goes on from what [`save_undo`](Self::save_undo) gave.
    ///
    /// # Errors
    /// It belongs to other spaces, or it cannot be.
    pub fn restore_undo(&mut self, state: &UndoMemoryState) -> Result<()> {
        let Some(undo) = &mut self.undo else { return Ok(()) };
        if !undo.log.restore(&state.attempts, state.ended) {
            return Err(Error::invalid_argument("its attempts contradict each other"));
        }
        if !undo.failures.restore(&state.failures) {
            return Err(Error::invalid_argument("its failed attempts belong to other spaces"));
        }
        Ok(())
    }

    /// Draws a batch for a success critic into `buffers`, with replacement: a share around the starts of failed attempts, a share from the
    /// last steps of successful ones, and the rest uniformly. There must be [something to learn from](Self::len_for_undo).
    pub fn sample_undo(&self, buffers: &mut AttemptBuffers, rng: &mut impl Rng) {
        let Some(undo) = &self.undo else { return };
        let share = |share: f64| (share * buffers.size as f64).round() as usize;
        let UndoSettings { failure_share, success_share, .. } = undo.settings;
        let failures = if undo.failures.len() > 0 { share(failure_share) } else { 0 };
        let successes = share(success_share);
        for row in 0..buffers.size {
            let number = if row < failures {
                let (parts, label) = undo.failures.get(rng.random_range(0..undo.failures.len()));
                let [observation, action] = buffers.lengths;
                let (before, next) = parts.split_at(observation + action);
                let (before, action) = before.split_at(observation);
                let [observation_at, action_at, next_at] = buffers.parts(row);
                observation_at.copy_from_slice(before);
                action_at.copy_from_slice(action);
                next_at.copy_from_slice(next);
                buffers.label(row, undo.faded(label));
                label.number
            } else {
                let number = if row < failures + successes { self.near_success(undo, rng) } else { None };
                let number = number.unwrap_or_else(|| self.any_step(undo, rng));
                let slot = self.slot(number);
                self.read_parts(slot, buffers.parts(row));
                buffers.label(row, undo.faded(undo.label(slot, number)));
                number
            };
            if undo.settings.bootstrap_probability < 1.0 {
                for member in 0..buffers.members {
                    let learns = undo.learns(number, member);
                    buffers.masks[row * buffers.members + member] = f32::from(u8::from(learns));
                }
            }
        }
    }

    /// One of the last steps of a successful attempt, if one is found.
    fn near_success(&self, undo: &UndoMemory, rng: &mut impl Rng) -> Option<u64> {
        const TRIES: usize = 8;
        let (kept, attempts) = (self.kept(), undo.log.len());
        for _ in 0..if attempts > 0 { TRIES } else { 0 } {
            let attempt = undo.log.get(rng.random_range(0..attempts));
            let Some(reached) = attempt.reached.filter(|_| attempt.succeeded) else { continue };
            let first = attempt.first.max(reached.saturating_sub(WINDOW - 1)).max(kept.start);
            if first <= reached && reached < kept.end {
                return Some(rng.random_range(first..=reached));
            }
        }
        None
    }

    /// Any step that was executed.
    fn any_step(&self, undo: &UndoMemory, rng: &mut impl Rng) -> u64 {
        let kept = self.kept();
        loop {
            let number = rng.random_range(kept.clone());
            if undo.fates[self.slot(number)] != NEVER {
                return number;
            }
        }
    }

    /// Reads observation, action and next observation.
    fn read_parts(&self, slot: usize, [observation, action, next]: [&mut [f32]; 3]) {
        self.observations.get(slot, observation);
        action.copy_from_slice(&self.actions[slot * self.action_len..(slot + 1) * self.action_len]);
        self.next_observations.get(slot, next);
    }
}

#[cfg(test)]
mod tests;
