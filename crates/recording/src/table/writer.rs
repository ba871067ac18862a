//! Writing a CSV file, whole or not at all.

use std::io::{self, BufWriter, Write};
use std::path::Path;

use flate2::write::GzEncoder;

use super::TableError;
use crate::atomic_file::AtomicFile;

/// Writes a CSV file cell by cell; `.gz` at the end of its name zips it. It appears with [`TableWriter::finish`].
pub struct TableWriter {
    file: String,
    csv: csv::Writer<Sink>,
    cell: String,
}

enum Sink {
    Plain(AtomicFile),
    Zipped(BufWriter<GzEncoder<AtomicFile>>),
}

impl TableWriter {
    /// Begins a file with its header row.
    ///
    /// # Errors
    /// The folder is missing or cannot be written to.
    pub fn create<S: AsRef<str>>(path: &Path, columns: &[S]) -> Result<Self, TableError> {
        let name = path.display().to_string();
        let failed = |source| TableError::Io { tried: "write", file: name.clone(), source };
        let file = AtomicFile::create(path).map_err(failed)?;
        let zipped = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("gz"));
        let sink = if zipped {
            Sink::Zipped(BufWriter::new(GzEncoder::new(file, flate2::Compression::default())))
        } else {
            Sink::Plain(file)
        };
        // Quotes what would read as a comment.
        let csv = csv::WriterBuilder::new().comment(Some(b'#')).from_writer(sink);
        let mut table = Self { file: name.clone(), csv, cell: String::new() };
        for column in columns {
            table.text(column.as_ref())?;
        }
        table.end_row()?;
        Ok(table)
    }

    /// Appends a cell of text.
    ///
    /// # Errors
    /// The disk is full.
    pub fn text(&mut self, text: &str) -> Result<(), TableError> {
        self.csv.write_field(text).map_err(|error| self.failed(error))
    }

    /// Appends a cell with a number, in the fewest digits that read back as the same number; an empty one for what is not finite.
    ///
    /// # Errors
    /// The disk is full.
    pub fn number(&mut self, number: f64) -> Result<(), TableError> {
        use std::fmt::Write;
        self.cell.clear();
        // Writing to a string cannot fail; what is no number is no value.
        if number.is_finite() {
            let _ = write!(self.cell, "{number}");
        }
        self.csv.write_field(&self.cell).map_err(|error| self.failed(error))
    }

    /// Appends `N` cells with numbers; empty ones where there is no value.
    ///
    /// # Errors
    /// The disk is full.
    pub fn vector<const N: usize>(&mut self, vector: Option<[f64; N]>) -> Result<(), TableError> {
        for index in 0..N {
            match vector {
                Some(vector) => self.number(vector[index])?,
                None => self.text("")?,
            }
        }
        Ok(())
    }

    /// Ends the row.
    ///
    /// # Errors
    /// The disk is full, or the row has another number of cells than the header.
    pub fn end_row(&mut self) -> Result<(), TableError> {
        self.csv.write_record(None::<&[u8]>).map_err(|error| self.failed(error))
    }

    /// Gives the file its name.
    ///
    /// # Errors
    /// The disk is full; nothing is left behind.
    pub fn finish(self) -> Result<(), TableError> {
        let Self { file, csv, .. } = self;
        let done = csv.into_inner().map_err(|error| error.into_error()).and_then(|sink| match sink {
            Sink::Plain(file) => file.commit(),
            Sink::Zipped(zip) => zip.into_inner().map_err(|error| error.into_error())?.finish()?.commit(),
        });
        done.map_err(|source| TableError::Io { tried: "write", file, source })
    }

    fn failed(&self, error: csv::Error) -> TableError {
        TableError::Io { tried: "write", file: self.file.clone(), source: io::Error::from(error) }
    }
}

impl Write for Sink {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self {
            Self::Plain(file) => file.write(bytes),
            Self::Zipped(zip) => zip.write(bytes),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        match self {
            Self::Plain(file) => file.flush(),
            Self::Zipped(zip) => zip.flush(),
        }
    }
}
