//! Streams of exercises: `t` (or a rate) and any named numeric columns, from CSV or from a recording.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Deserialize;

use super::poses::SensorsMessage;
use super::{Clock, TableError, TableReader, TableWriter};
use crate::fusion::body::ANGLE_NAMES;
use crate::layout::{BodyLayout, joint_and_angle};
use crate::recording::{Item, ReadError, Reader};
use crate::signals;
use crate::stage::Stage;

/// Named channels over time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Streams {
    /// Names of the channels.
    pub columns: Vec<String>,
    /// Times, s.
    pub t_s: Vec<f64>,
    /// Values, one time after the other, in the order of `columns`.
    pub values: Vec<Option<f64>>,
}

impl Streams {
    /// Reads channels from a CSV file: `columns`, or all but `t`. `rate_hz` is for files without a column `t`.
    ///
    /// # Errors
    /// The file cannot be read, a column is missing, a cell is no number.
    pub fn read(path: &Path, columns: Option<&[String]>, rate_hz: Option<f64>) -> Result<Self, TableError> {
        Self::from_table(TableReader::open(path)?, columns, rate_hz)
    }

    /// Reads channels from CSV; see [`Streams::read`].
    ///
    /// # Errors
    /// A column is missing, a cell is no number.
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

    /// Reads what the live stage sees, of every frame of a recording: the columns of [`signals::columns`].
    ///
    /// # Errors
    /// The recording is damaged, or is none.
    pub fn read_recording(path: &Path) -> Result<Self, TableError> {
        let failed = |source| TableError::Recording { file: path.display().to_string(), source };
        let reader = Reader::open(path).map_err(failed)?;
        let sensors = reader.header().sensors.clone();
        let layout = Stage::parse(&reader.header().stage_toml).ok().and_then(|stage| BodyLayout::of(&stage));
        let mut columns = signals::columns(sensors.iter().map(String::as_str));
        columns.extend(layout.iter().flat_map(BodyLayout::columns));
        let angles = layout.map_or_else(Vec::new, |layout| layout.shown_angles);
        let mut streams = Self { columns, ..Self::default() };
        let mut body: Option<BodyMessage> = None;
        for item in reader {
            let Item::Message(message) = item.map_err(failed)? else { continue };
            if &*message.topic == "body" && !angles.is_empty() {
                body = Some(BodyMessage::parse(&message.json).map_err(failed)?);
            }
            if &*message.topic != "sensors" {
                continue;
            }
            let message = SensorsMessage::parse(&message.json).map_err(failed)?;
            streams.t_s.push(message.t_s);
            for name in &sensors {
                let usable =
                    |entry: &&super::poses::SensorEntry| entry.name == *name && entry.state.is_usable();
                let entry = message.sensors.iter().find(usable);
                let position_m = entry.and_then(|entry| entry.position_m);
                let orientation_wxyz = entry.and_then(|entry| entry.orientation_wxyz);
                signals::append(position_m, orientation_wxyz, &mut streams.values);
            }
            let fresh = body.as_ref().filter(|body| message.t_s - body.t_s <= signals::BODY_AGE_S);
            streams.values.extend(angles.iter().map(|angle| fresh?.angle_deg(ANGLE_NAMES[*angle])));
        }
        Ok(streams)
    }

    /// Values at one time, in the order of `columns`.
    pub fn row(&self, index: usize) -> &[Option<f64>] {
        let width = self.columns.len();
        self.values.get(index * width..(index + 1) * width).unwrap_or(&[])
    }

    /// Writes the channels.
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

/// What streams need of a `body` message.
#[derive(Deserialize)]
struct BodyMessage {
    t_s: f64,
    joints: Vec<Joint>,
}

#[derive(Deserialize)]
struct Joint {
    name: String,
    angles_deg: BTreeMap<String, Option<f64>>,
}

impl BodyMessage {
    fn parse(json: &[u8]) -> Result<Self, ReadError> {
        serde_json::from_slice(json)
            .map_err(|error| ReadError::NotARecording(format!("a `body` message cannot be read: {error}")))
    }

    /// The angle of that name, degrees.
    fn angle_deg(&self, name: &'static str) -> Option<f64> {
        let (joint, angle) = joint_and_angle(name);
        let joint = self.joints.iter().find(|known| known.name == joint)?;
        joint.angles_deg.get(angle).copied().flatten()
    }
}
