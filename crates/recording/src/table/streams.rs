//! Streams of exercises: `t` (or a rate) and any named numeric columns, from CSV or from a recording.

use std::path::Path;

use super::recorded::RecordedStreams;
use super::{Clock, TableError, TableReader, TableWriter};

/// Named channels over time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Streams {
    /// Names of the channels.
    pub columns: Vec<String>,
    /// Times, s.
    pub t_s: Vec<f64>,
    /// Values in the unit that the column's name says, one time after the other, in the order of `columns`; `None` where one is
    /// missing.
    pub values: Vec<Option<f64>>,
}

impl Streams {
    /// Reads channels from a CSV file: `columns`, or all but `t`. `rate_hz`, above 0, is for files without a column `t`.
    ///
    /// # Errors
    /// The file cannot be read; otherwise as [`Streams::from_table`].
    pub fn read(path: &Path, columns: Option<&[String]>, rate_hz: Option<f64>) -> Result<Self, TableError> {
        Self::from_table(TableReader::open(path)?, columns, rate_hz)
    }

    /// Reads channels from CSV; see [`Streams::read`].
    ///
    /// # Errors
    /// A column is missing or there is none, there is neither a column `t` nor a rate that serves, a cell is no number.
    pub fn from_table(
        mut table: TableReader,
        columns: Option<&[String]>,
        rate_hz: Option<f64>,
    ) -> Result<Self, TableError> {
        let clock = Clock::new(&table, rate_hz)?;
        let names: Vec<String> = match columns {
            Some(columns) => columns.to_vec(),
            None => table.columns().iter().filter(|name| *name != "t").cloned().collect(),
        };
        let mut indices = Vec::with_capacity(names.len());
        for name in &names {
            indices.push(table.require([name.as_str()])?[0]);
        }
        if indices.is_empty() {
            return Err(table.header_error("at least one column beside `t`", &table.columns_text()));
        }
        let mut streams = Self { columns: names, ..Self::default() };
        while table.next_row()? {
            streams.t_s.push(clock.t_s(&table, streams.t_s.len())?);
            for column in &indices {
                streams.values.push(table.number(*column)?);
            }
        }
        Ok(streams)
    }

    /// Reads what the live stage sees, of every frame of a recording: the columns of [`RecordedStreams::columns`], of all bodies or of
    /// one by its name.
    ///
    /// # Errors
    /// The recording is damaged, or is none, or has no such body.
    pub fn read_recording(path: &Path, body: Option<&str>) -> Result<Self, TableError> {
        let mut recording = RecordedStreams::open(path, body)?;
        let mut streams = Self { columns: recording.columns().to_vec(), ..Self::default() };
        while let Some(t_s) = recording.next_row()? {
            streams.t_s.push(t_s);
            streams.values.extend_from_slice(recording.row());
        }
        Ok(streams)
    }

    /// Values at one time, in the order of `columns`; empty where there is no such time.
    pub fn row(&self, index: usize) -> &[Option<f64>] {
        let width = self.columns.len();
        self.values.get(index * width..(index + 1) * width).unwrap_or(&[])
    }

    /// Writes the channels, with their times in a column `t`.
    ///
    /// # Errors
    /// The file cannot be written; nothing is left behind.
    pub fn write(&self, path: &Path) -> Result<(), TableError> {
        let columns: Vec<&str> =
            std::iter::once("t").chain(self.columns.iter().map(String::as_str)).collect();
        let mut table = TableWriter::create(path, &columns)?;
        for (index, t_s) in self.t_s.iter().enumerate() {
            table.number(*t_s)?;
            for value in self.row(index) {
                table.vector(value.map(|value| [value]))?;
            }
            table.end_row()?;
        }
        table.finish()
    }
}
