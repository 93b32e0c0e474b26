//! The experience on disk: segments of transitions in the order in which they were stored.

use std::{
    ffi::OsStr,
    fs::{self, File},
    io::{self, Read, Write},
    ops::Range,
    path::{Path, PathBuf},
};

use crc32fast::Hasher;
use serde::{Deserialize, Serialize};
use shield_api::regular_file;

use shield_config::growing_file;
use shield_config::state_file::{CheckpointError, Result, sync_folder};
use shield_core::experience::Experience;

/// Transitions in a full segment.
const SEGMENT_ROWS: u64 = 65_536;
/// Transitions that are written or read at once.
const BLOCK_ROWS: u64 = 4_096;

/// Consecutive transitions in one file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
struct Segment {
    /// Number of its first transition since the start of the run.
    first: u64,
    rows: u64,
    crc: u32,
}

impl Segment {
    fn end(&self) -> u64 {
        self.first + self.rows
    }

    fn path(&self, folder: &Path) -> PathBuf {
        folder.join(format!("experience-{:012}.rows", self.first))
    }
}

/// Whether [`Segment::path`] made the name.
fn is_segment(path: &Path) -> bool {
    let name = path.file_name().and_then(OsStr::to_str);
    let first = name.and_then(|name| name.strip_prefix("experience-")?.strip_suffix(".rows"));
    first.is_some_and(|first| first.len() >= 12 && first.bytes().all(|byte| byte.is_ascii_digit()))
}

/// How far the segments count for a checkpoint.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Mark {
    kept: Range<u64>,
    segments: Vec<Segment>,
}

/// Appends what is new in the experience.
#[derive(Debug)]
pub(super) struct ExperienceLog {
    folder: PathBuf,
    segments: Vec<Segment>,
    /// The last segment.
    file: Option<File>,
}

impl ExperienceLog {
    pub fn new(folder: &Path) -> Self {
        Self { folder: folder.to_owned(), segments: Vec::new(), file: None }
    }

    /// Writes what was stored since the last time and syncs it.
    pub fn append(&mut self, experience: &Experience) -> Result<Mark> {
        let kept = experience.kept();
        let written = self.segments.last().map_or(0, Segment::end);
        // A small memory may have forgotten transitions before they were written: those are not needed any more.
        let mut next = written.max(kept.start);
        let mut block = Vec::new();
        while next < kept.end {
            let room = match self.segments.last() {
                Some(segment) if segment.end() == next => SEGMENT_ROWS - segment.rows,
                _ => 0,
            };
            if room == 0 {
                self.sync()?;
                self.begin_segment(next)?;
                continue;
            }
            let end = kept.end.min(next + room.min(BLOCK_ROWS));
            block.clear();
            experience.write_rows(next..end, &mut block);
            self.write(&block, end - next)?;
            next = end;
        }
        self.sync()?;
        self.segments.retain(|segment| segment.end() > kept.start);
        Ok(Mark { kept, segments: self.segments.clone() })
    }

    fn begin_segment(&mut self, first: u64) -> Result<()> {
        let segment = Segment { first, rows: 0, crc: 0 };
        let path = segment.path(&self.folder);
        let file = growing_file::begin(&path).map_err(|error| CheckpointError::io(&path, error))?;
        self.file = Some(file);
        self.segments.push(segment);
        sync_folder(&self.folder)
    }

    fn write(&mut self, block: &[u8], rows: u64) -> Result<()> {
        let (Some(segment), Some(file)) = (self.segments.last_mut(), &mut self.file) else { return Ok(()) };
        file.write_all(block).map_err(|error| CheckpointError::io(&segment.path(&self.folder), error))?;
        let mut hasher = Hasher::new_with_initial(segment.crc);
        hasher.update(block);
        segment.crc = hasher.finalize();
        segment.rows += rows;
        Ok(())
    }

    fn sync(&self) -> Result<()> {
        let Some(file) = &self.file else { return Ok(()) };
        file.sync_data().map_err(|error| CheckpointError::io(&self.folder, error))
    }

    /// Removes the segments that none of the checkpoints needs.
    pub fn keep_only(&self, needed: &[&Mark]) -> Result<()> {
        let needed: Vec<PathBuf> = needed
            .iter()
            .flat_map(|mark| mark.segments.iter().map(|segment| segment.path(&self.folder)))
            .collect();
        let failed = |error| CheckpointError::io(&self.folder, error);
        for entry in fs::read_dir(&self.folder).map_err(failed)? {
            let path = entry.map_err(failed)?.path();
            if is_segment(&path) && !needed.contains(&path) {
                fs::remove_file(&path).map_err(|error| CheckpointError::io(&path, error))?;
            }
        }
        Ok(())
    }

