//! The transitions as bytes, for checkpoints and for the files of a drop-in.

use std::ops::Range;

use super::{Experience, NO_SHARE};

impl Experience {
    /// Bytes of one transition as [`write_rows`](Self::write_rows) writes it.
    pub fn row_bytes(&self) -> usize {
        let observations = 2 * self.observation_len * self.kept_as.width();
        let floats = self.action_len + 2 * self.shares.len();
        let words: usize = self.shares.iter().map(|share| share.words).sum();
        let fates = usize::from(self.undo.is_some());
        observations + (floats + fates) * size_of::<f32>() + words * size_of::<u64>()
    }

    /// Appends kept transitions to `bytes`, [`row_bytes`](Self::row_bytes) each, little-endian.
    pub fn write_rows(&self, numbers: Range<u64>, bytes: &mut Vec<u8>) {
        for slot in numbers.map(|number| self.slot(number)) {
            self.observations.write(slot, self.observation_len, bytes);
            let action = &self.actions[slot * self.action_len..(slot + 1) * self.action_len];
            bytes.extend(action.iter().flat_map(|number| number.to_le_bytes()));
            self.next_observations.write(slot, self.observation_len, bytes);
            for share in &self.shares {
                bytes.extend(share.rewards[slot].to_le_bytes());
                bytes.extend(share.continuations[slot].to_le_bytes());
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
        self.observations.resize(length * observation_len);
        self.actions.resize(length * action_len, 0.0);
        self.next_observations.resize(length * observation_len);
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
            self.observations.read(slot, self.observation_len, &mut row);
            for number in &mut self.actions[slot * self.action_len..(slot + 1) * self.action_len] {
                *number = f32::from_le_bytes(take(&mut row));
            }
            self.next_observations.read(slot, self.observation_len, &mut row);
            for share in &mut self.shares {
                share.rewards[slot] = f32::from_le_bytes(take(&mut row));
                share.continuations[slot] = f32::from_le_bytes(take(&mut row));
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
}

/// The first bytes of what is left of a row.
pub(super) fn take<const N: usize>(row: &mut &[u8]) -> [u8; N] {
    let (value, rest) = row.split_first_chunk().expect("a row has its length");
    *row = rest;
    *value
}
