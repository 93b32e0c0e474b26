//! `decisions/part-NNNNNN.parquet`: every decision with every member's value, in columns.

mod columns;

use columns::{Numbers, TEXTS, Widths, of_event, of_row, properties, schema};

use std::{
    ffi::OsStr,
    fs, io,
    path::{Path, PathBuf},
    sync::Arc,
};

use anyhow::{Context, Result, ensure};
use parquet::{
    data_type::{ByteArray, ByteArrayType, FloatType, Int64Type},
    file::{properties::WriterPropertiesPtr, writer::SerializedFileWriter},
};

use serde::{Deserialize, Serialize};

use crate::read::{DecisionRow, read_part};
use shield_config::{
    atomic_file::{AtomicFile, remove_leftovers},
    state_file::CheckpointError,
};
use shield_core::events::DecisionEvent;

/// Rows that wait in memory until they are written together.
const ROWS: usize = 8_192;

/// Texts of which there are few, each kept once.
#[derive(Default)]
struct Repeated(Vec<ByteArray>);

impl Repeated {
    fn of(&mut self, text: &str) -> ByteArray {
        if let Some(known) = self.0.iter().find(|known| known.data() == text.as_bytes()) {
            return known.clone();
        }
        self.0.push(ByteArray::from(text));
        ByteArray::from(text)
    }
}

/// Where a log stands at a checkpoint: the number of the present part, and how many decisions it has so far.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct DecisionState {
    part: u32,
    rows: u64,
}

/// Writes decisions, in one part after the other. A part gets its name when it is closed, so readers see only whole parts.
pub struct DecisionLog {
    folder: PathBuf,
    part: u32,
    /// Decisions in the present part.
    rows: u64,
    properties: WriterPropertiesPtr,
    widths: Option<Widths>,
    writer: Option<SerializedFileWriter<AtomicFile>>,
    steps: Vec<i64>,
    texts: [Vec<ByteArray>; TEXTS.len()],
    repeated: Repeated,
    states: Vec<ByteArray>,
    /// Row by row.
    numbers: Vec<f32>,
    column: Vec<f32>,
}

impl DecisionLog {
    /// Will write into `folder`. Creates nothing before the first decision.
    pub fn new(folder: PathBuf) -> Self {
        Self {
            folder,
            part: 0,
            rows: 0,
            properties: Arc::new(properties()),
            widths: None,
            writer: None,
            steps: Vec::new(),
            texts: Default::default(),
            repeated: Repeated::default(),
            states: Vec::new(),
            numbers: Vec::new(),
            column: Vec::new(),
        }
    }

    /// Goes on from `state`. Parts that came later are removed, and so is what a killed program left half written; files of other names stay.
    ///
    /// # Errors
    /// The present part cannot be read, or a later one cannot be removed.
    pub fn cut_back(&mut self, state: DecisionState) -> Result<()> {
        self.part = state.part;
        let found = paths(&self.folder)?;
        if !found.is_empty() {
            remove_leftovers(&self.folder)
                .with_context(|| format!("{} cannot be tidied up", self.folder.display()))?;
        }
        if state.rows > 0 {
            // The part may have more: from a checkpoint that came later and is lost.
            let path = path_of(&self.folder, state.part);
            read_part(&path, &mut |row| self.push_row(&row).map(|()| self.rows < state.rows))?;
            ensure!(self.rows == state.rows, "{} ends before the checkpoint", path.display());
        }
        for path in found {
            let is_outdated = match part_of(&path) {
                Some(Part::Closed(part)) => part > state.part || (part == state.part && state.rows == 0),
                Some(Part::Open) => true,
                None => false,
            };
            if is_outdated {
                fs::remove_file(&path).with_context(|| format!("{} cannot be removed", path.display()))?;
            }
        }
        Ok(())
    }

    /// Keeps a decision; writes when enough have come together.
    ///
    /// # Errors
    /// A file cannot be written.
    pub fn push(&mut self, record: &DecisionEvent<'_>) -> Result<()> {
        let cause = record.rejection.map_or("", |rejection| rejection.cause.name());
        let texts = [record.role.name(), record.verdict(), cause];
        self.add(record.step, texts, record.state.unwrap_or_default(), of_event(record))
    }

    /// Keeps a decision that was written before.
    fn push_row(&mut self, row: &DecisionRow) -> Result<()> {
        self.add(row.step, [&row.phase, &row.verdict, &row.cause], &row.state, of_row(row))
    }

    fn add(&mut self, step: u64, texts: [&str; 3], state: &[u8], numbers: Numbers<'_>) -> Result<()> {
        let widths = *self.widths.get_or_insert_with(|| Widths::of(numbers));
        self.steps.push(i64::try_from(step)?);
        let repeated = &mut self.repeated;
        self.texts.iter_mut().zip(texts).for_each(|(column, text)| column.push(repeated.of(text)));
        self.states.push(ByteArray::from(state.to_vec()));
        for (numbers, (_, width)) in numbers.iter().zip(widths.columns()) {
            self.numbers.extend((0..width).map(|index| numbers.get(index).copied().unwrap_or(f32::NAN)));
        }
        self.rows += 1;
        if self.steps.len() == ROWS { self.write_rows() } else { Ok(()) }
    }