    /// Fills an empty `experience` up to a checkpoint's mark.
    pub fn read(folder: &Path, mark: &Mark, experience: &mut Experience) -> Result<()> {
        experience.expect_rows(mark.kept.clone());
        let row_bytes = experience.row_bytes();
        for segment in &mark.segments {
            let path = segment.path(folder);
            let failed = |error| CheckpointError::io(&path, error);
            let torn = |what| CheckpointError::Torn { path: path.clone(), what };
            let mut file = regular_file::open(&path).map_err(failed)?;
            let mut hasher = Hasher::new();
            let mut block = Vec::new();
            let mut next = segment.first;
            while next < segment.end() {
                let rows = BLOCK_ROWS.min(segment.end() - next);
                block.resize(rows as usize * row_bytes, 0);
                file.read_exact(&mut block).map_err(|error| match error.kind() {
                    io::ErrorKind::UnexpectedEof => torn("it ends too early"),
                    _ => failed(error),
                })?;
                hasher.update(&block);
                let forgotten = mark.kept.start.saturating_sub(next).min(rows);
                experience.read_rows(next + forgotten, &block[forgotten as usize * row_bytes..]);
                next += rows;
            }
            if hasher.finalize() != segment.crc {
                return Err(torn("its checksum is wrong"));
            }
        }
        Ok(())
    }

    /// Opens the segments to go on from a checkpoint's mark. Nothing changes before [`cut_back`](Self::cut_back).
    pub fn reopen(folder: &Path, mark: &Mark) -> Result<Self> {
        let mut log = Self { segments: mark.segments.clone(), ..Self::new(folder) };
        if let Some(last) = log.segments.last() {
            let path = last.path(folder);
            let file = growing_file::reopen(&path);
            log.file = Some(file.map_err(|error| CheckpointError::io(&path, error))?);
        }
        Ok(log)
    }

    /// Cuts off what was appended after the mark.
    pub fn cut_back(&mut self, row_bytes: usize) -> Result<()> {
        let (Some(last), Some(file)) = (self.segments.last(), &self.file) else { return Ok(()) };
        growing_file::cut_back(file, last.rows * row_bytes as u64)
            .map_err(|error| CheckpointError::io(&last.path(&self.folder), error))
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_pcg::Pcg64;
    use shield_api::{Space, Spaces};

    use super::*;
    use shield_core::experience::{AgentShare, Transition};

    fn memory(capacity: usize) -> Experience {
        let spaces = Spaces { observation: Space::unbounded(1), action: Space::uniform(1, -1.0, 1.0) };
        Experience::new(capacity, &spaces, [1, 1], 1.0).unwrap()
    }

    fn push(experience: &mut Experience, count: u64) {
        let mut rng = Pcg64::seed_from_u64(0);
        for _ in 0..count {
            let value = experience.kept().end as f32;
            let share = Some(AgentShare { reward: value, continues: true });
            let transition = Transition {
                observation: &[value],
                action: &[0.5],
                next_observation: &[value + 1.0],
                forward: share,
                reset: share,
                fate: None,
            };
            experience.push(&transition, &mut rng);
        }
    }

    fn rows(experience: &Experience) -> Vec<u8> {
        let mut bytes = Vec::new();
        experience.write_rows(experience.kept(), &mut bytes);
        bytes
    }

    #[test]
    fn replay_buffers_of_every_size_are_restored_and_old_segments_deleted() {
        for (capacity, between) in [(10, 3), (10, 25), (70_000, 40_000), (200_000, 90_000)] {
            let folder = tempfile::tempdir().unwrap();
            let mut experience = memory(capacity);
            let mut log = ExperienceLog::new(folder.path());
            let mut previous: Option<Mark> = None;
            for _ in 0..4 {
                push(&mut experience, between);
                let mark = log.append(&experience).unwrap();
                log.keep_only(&previous.iter().chain([&mark]).collect::<Vec<_>>()).unwrap();
                for (mark, is_last) in previous.iter().map(|mark| (mark, false)).chain([(&mark, true)]) {
                    let mut read = memory(capacity);
                    ExperienceLog::read(folder.path(), mark, &mut read).unwrap();
                    assert_eq!(read.kept(), mark.kept);
                    assert!(!is_last || rows(&read) == rows(&experience), "{capacity}, {between}");
                }
                previous = Some(mark);
            }
            let bytes: u64 = fs::read_dir(folder.path())
                .unwrap()
                .map(|entry| entry.unwrap().metadata().unwrap().len())
                .sum();
            let most = (capacity as u64 + between + 2 * SEGMENT_ROWS) * experience.row_bytes() as u64;
            assert!(bytes <= most, "{bytes} bytes for a memory of {capacity}");
        }
    }

    #[test]
    fn rows_appended_after_a_checkpoint_are_cut_off() {
        let folder = tempfile::tempdir().unwrap();
        let mut experience = memory(100);
        let mut log = ExperienceLog::new(folder.path());
        push(&mut experience, 20);
        let mark = log.append(&experience).unwrap();
        push(&mut experience, 30);
        log.append(&experience).unwrap();
        let mut again = memory(100);
        ExperienceLog::read(folder.path(), &mark, &mut again).unwrap();
        let mut log = ExperienceLog::reopen(folder.path(), &mark).unwrap();
        log.cut_back(again.row_bytes()).unwrap();
        push(&mut again, 30);
        let mark = log.append(&again).unwrap();
        let mut read = memory(100);
        ExperienceLog::read(folder.path(), &mark, &mut read).unwrap();
        assert!(rows(&read) == rows(&experience));
    }
}
