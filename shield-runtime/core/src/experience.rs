//! The experience that both agents share.
//!
//! Every transition keeps both rewards and, per agent, a continuation flag and one bootstrap bit per ensemble member, so that
//! either agent can learn from what the other did (§4). The memory is a ring of fixed size: nothing is allocated after
//! the start.

mod attempts;
mod batch;
mod failures;
mod observations;
mod rows;
mod undo;

pub use attempts::Attempt;
pub use batch::BatchBuffers;
pub use observations::Kept;
pub use undo::{AttemptBuffers, Fate, UndoMemoryState, UndoSettings};

use std::ops::Range;

use rand::{Rng, RngExt};
use serde::{Deserialize, Serialize};
use shield_api::{Batch, Error, Result, Spaces};

use self::{failures::Failures, observations::Observations, undo::UndoMemory};

/// One of the two agents.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum AgentRole {
    /// Does the task.
    Forward,
    /// Undoes it.
    Reset,
}

impl AgentRole {
    fn index(self) -> usize {
        match self {
            Self::Forward => 0,
            Self::Reset => 1,
        }
    }

    /// Its name in files and logs.
    pub fn name(self) -> &'static str {
        match self {
            Self::Forward => "forward",
            Self::Reset => "reset",
        }
    }
}

/// What one agent takes from a transition.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AgentShare {
    /// Its reward.
    pub reward: f32,
    /// Whether the value of the next state counts. False only where the task ends for this agent; true at a time-out.
    pub continues: bool,
}

/// One environment step, or one that was rejected, about to be stored.
#[derive(Debug, Clone, Copy)]
pub struct Transition<'a> {
    /// The state before.
    pub observation: &'a [f32],
    /// The executed action; a rejected one only in what a single agent learns from.
    pub action: &'a [f32],
    /// The state after.
    pub next_observation: &'a [f32],
    /// The forward agent's share; `None` if it does not learn from it.
    pub forward: Option<AgentShare>,
    /// The reset agent's share; `None` if it does not learn from it.
    pub reset: Option<AgentShare>,
    /// Where it led, for the success critic; `None` if the action was never executed.
    pub fate: Option<Fate>,
}

/// Stands for the continuation flag where an agent has no share.
const NO_SHARE: f32 = -1.0;

/// Per agent: rewards, continuation flags and bootstrap masks.
#[derive(Debug)]
struct Shares {
    rewards: Vec<f32>,
    continuations: Vec<f32>,
    /// `words` words of mask bits per transition; empty where every member learns from everything.
    masks: Vec<u64>,
    words: usize,
    members: usize,
    /// How many of the transitions the agent has a share in.
    count: usize,
}

impl Shares {
    fn new(capacity: usize, members: usize, is_masked: bool) -> Result<Self> {
        let words = if is_masked { members.div_ceil(64) } else { 0 };
        Ok(Self {
            rewards: rows(capacity, 1)?,
            continuations: rows(capacity, 1)?,
            masks: rows(capacity, words)?,
            words,
            members,
            count: 0,
        })
    }

    fn put(&mut self, slot: usize, share: Option<AgentShare>) {
        let is_over = self.continuations.get(slot).is_some_and(|flag| *flag != NO_SHARE);
        self.count = self.count + usize::from(share.is_some()) - usize::from(is_over);
        let (reward, flag) = match share {
            Some(AgentShare { reward, continues }) => (reward, if continues { 1.0 } else { 0.0 }),
            None => (0.0, NO_SHARE),
        };
        put(&mut self.rewards, slot, &[reward]);
        put(&mut self.continuations, slot, &[flag]);
    }
}

/// The replay memory of both agents.
#[derive(Debug)]
pub struct Experience {
    capacity: usize,
    observation_len: usize,
    action_len: usize,
    bootstrap_probability: f64,
    /// Transitions after which an abort is drawn no more.
    abort_lifetime: Option<u64>,
    /// Transitions ever stored; the next one goes to the slot of that number, modulo the capacity.
    pushed: u64,
    kept_as: Kept,
    observations: Observations,
    actions: Vec<f32>,
    next_observations: Observations,
    shares: [Shares; 2],
    mask: Vec<u64>,
    /// What a success critic learns from; `None` where there is none.
    undo: Option<UndoMemory>,
}

