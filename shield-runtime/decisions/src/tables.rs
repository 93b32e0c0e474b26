//! The CSV files of a run or of a drop-in's record: a structure per row, which names the columns too.

mod rows;

pub use rows::{InterventionRow, LearningRow, MetricsRow};

use std::{
    fs::File,
    io::BufWriter,
    path::{Path, PathBuf},
};

use anyhow::{Context, Result};
use csv::Writer;
use serde::Serialize;

use shield_config::growing_file;

/// A row of one of the files; the fields are the columns.
pub trait Row: Serialize + Default {
    /// Its name in the folder.
    const FILE: &'static str;
}

/// A file that grows row by row.
pub struct Table {
    path: PathBuf,
    name: &'static str,
    writer: Writer<BufWriter<File>>,
    /// The length of what was handed to the system whole.
    whole: u64,
}

impl Table {
    /// A new file with the heading of `R`.
    ///
    /// # Errors
    /// It cannot be created.
    pub fn create<R: Row>(folder: &Path) -> Result<Self> {
        let path = folder.join(R::FILE);
        let file =
            growing_file::begin(&path).with_context(|| format!("{} cannot be created", path.display()))?;
        let mut table = Self::over(path, R::FILE, file);
        // The heading stands there even if no row follows: it is that of a row which nobody sees.
        let mut heading = Writer::from_writer(Vec::new());
        heading.serialize(R::default())?;
        let heading = heading.into_inner().map_err(|error| error.into_error())?;
        let columns = csv::Reader::from_reader(heading.as_slice()).headers()?.clone();
        table.writer.write_record(&columns)?;
        table.flush()?;
        Ok(table)
    }

    /// The file of a run that goes on. Nothing changes before [`cut_back`](Self::cut_back).
    ///
    /// # Errors
    /// It is missing or cannot be written.
    pub fn reopen<R: Row>(folder: &Path) -> Result<Self> {
        let path = folder.join(R::FILE);
        let file = growing_file::reopen(&path);
        let file = file.with_context(|| format!("{} cannot be continued", path.display()))?;
        Ok(Self::over(path, R::FILE, file))
    }

    /// Cuts off what follows the first `length` bytes.
    ///
    /// # Errors
    /// The system refuses.
    pub fn cut_back(&mut self, length: u64) -> Result<()> {
        growing_file::cut_back(self.file(), length).with_context(|| self.cannot_write())?;
        self.whole = length;
        Ok(())
    }

    fn over(path: PathBuf, name: &'static str, file: File) -> Self {
        let writer = csv::WriterBuilder::new().has_headers(false).from_writer(BufWriter::new(file));
        Self { path, name, writer, whole: 0 }
    }

    /// The name of the file.
    pub fn name(&self) -> &'static str {
        self.name
    }

    /// Appends a row of the type that the table was made for.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn write(&mut self, row: &impl Row) -> Result<()> {
        self.writer.serialize(row).with_context(|| self.cannot_write())
    }

    /// Hands finished rows to the system.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn flush(&mut self) -> Result<()> {
        self.writer.flush().with_context(|| self.cannot_write())?;
        self.whole = self.file().metadata().with_context(|| self.cannot_write())?.len();
        Ok(())
    }

    /// Writes no more: after a failure, the file ends with the last row that was handed over whole.
    ///
    /// # Errors
    /// The file cannot be cut back.
    pub fn abandon(self) -> Result<()> {
        let Self { path, writer, whole, .. } = self;
        // What it still holds back may be written in part now.
        drop(writer);
        let cut = growing_file::reopen(&path).and_then(|file| growing_file::cut_back(&file, whole));
        cut.with_context(|| format!("{} cannot be cut back", path.display()))
    }

    fn file(&self) -> &File {
        self.writer.get_ref().get_ref()
    }

    /// Makes the rows last. Returns the name of the file and its length.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn sync(&mut self) -> Result<(String, u64)> {
        self.flush()?;
        let file = self.file();
        let synced = file.sync_data().and_then(|()| Ok(file.metadata()?.len()));
        Ok((self.name.to_owned(), synced.with_context(|| self.cannot_write())?))
    }

    fn cannot_write(&self) -> String {
        format!("{} cannot be written", self.path.display())
    }
}
