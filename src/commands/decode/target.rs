//! What is decoded is written in one of a few forms, and summed up in a sentence or an object.

use std::io::{self, Write};
use std::path::Path;

use serde::Serialize;

use super::super::{Error, notify, output, print, print_json};

/// Where records and their summary go.
#[derive(Clone, Copy)]
pub(super) struct Target<'a> {
    pub(super) file: Option<(&'a Path, Table)>,
    json: bool,
}

impl<'a> Target<'a> {
    /// The file decides by its extension on the form; a summary in JSON leaves stdout to itself.
    pub(super) fn new(file: Option<&'a Path>, json: bool) -> Result<Self, Error> {
        let file = file.map(|path| Table::of(path).map(|table| (path, table))).transpose()?;
        Ok(Self { file, json })
    }

    /// Refuses a recording, for captures that cannot become one.
    pub(super) fn check_no_recording(&self, capture: &str) -> Result<(), Error> {
        if matches!(self.file, Some((_, Table::Recording))) {
            return Err(Error::Usage(format!(
                "{capture} carries no times of arrival to record; end the output in .csv, .csv.gz or .jsonl"
            )));
        }
        Ok(())
    }

    /// Writes the records into the file; without one, and unless a summary is asked for, as a table to stdout.
    pub(super) fn write(
        &self,
        csv: impl FnOnce(&mut dyn Write) -> io::Result<()>,
        json_lines: impl FnOnce(&mut dyn Write) -> io::Result<()>,
    ) -> Result<(), Error> {
        if let Some((path, table)) = self.file {
            return output::replace(path, |file| table.write(file, csv, json_lines));
        }
        if !self.json {
            let mut text = Vec::new();
            csv(&mut text).map_err(Error::failed)?;
            print(&String::from_utf8_lossy(&text))?;
        }
        Ok(())
    }

    /// Reports what there was, as was asked for.
    pub(super) fn notify(&self, summary: &impl Serialize, sentence: &str) -> Result<(), Error> {
        if self.json {
            return print_json(summary);
        }
        notify(sentence);
        Ok(())
    }
}

/// The forms in which records are written.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Table {
    Csv,
    CsvGz,
    JsonLines,
    Recording,
}

impl Table {
    fn of(path: &Path) -> Result<Self, Error> {
        let name = path.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
        if name.ends_with(".csv") {
            Ok(Self::Csv)
        } else if name.ends_with(".csv.gz") {
            Ok(Self::CsvGz)
        } else if name.ends_with(".jsonl") {
            Ok(Self::JsonLines)
        } else if name.ends_with(".mcap") {
            Ok(Self::Recording)
        } else {
            let path = path.display();
            Err(Error::Usage(format!(
                "cannot determine the format of {path}; end it in .csv, .csv.gz, .jsonl or .mcap"
            )))
        }
    }

    /// Writes in this form, given what writes a table and what writes lines.
    fn write(
        self,
        file: &mut dyn Write,
        csv: impl FnOnce(&mut dyn Write) -> io::Result<()>,
        json_lines: impl FnOnce(&mut dyn Write) -> io::Result<()>,
    ) -> io::Result<()> {
        match self {
            Self::Csv => csv(file),
            Self::CsvGz => {
                let mut gz = flate2::write::GzEncoder::new(file, flate2::Compression::default());
                csv(&mut gz)?;
                gz.finish().map(drop)
            }
            Self::JsonLines => json_lines(file),
            Self::Recording => Err(io::Error::other("a recording holds bytes, not records")),
        }
    }
}

/// The columns of a table of IMUs.
const IMU_COLUMNS: [&str; 15] =
    ["t", "sensor", "ax", "ay", "az", "gx", "gy", "gz", "mx", "my", "mz", "qw", "qx", "qy", "qz"];

/// One row of a table of IMUs; what is absent is an empty cell.
pub(super) struct ImuRow {
    pub(super) t_s: Option<f64>,
    pub(super) sensor: String,
    pub(super) specific_force_m_s2: Option<[f64; 3]>,
    pub(super) angular_velocity_rad_s: Option<[f64; 3]>,
    pub(super) magnetic_field: Option<[f64; 3]>,
    pub(super) orientation_wxyz: Option<[f64; 4]>,
}

impl ImuRow {
    /// Whether any cell but time and sensor is full.
    pub(super) fn measures(&self) -> bool {
        self.specific_force_m_s2.is_some()
            || self.angular_velocity_rad_s.is_some()
            || self.magnetic_field.is_some()
            || self.orientation_wxyz.is_some()
    }
}

/// A table of IMUs.
pub(super) fn imu_csv(rows: impl Iterator<Item = ImuRow>, file: &mut dyn Write) -> io::Result<()> {
    let mut table = csv::Writer::from_writer(file);
    table.write_record(IMU_COLUMNS)?;
    for row in rows {
        table.write_field(row.t_s.map(|t| t.to_string()).unwrap_or_default())?;
        table.write_field(row.sensor)?;
        let vectors = [row.specific_force_m_s2, row.angular_velocity_rad_s, row.magnetic_field];
        let numbers =
            vectors.into_iter().flat_map(|vector| vector.map_or([None; 3], |vector| vector.map(Some)));
        for number in numbers.chain(row.orientation_wxyz.map_or([None; 4], |q| q.map(Some))) {
            table.write_field(number.map(|number| number.to_string()).unwrap_or_default())?;
        }
        table.write_record(None::<&[u8]>)?;
    }
    table.flush()
}

/// One line of JSON for each.
pub(super) fn lines_of<T: Serialize>(records: &[T], file: &mut dyn Write) -> io::Result<()> {
    for record in records {
        serde_json::to_writer(&mut *file, record)?;
        file.write_all(b"\n")?;
    }
    Ok(())
}
