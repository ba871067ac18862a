//! Tables: the CSV files of the command line.
//!
//! What comes in: `.csv` or `.csv.gz` with a header row; extra columns are ignored, lines that start with `#` and
//! empty lines are skipped, an empty cell is no value. What goes out: typed rows, or an error that names file, line,
//! column and what was expected; and the same files again, whole or not at all. What it never does: guess.
//!
//! [`Poses`] also come from recordings.

mod elan;
mod error;
mod imu;
mod joints;
mod labelled;
mod labels;
mod poses;
mod reader;
mod recorded;
mod sequences;
mod streams;
#[cfg(test)]
mod tests;
mod training_set;
mod writer;

pub use elan::{ElanSegments, read_elan_segments, relabel, write_elan};
pub use error::TableError;
pub use imu::{Imu, ImuRow};
pub use labelled::{LabelFiles, Named, read_labelled, read_labelled_folder, read_labelled_recordings, stem};
pub use labels::{SegmentLabel, SegmentLabels};
pub use poses::{PoseColumns, PoseRow, PoseWriter, Poses, Which};
pub use reader::TableReader;
pub use recorded::RecordedStreams;
pub use sequences::{SequenceFrame, SequenceOptions, Sequences, Unit, Up};
pub use streams::Streams;
pub use training_set::TrainingSet;
pub use writer::TableWriter;

/// Index of `name` in `names`, appended if it is new: sensors keep the order of their first appearance. `last` is the
/// sensor of the row before.
fn intern(names: &mut Vec<String>, name: &str, last: usize) -> usize {
    // Frames repeat their sensors in one order: the next one is mostly right.
    let next = if last + 1 < names.len() { last + 1 } else { 0 };
    match names.get(next) {
        Some(known) if known == name => next,
        _ => names.iter().position(|known| known == name).unwrap_or_else(|| {
            names.push(name.to_owned());
            names.len() - 1
        }),
    }
}

/// Times of a table: its column `t`, or a rate.
#[derive(Clone, Copy, Debug)]
enum Clock {
    Column(usize),
    Rate(f64),
}

impl Clock {
    /// The column `t` where there is one, else `rate_hz`.
    fn new(table: &TableReader, rate_hz: Option<f64>) -> Result<Self, TableError> {
        match (table.column("t")?, rate_hz) {
            (Some(column), _) => Ok(Self::Column(column)),
            (None, Some(rate)) if rate.is_finite() && rate > 0.0 => Ok(Self::Rate(rate)),
            (None, Some(rate)) => Err(table.header_error("a rate above 0 Hz", &format!("{rate} Hz"))),
            (None, None) => Err(table.header_error("a column `t` (or --rate-hz)", &table.columns_text())),
        }
    }

    /// Time of the current row, the `count`th of its sensor.
    fn t_s(self, table: &TableReader, count: usize) -> Result<f64, TableError> {
        match self {
            Self::Column(column) => table.required_number(column),
            Self::Rate(rate) => Ok(count as f64 / rate),
        }
    }
}
