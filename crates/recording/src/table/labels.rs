//! Segment labels: `frame,t,label,confidence`, a row per frame.

use std::path::Path;

use super::{TableError, TableReader, TableWriter};

/// What the frames of a sequence show.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SegmentLabels {
    /// One per frame.
    pub rows: Vec<SegmentLabel>,
}

/// What one frame shows.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SegmentLabel {
    /// Time, s; `None` where a person's file has none.
    pub t_s: Option<f64>,
    /// The label; `None` where nobody knows.
    pub label: Option<String>,
    /// Probability that the label is right, 0 to 1, as who labelled estimates it; `None` where nobody says.
    pub confidence: Option<f64>,
}

impl SegmentLabels {
    /// Reads a CSV file with a column `label`; `frame`, if there, must count from 0.
    ///
    /// # Errors
    /// The file cannot be read, or a cell is not what it should be.
    pub fn read(path: &Path) -> Result<Self, TableError> {
        let mut table = TableReader::open(path)?;
        let [label] = table.require(["label"])?;
        let columns = [table.column("frame")?, table.column("t")?, table.column("confidence")?];
        let mut labels = Self::default();
        while table.next_row()? {
            let number = |column: Option<usize>| match column {
                Some(column) => table.number(column),
                None => Ok(None),
            };
            if let (Some(column), Some(frame)) = (columns[0], number(columns[0])?)
                && frame != labels.rows.len() as f64
            {
                return Err(table.cell_error(column, &format!("frame {}", labels.rows.len())));
            }
            let text = table.text(label);
            labels.rows.push(SegmentLabel {
                t_s: number(columns[1])?,
                label: (!text.is_empty()).then(|| text.to_owned()),
                confidence: number(columns[2])?,
            });
        }
        Ok(labels)
    }

    /// Writes the file; confidences to four decimals.
    ///
    /// # Errors
    /// The file cannot be written; nothing is left behind.
    pub fn write(&self, path: &Path) -> Result<(), TableError> {
        let mut table = TableWriter::create(path, &["frame", "t", "label", "confidence"])?;
        for (frame, row) in self.rows.iter().enumerate() {
            table.number(frame as f64)?;
            table.vector(row.t_s.map(|t_s| [t_s]))?;
            table.text(row.label.as_deref().unwrap_or(""))?;
            // Finer digits say nothing.
            table.vector(row.confidence.map(|confidence| [(confidence * 1e4).round() / 1e4]))?;
            table.end_row()?;
        }
        table.finish()
    }
}