impl Experience {
    /// An empty memory. `members` are the ensemble sizes of the forward and of the reset agent (0 where there is none).
    ///
    /// # Errors
    /// The memory does not have that much room.
    pub fn new(
        capacity: usize,
        spaces: &Spaces,
        members: [usize; 2],
        bootstrap_probability: f64,
    ) -> Result<Self> {
        let is_masked = bootstrap_probability < 1.0;
        let (observation_len, action_len) = (spaces.observation_len(), spaces.action_len());
        let [forward, reset] = members.map(|members| Shares::new(capacity, members, is_masked));
        let shares = [forward?, reset?];
        let words = shares.iter().map(|share| share.words).max().unwrap_or(0);
        Ok(Self {
            capacity,
            observation_len,
            action_len,
            bootstrap_probability,
            abort_lifetime: None,
            pushed: 0,
            kept_as: Kept::Floats,
            observations: Observations::new(Kept::Floats, capacity, observation_len)?,
            actions: rows(capacity, action_len)?,
            next_observations: Observations::new(Kept::Floats, capacity, observation_len)?,
            shares,
            mask: vec![0; words],
            undo: None,
        })
    }

    /// Aborts teach only that long, in transitions: later the shield may think otherwise.
    #[must_use]
    pub fn with_abort_lifetime(mut self, lifetime: Option<u64>) -> Self {
        self.abort_lifetime = lifetime;
        self
    }

    /// Keeps observations so; to be said while it is empty.
    ///
    /// # Errors
    /// The memory does not have that much room.
    pub fn keeping(mut self, kept_as: Kept) -> Result<Self> {
        if kept_as != self.kept_as {
            self.observations = Observations::new(kept_as, self.capacity, self.observation_len)?;
            self.next_observations = Observations::new(kept_as, self.capacity, self.observation_len)?;
            self.kept_as = kept_as;
        }
        Ok(self)
    }

    /// Also keeps what a success critic learns from; to be said while it is empty.
    ///
    /// # Errors
    /// The memory does not have that much room.
    pub fn with_undo(mut self, settings: UndoSettings) -> Result<Self> {
        let width = 2 * self.observation_len + self.action_len;
        self.undo = Some(UndoMemory::new(settings, self.capacity, width)?);
        Ok(self)
    }

    /// Bytes of a memory with so much room once it is full, for ensembles that learn from everything. `keeps_undo`: [also](Self::with_undo) what a
    /// success critic learns from.
    pub fn bytes_when_full(capacity: usize, kept_as: Kept, spaces: &Spaces, keeps_undo: bool) -> u64 {
        let (observation, action) = (spaces.observation_len() as u64, spaces.action_len() as u64);
        let of_float = size_of::<f32>() as u64;
        let row = 2 * observation * kept_as.width() as u64 + (action + 5) * of_float;
        let failures = if keeps_undo { Failures::most(capacity) as u64 } else { 0 };
        (capacity as u64).saturating_mul(row) + failures * (2 * observation + action) * of_float
    }

    /// How many transitions there is room for.
    pub fn capacity(&self) -> usize {
        self.capacity
    }

    /// How many transitions are kept.
    pub fn len(&self) -> usize {
        self.shares[0].rewards.len()
    }

    /// How many of them one agent learns from.
    pub fn len_for(&self, role: AgentRole) -> usize {
        self.shares[role.index()].count
    }

    /// Whether nothing is kept.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The numbers of the transitions that are kept, counted since the start of the run.
    pub fn kept(&self) -> Range<u64> {
        self.pushed - self.len() as u64..self.pushed
    }