    /// Closes the present part, so that it can be read; the next decision begins another.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn begin_part(&mut self) -> Result<DecisionState> {
        if self.suspend()?.rows > 0 {
            (self.part, self.rows) = (self.part + 1, 0);
        }
        Ok(DecisionState { part: self.part, rows: 0 })
    }

    /// Closes the present part for a run that stops; if it goes on, so does the part.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn suspend(&mut self) -> Result<DecisionState> {
        self.write_rows()?;
        if let Some(writer) = self.writer.take() {
            let file = writer.into_inner().with_context(|| self.complaint())?;
            file.sync().and_then(|()| file.commit()).with_context(|| self.complaint())?;
        }
        Ok(DecisionState { part: self.part, rows: self.rows })
    }

    fn complaint(&self) -> String {
        format!("{} cannot be written", path_of(&self.folder, self.part).display())
    }

    fn write_rows(&mut self) -> Result<()> {
        let Some(widths) = self.widths.filter(|_| !self.steps.is_empty()) else { return Ok(()) };
        let complaint = self.complaint();
        let mut writer = match self.writer.take() {
            Some(writer) => writer,
            None => self.open(widths).with_context(|| complaint.clone())?,
        };
        self.write_group(&mut writer, widths).with_context(|| complaint)?;
        self.writer = Some(writer);
        self.steps.clear();
        self.texts.iter_mut().for_each(Vec::clear);
        self.states.clear();
        self.numbers.clear();
        Ok(())
    }

    fn open(&self, widths: Widths) -> Result<SerializedFileWriter<AtomicFile>> {
        fs::create_dir_all(&self.folder)?;
        let file = AtomicFile::create(&path_of(&self.folder, self.part))?;
        Ok(SerializedFileWriter::new(file, schema(widths)?, self.properties.clone())?)
    }

    fn write_group(&mut self, writer: &mut SerializedFileWriter<AtomicFile>, widths: Widths) -> Result<()> {
        let mut group = writer.next_row_group()?;
        let mut index = 0;
        while let Some(mut column) = group.next_column()? {
            match index {
                0 => column.typed::<Int64Type>().write_batch(&self.steps, None, None)?,
                1..=3 => column.typed::<ByteArrayType>().write_batch(&self.texts[index - 1], None, None)?,
                4 => column.typed::<ByteArrayType>().write_batch(&self.states, None, None)?,
                _ => {
                    let numbers = self.numbers.iter().skip(index - 5).step_by(widths.total());
                    self.column.clear();
                    self.column.extend(numbers);
                    column.typed::<FloatType>().write_batch(&self.column, None, None)?
                }
            };
            column.close()?;
            index += 1;
        }
        group.close()?;
        Ok(())
    }
}

/// Everything in the folder, in order; nothing if there is no folder.
pub(crate) fn paths(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = match fs::read_dir(folder) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries.with_context(|| format!("{} cannot be read", folder.display()))?,
    };
    let mut paths: Vec<PathBuf> =
        entries.map(|entry| entry.map(|entry| entry.path())).collect::<Result<_, _>>()?;
    paths.sort();
    Ok(paths)
}

/// What a file's name says of a part.
enum Part {
    Closed(u32),
    /// Version 1.0.0 wrote a part under this name until it was closed.
    Open,
}

/// `None` for a name that no log gives.
fn part_of(path: &Path) -> Option<Part> {
    let (number, extension) =
        path.file_name().and_then(OsStr::to_str)?.strip_prefix("part-")?.split_once('.')?;
    let is_number = number.len() >= 6 && number.bytes().all(|byte| byte.is_ascii_digit());
    match extension {
        "parquet" if is_number => number.parse().ok().map(Part::Closed),
        "partial" if is_number => Some(Part::Open),
        _ => None,
    }
}

fn path_of(folder: &Path, part: u32) -> PathBuf {
    folder.join(format!("part-{part:06}.parquet"))
}

/// Whether the present part reaches as far as a checkpoint says.
///
/// # Errors
/// It ends before, or cannot be read or understood.
pub fn check(folder: &Path, state: DecisionState) -> Result<(), CheckpointError> {
    if state.rows == 0 {
        return Ok(());
    }
    let path = path_of(folder, state.part);
    let torn = |what| CheckpointError::Torn { path: path.clone(), what };
    let mut rows = 0;
    let read = read_part(&path, &mut |_| {
        rows += 1;
        Ok(rows < state.rows)
    });
    match read {
        Ok(_) if rows < state.rows => Err(torn("it ends before the checkpoint")),
        Ok(_) => Ok(()),
        Err(error) => Err(match io_error(&error) {
            Some(kind) => CheckpointError::io(&path, io::Error::new(kind, format!("{error:#}"))),
            None => torn("it cannot be understood"),
        }),
    }
}

/// What the system refused, if it did. A file that ends too early is damaged instead.
fn io_error(error: &anyhow::Error) -> Option<io::ErrorKind> {
    let kinds = error.chain().filter_map(|cause| cause.downcast_ref::<io::Error>()).map(io::Error::kind);
    kinds.into_iter().find(|kind| *kind != io::ErrorKind::UnexpectedEof)
}
