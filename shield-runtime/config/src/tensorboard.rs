//! The event file that TensorBoard reads: records of protocol buffers, each between two checksums.
//!
//! The format is TensorFlow's `Event` with `Summary.Value.simple_value` inside `TFRecord`s. TensorBoard wants a wall-clock time with
//! each figure; to keep the file the same in every run of a seed, that is the environment step, read as seconds.

use std::{
    fs::{self, File},
    io::{BufWriter, Write},
    path::{Path, PathBuf},
};

use anyhow::{Context, Result};
use prost::Message;

use crate::growing_file;

/// The name has what TensorBoard looks for.
pub const FILE: &str = "tensorboard/events.out.tfevents.0.shield";
/// What the first event of every file says.
const VERSION: &str = "brain.Event:2";

/// The part of TensorFlow's `event.proto` that scalars need.
#[derive(Clone, PartialEq, Message)]
struct Event {
    #[prost(double, tag = "1")]
    wall_time: f64,
    #[prost(int64, tag = "2")]
    step: i64,
    #[prost(string, optional, tag = "3")]
    file_version: Option<String>,
    #[prost(message, optional, tag = "5")]
    summary: Option<Scalars>,
}

/// `Summary` of `summary.proto`.
#[derive(Clone, PartialEq, Message)]
struct Scalars {
    #[prost(message, repeated, tag = "1")]
    value: Vec<Scalar>,
}

/// `Summary.Value`.
#[derive(Clone, PartialEq, Message)]
struct Scalar {
    #[prost(string, tag = "1")]
    tag: String,
    /// One of several kinds of value in the original, so that a 0 must be written too.
    #[prost(float, optional, tag = "2")]
    simple_value: Option<f32>,
}

/// The event file of a run, growing with it.
pub struct EventFile {
    path: PathBuf,
    file: BufWriter<File>,
}

impl EventFile {
    /// A new file; what a file of that name had is cut off.
    pub fn create(run: &Path) -> Result<Self> {
        let path = run.join(FILE);
        let create = || {
            path.parent().map_or(Ok(()), fs::create_dir_all)?;
            growing_file::begin(&path)
        };
        let file = create().with_context(|| format!("{} cannot be created", path.display()))?;
        let mut events = Self { path, file: BufWriter::new(file) };
        events.write(&Event { file_version: Some(VERSION.into()), ..Event::default() })?;
        Ok(events)
    }

    /// The file of a run that goes on. Nothing changes before [`cut_back`](Self::cut_back).
    pub fn reopen(run: &Path) -> Result<Self> {
        let path = run.join(FILE);
        let file = growing_file::reopen(&path);
        let file = file.with_context(|| format!("{} cannot be continued", path.display()))?;
        Ok(Self { path, file: BufWriter::new(file) })
    }

    /// Cuts off what follows the first `length` bytes.
    pub fn cut_back(&mut self, length: u64) -> Result<()> {
        growing_file::cut_back(self.file.get_ref(), length).with_context(|| self.cannot_write())
    }

    /// Figures after `step` environment steps.
    pub fn scalars(&mut self, step: u64, figures: &[(&str, f64)]) -> Result<()> {
        let scalar =
            |(tag, value): &(&str, f64)| Scalar { tag: (*tag).to_owned(), simple_value: Some(*value as f32) };
        let value = figures.iter().map(scalar).collect();
        let summary = Some(Scalars { value });
        self.write(&Event { wall_time: step as f64, step: step as i64, file_version: None, summary })
    }

    fn write(&mut self, event: &Event) -> Result<()> {
        let body = event.encode_to_vec();
        let length = (body.len() as u64).to_le_bytes();
        let mut record = Vec::with_capacity(body.len() + 16);
        record.extend(length);
        record.extend(masked_checksum(&length).to_le_bytes());
        record.extend(&body);
        record.extend(masked_checksum(&body).to_le_bytes());
        self.file.write_all(&record).with_context(|| self.cannot_write())
    }

    /// Hands finished events to the system.
    pub fn flush(&mut self) -> Result<()> {
        self.file.flush().with_context(|| self.cannot_write())
    }

    /// Makes the events last. Returns the name of the file and its length.
    pub fn sync(&mut self) -> Result<(String, u64)> {
        self.flush()?;
        let file = self.file.get_ref();
        let synced = file.sync_data().and_then(|()| Ok(file.metadata()?.len()));
        Ok((FILE.to_owned(), synced.with_context(|| self.cannot_write())?))
    }

    fn cannot_write(&self) -> String {
        format!("{} cannot be written", self.path.display())
    }
}

/// CRC-32C, rotated and shifted as TFRecord wants it.
fn masked_checksum(bytes: &[u8]) -> u32 {
    crc32c::crc32c(bytes).rotate_right(15).wrapping_add(0xa282_ead8)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every event of a file whose checksums are right.
    fn events(run: &Path) -> Vec<Event> {
        let bytes = fs::read(run.join(FILE)).unwrap();
        let mut rest = bytes.as_slice();
        let mut found = Vec::new();
        let number = |bytes: &[u8]| u32::from_le_bytes(bytes.try_into().unwrap());
        while !rest.is_empty() {
            let length = u64::from_le_bytes(rest[..8].try_into().unwrap()) as usize;
            assert_eq!(number(&rest[8..12]), masked_checksum(&rest[..8]));
            let body = &rest[12..12 + length];
            assert_eq!(number(&rest[12 + length..16 + length]), masked_checksum(body));
            found.push(Event::decode(body).unwrap());
            rest = &rest[16 + length..];
        }
        found
    }

    #[test]
    fn scalars_are_read_back_and_those_after_a_checkpoint_cut_off() {
        let run = tempfile::tempdir().unwrap();
        let mut file = EventFile::create(run.path()).unwrap();
        file.scalars(5, &[("a/b", 1.5), ("c", 0.0)]).unwrap();
        let (_, length) = file.sync().unwrap();
        file.scalars(6, &[("a/b", 7.0)]).unwrap();
        drop(file);
        assert_eq!(events(run.path()).len(), 3);
        let mut file = EventFile::reopen(run.path()).unwrap();
        file.cut_back(length).unwrap();
        file.scalars(8, &[("c", 3.0)]).unwrap();
        drop(file);
        let events = events(run.path());
        assert_eq!(events[0].file_version.as_deref(), Some(VERSION));
        let second = events[1].summary.as_ref().unwrap();
        assert_eq!(
            (events[1].step, second.value[0].tag.as_str(), second.value[1].simple_value),
            (5, "a/b", Some(0.0))
        );
        assert_eq!((events[2].step, events.len()), (8, 3));
    }

    #[test]
    fn the_checksum_matches_tfrecord() {
        // Length 0 of an empty record, as TensorFlow writes it.
        assert_eq!(crc32c::crc32c(b"123456789"), 0xe306_9283);
        assert_eq!(masked_checksum(&[0; 8]), 0x8c28_b28a_u32.rotate_right(15).wrapping_add(0xa282_ead8));
    }
}