    /// Stores a transition, over the oldest one if the memory is full, and draws its bootstrap masks from `rng`.
    pub fn push(&mut self, transition: &Transition<'_>, rng: &mut impl Rng) {
        let slot = self.slot(self.pushed);
        self.observations.put(slot, transition.observation);
        put(&mut self.actions, slot, transition.action);
        self.next_observations.put(slot, transition.next_observation);
        for (share, taken) in self.shares.iter_mut().zip([transition.forward, transition.reset]) {
            share.put(slot, taken);
            let mask = &mut self.mask[..share.words];
            mask.fill(0);
            for member in 0..if share.words > 0 { share.members } else { 0 } {
                if rng.random_bool(self.bootstrap_probability) {
                    mask[member / 64] |= 1 << (member % 64);
                }
            }
            put(&mut share.masks, slot, mask);
        }
        if let Some(undo) = &mut self.undo {
            undo.put(slot, transition.fate);
        }
        self.pushed += 1;
    }

    /// The number of the transition that will be stored next.
    pub fn next_number(&self) -> u64 {
        self.pushed
    }

    fn slot(&self, number: u64) -> usize {
        (number % self.capacity as u64) as usize
    }

    /// Lowers an agent's reward of the transition that was stored last, if it has a share in it.
    pub fn charge_last(&mut self, role: AgentRole, cost: f32) {
        if cost == 0.0 || self.is_empty() {
            return;
        }
        let last = self.slot(self.pushed - 1);
        let share = &mut self.shares[role.index()];
        if share.continuations[last] != NO_SHARE {
            share.rewards[last] -= cost;
        }
    }

    /// Whether a slot holds an abort that teaches no more: what only the forward agent learns from was never executed.
    fn is_stale(&self, slot: usize) -> bool {
        let Some(lifetime) = self.abort_lifetime else { return false };
        let executed = &self.shares[AgentRole::Reset.index()];
        let is_abort = executed.continuations[slot] == NO_SHARE;
        let age = (self.slot(self.pushed) + self.capacity - slot - 1) % self.capacity;
        is_abort && age as u64 >= lifetime && executed.count > 0
    }

    /// Draws a batch for one agent, uniformly with replacement from what it has a share in, into `buffers`.
    ///
    /// # Panics
    /// There is nothing that it has a share in.
    pub fn sample<'b>(
        &self,
        role: AgentRole,
        buffers: &'b mut BatchBuffers,
        rng: &mut impl Rng,
    ) -> Batch<'b> {
        let share = &self.shares[role.index()];
        assert!(share.count > 0, "there is nothing to learn from");
        for row in 0..buffers.size {
            let mut slot = rng.random_range(0..self.len());
            while share.continuations[slot] == NO_SHARE || self.is_stale(slot) {
                slot = rng.random_range(0..self.len());
            }
            let row_of = |length: usize| row * length..(row + 1) * length;
            self.observations.get(slot, &mut buffers.observations[row_of(self.observation_len)]);
            copy(&mut buffers.actions, row, &self.actions, slot, self.action_len);
            self.next_observations.get(slot, &mut buffers.next_observations[row_of(self.observation_len)]);
            buffers.rewards[row] = share.rewards[slot];
            buffers.continuations[row] = share.continuations[slot];
            if share.words > 0 {
                let bits = &share.masks[slot * share.words..(slot + 1) * share.words];
                for member in 0..share.members {
                    let is_set = bits[member / 64] >> (member % 64) & 1 == 1;
                    buffers.masks[row * share.members + member] = if is_set { 1.0 } else { 0.0 };
                }
            }
        }
        buffers.as_batch()
    }
}

/// Room for `capacity` rows, reserved now so that a step never allocates. The system gives the memory when it is first written.
fn rows<T>(capacity: usize, length: usize) -> Result<Vec<T>> {
    let mut rows = Vec::new();
    rows.try_reserve_exact(capacity.saturating_mul(length)).map_err(|_| {
        Error::failed(format!("there is no memory for {capacity} transitions; choose a smaller capacity"))
    })?;
    Ok(rows)
}

/// Writes a row over an existing one, or appends it.
fn put<T: Copy>(rows: &mut Vec<T>, slot: usize, row: &[T]) {
    let start = slot * row.len();
    if start < rows.len() {
        rows[start..start + row.len()].copy_from_slice(row);
    } else {
        rows.extend_from_slice(row);
    }
}

fn copy(target: &mut [f32], row: usize, source: &[f32], slot: usize, length: usize) {
    target[row * length..(row + 1) * length].copy_from_slice(&source[slot * length..(slot + 1) * length]);
}

#[cfg(test)]
mod tests;
