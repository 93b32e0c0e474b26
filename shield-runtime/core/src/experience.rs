//! The experience that both agents share.
//!
//! Every transition keeps both rewards and, per agent, a continuation flag and one bootstrap bit per ensemble member, so that
//! either agent can learn from what the other did (§4). The memory is a ring of fixed size: nothing is allocated after
//! the start.

mod attempts;
mod batch;
mod failures;
mod undo;

pub use attempts::Attempt;
pub use batch::BatchBuffers;
pub use undo::{AttemptBuffers, Fate, UndoMemoryState, UndoSettings};

use std::ops::Range;

use rand::{Rng, RngExt};
use serde::{Deserialize, Serialize};
use shield_api::{Batch, Error, Result, Spaces};

use self::undo::UndoMemory;

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
    observations: Vec<f32>,
    actions: Vec<f32>,
    next_observations: Vec<f32>,
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
            observations: rows(capacity, observation_len)?,
            actions: rows(capacity, action_len)?,
            next_observations: rows(capacity, observation_len)?,
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

    /// Also keeps what a success critic learns from; to be said while it is empty.
    ///
    /// # Errors
    /// The memory does not have that much room.
    pub fn with_undo(mut self, settings: UndoSettings) -> Result<Self> {
        let width = 2 * self.observation_len + self.action_len;
        self.undo = Some(UndoMemory::new(settings, self.capacity, width)?);
        Ok(self)
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

    /// Bytes of one transition as [`write_rows`](Self::write_rows) writes it.
    pub fn row_bytes(&self) -> usize {
        let floats = 2 * self.observation_len + self.action_len + 2 * self.shares.len();
        let words: usize = self.shares.iter().map(|share| share.words).sum();
        let fates = usize::from(self.undo.is_some());
        (floats + fates) * size_of::<f32>() + words * size_of::<u64>()
    }

    /// Appends kept transitions to `bytes`, [`row_bytes`](Self::row_bytes) each, little-endian.
    pub fn write_rows(&self, numbers: Range<u64>, bytes: &mut Vec<u8>) {
        for slot in numbers.map(|number| self.slot(number)) {
            for (rows, length) in self.columns() {
                bytes.extend(rows[slot * length..(slot + 1) * length].iter().flat_map(|x| x.to_le_bytes()));
            }
            for share in &self.shares {
                let mask = &share.masks[slot * share.words..(slot + 1) * share.words];
                bytes.extend(mask.iter().flat_map(|word| word.to_le_bytes()));
            }
            if let Some(undo) = &self.undo {
                bytes.extend(undo.fate(slot).to_le_bytes());
            }
        }
    }

    /// Becomes a memory that keeps the transitions `kept`; their contents follow through [`read_rows`](Self::read_rows).
    pub fn expect_rows(&mut self, kept: Range<u64>) {
        let length = (kept.end - kept.start) as usize;
        let (observation_len, action_len) = (self.observation_len, self.action_len);
        self.observations.resize(length * observation_len, 0.0);
        self.actions.resize(length * action_len, 0.0);
        self.next_observations.resize(length * observation_len, 0.0);
        for share in &mut self.shares {
            share.rewards.resize(length, 0.0);
            share.continuations.resize(length, 0.0);
            share.masks.resize(length * share.words, 0);
            share.count = 0;
        }
        if let Some(undo) = &mut self.undo {
            undo.expect(length);
        }
        self.pushed = kept.end;
    }

    /// Puts transitions that [`write_rows`](Self::write_rows) wrote back into their slots, the first of them number `first`.
    pub fn read_rows(&mut self, first: u64, bytes: &[u8]) {
        for (number, mut row) in (first..).zip(bytes.chunks_exact(self.row_bytes())) {
            let slot = self.slot(number);
            for (rows, length) in self.columns_mut() {
                for value in &mut rows[slot * length..(slot + 1) * length] {
                    *value = f32::from_le_bytes(take(&mut row));
                }
            }
            for share in &mut self.shares {
                for word in &mut share.masks[slot * share.words..(slot + 1) * share.words] {
                    *word = u64::from_le_bytes(take(&mut row));
                }
                share.count += usize::from(share.continuations[slot] != NO_SHARE);
            }
            if let Some(undo) = &mut self.undo {
                undo.read(slot, f32::from_le_bytes(take(&mut row)));
            }
        }
    }

    /// Becomes a memory with the transitions `kept`, whose rows [`write_rows`](Self::write_rows) wrote, perhaps of a memory of another capacity. Of
    /// more than there is room for, the newest stay; fewer are numbered from 0, since a memory that is not full has forgotten nothing.
    pub(crate) fn replace(&mut self, kept: Range<u64>, rows: &[u8]) {
        let room = self.capacity as u64;
        let first = kept.start.max(kept.end.saturating_sub(room));
        let forgotten = (first - kept.start) as usize * self.row_bytes();
        let (end, count) = (kept.end, kept.end - first);
        let kept = if count < room { 0..count } else { first..end };
        if let Some(undo) = &mut self.undo {
            undo.renumber(first..end, first - kept.start);
        }
        self.expect_rows(kept.clone());
        self.read_rows(kept.start, &rows[forgotten..]);
    }

    /// Everything but the masks, with the length of a row.
    fn columns(&self) -> [(&[f32], usize); 7] {
        let [forward, reset] = &self.shares;
        [
            (&self.observations, self.observation_len),
            (&self.actions, self.action_len),
            (&self.next_observations, self.observation_len),
            (&forward.rewards, 1),
            (&forward.continuations, 1),
            (&reset.rewards, 1),
            (&reset.continuations, 1),
        ]
    }

    fn columns_mut(&mut self) -> [(&mut [f32], usize); 7] {
        let [forward, reset] = &mut self.shares;
        [
            (&mut self.observations, self.observation_len),
            (&mut self.actions, self.action_len),
            (&mut self.next_observations, self.observation_len),
            (&mut forward.rewards, 1),
            (&mut forward.continuations, 1),
            (&mut reset.rewards, 1),
            (&mut reset.continuations, 1),
        ]
    }

    /// Stores a transition, over the oldest one if the memory is full, and draws its bootstrap masks from `rng`.
    pub fn push(&mut self, transition: &Transition<'_>, rng: &mut impl Rng) {
        let slot = self.slot(self.pushed);
        put(&mut self.observations, slot, transition.observation);
        put(&mut self.actions, slot, transition.action);
        put(&mut self.next_observations, slot, transition.next_observation);
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
            copy(&mut buffers.observations, row, &self.observations, slot, self.observation_len);
            copy(&mut buffers.actions, row, &self.actions, slot, self.action_len);
            copy(&mut buffers.next_observations, row, &self.next_observations, slot, self.observation_len);
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

/// The first bytes of what is left of a row.
fn take<const N: usize>(row: &mut &[u8]) -> [u8; N] {
    let (value, rest) = row.split_first_chunk().expect("a row has its length");
    *row = rest;
    *value
}

fn copy(target: &mut [f32], row: usize, source: &[f32], slot: usize, length: usize) {
    target[row * length..(row + 1) * length].copy_from_slice(&source[slot * length..(slot + 1) * length]);
}

#[cfg(test)]
mod tests;
