//! Poses: `t`, `sensor`, `x,y,z`, `qw,qx,qy,qz`, from CSV or from a recording.

use std::path::Path;

use posed_motion::fault_map::Frames;
use serde::Deserialize;

use super::{TableError, TableReader, TableWriter, intern};
use crate::{Item, ReadError, Take, is_recording};
use posed_stage::output::SensorState;

/// Poses of one or several sensors, in the order of the file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Poses {
    /// Names, in the order of first appearance; a file without a column `sensor` has one sensor without a name.
    pub sensors: Vec<String>,
    /// The rows.
    pub rows: Vec<PoseRow>,
}

/// One sensor at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseRow {
    /// Time, s; of a recording, capture time since the stage's epoch.
    pub t_s: f64,
    /// Index in [`Poses::sensors`].
    pub sensor: usize,
    /// Position in the file's frame (the room unless said otherwise), m; `None` where there is none.
    pub position_m: Option<[f64; 3]>,
    /// Sensor to the file's frame, unit quaternion, scalar first; `None` where there is none.
    pub orientation_wxyz: Option<[f64; 4]>,
    /// How far to trust it; `None` unless the row is from a recording.
    pub state: Option<SensorState>,
}

/// Which poses of a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Which {
    /// Those that may be used as good: `ok`, `repaired`, `extrapolated`.
    Usable,
    /// Every one that was published, coasting and suspect ones too.
    All,
}

/// How far the norm of a quaternion in a file may be from one: more than rounding is another quantity.
const NORM_TOLERANCE: f64 = 0.01;

impl Poses {
    /// Reads poses from a CSV file, or the usable ones of a recording (`.mcap`).
    ///
    /// # Errors
    /// The file cannot be read; a cell is not what it should be.
    pub fn read(path: &Path) -> Result<Self, TableError> {
        if is_recording(path) {
            Self::read_recording(path, Which::Usable)
        } else {
            Self::from_table(TableReader::open(path)?)
        }
    }

    /// Reads poses from CSV. Quaternions whose norm is within 1 % of one are normalised; a column `state` is not read.
    ///
    /// # Errors
    /// A column is missing; a cell is not what it should be, or a quaternion is farther from a unit one.
    pub fn from_table(mut table: TableReader) -> Result<Self, TableError> {
        let [t, x, y, z] = table.require(["t", "x", "y", "z"])?;
        let quaternion = table.all_or_none(["qw", "qx", "qy", "qz"])?;
        let names = table.column("sensor")?;
        let mut poses = Self::default();
        while table.next_row()? {
            let name = names.map_or("", |column| table.text(column));
            if let (Some(column), "") = (names, name) {
                return Err(table.cell_error(column, "the name of a sensor"));
            }
            let orientation_wxyz =
                match quaternion {
                    None => None,
                    Some(columns) => match table.vector(columns)? {
                        None => None,
                        Some(wxyz) => Some(unit(wxyz).ok_or_else(|| {
                            table.cell_error(columns[0], "a unit quaternion in qw,qx,qy,qz")
                        })?),
                    },
                };
            let sensor = poses.intern(name);
            poses.rows.push(PoseRow {
                t_s: table.required_number(t)?,
                sensor,
                position_m: table.vector([x, y, z])?,
                orientation_wxyz,
                state: None,
            });
        }
        Ok(poses)
    }

    /// Reads the filtered poses (in the room) of a recording's `sensors` messages. A torn recording gives what it has.
    ///
    /// # Errors
    /// The recording is damaged, or is none.
    pub fn read_recording(path: &Path, which: Which) -> Result<Self, TableError> {
        let failed = |source| TableError::Recording { file: path.display().to_string(), source };
        let mut poses = Self::default();
        for item in Take::open(path).map_err(failed)? {
            let Item::Message(message) = item.map_err(failed)? else { continue };
            if &*message.topic == "sensors" {
                poses.append_message(&message.json, which).map_err(failed)?;
            }
        }
        Ok(poses)
    }

    /// Appends the rows of one `sensors` message; its time code, where it has one.
    pub(crate) fn append_message(&mut self, json: &[u8], which: Which) -> Result<Option<String>, ReadError> {
        let message = SensorsMessage::parse(json)?;
        for sensor in message.sensors {
            let usable = sensor.state.is_usable();
            let posed = sensor.position_m.is_some() || sensor.orientation_wxyz.is_some();
            if posed && (usable || which == Which::All) {
                let index = self.intern(&sensor.name);
                self.rows.push(PoseRow {
                    t_s: message.t_s,
                    sensor: index,
                    position_m: sensor.position_m,
                    orientation_wxyz: sensor.orientation_wxyz,
                    state: Some(sensor.state),
                });
            }
        }
        Ok(message.timecode)
    }

    /// Writes the poses; a column `sensor` where sensors have names, quaternions and `state` where there are any.
    ///
    /// # Errors
    /// The file cannot be written; nothing is left behind.
    pub fn write(&self, path: &Path) -> Result<(), TableError> {
        let columns = PoseColumns {
            timecode: false,
            sensor: self.sensors.iter().any(|name| !name.is_empty()),
            orientation: self.rows.iter().any(|row| row.orientation_wxyz.is_some()),
            state: self.rows.iter().any(|row| row.state.is_some()),
        };
        let mut writer = PoseWriter::create(path, columns)?;
        for row in &self.rows {
            writer.row(self.name(row), None, row)?;
        }
        writer.finish()
    }

    /// Sorts poses into frames, in the file's own axes: rows of equal time that follow each other, a second row of the
    /// same sensor beginning a new one. NaN where a sensor has no position, or no orientation while others have.
    ///
    /// # Panics
    /// A row names a sensor that is not in `sensors`.
    pub fn frames(&self) -> Frames {
        let sensors = self.sensors.len();
        let is_turned = self.rows.iter().any(|row| row.orientation_wxyz.is_some());
        let mut frames = Frames { sensors: self.sensors.clone(), ..Frames::default() };
        let mut seen = vec![false; self.sensors.len()];
        for row in &self.rows {
            let new = frames.t_s.last().is_none_or(|last| *last != row.t_s) || seen[row.sensor];
            if new {
                frames.t_s.push(row.t_s);
                frames.positions_m.resize(frames.positions_m.len() + 3 * sensors, f64::NAN);
                if is_turned {
                    frames.orientations_wxyz.resize(frames.orientations_wxyz.len() + 4 * sensors, f64::NAN);
                }
                seen.fill(false);
            }
            seen[row.sensor] = true;
            if let Some(position) = row.position_m {
                let start = frames.positions_m.len() - 3 * (sensors - row.sensor);
                frames.positions_m[start..start + 3].copy_from_slice(&position);
            }
            if let Some(orientation) = row.orientation_wxyz {
                let start = frames.orientations_wxyz.len() - 4 * (sensors - row.sensor);
                frames.orientations_wxyz[start..start + 4].copy_from_slice(&orientation);
            }
        }
        frames
    }

    /// Name of a row's sensor; empty where it has none.
    pub fn name(&self, row: &PoseRow) -> &str {
        self.sensors.get(row.sensor).map_or("", String::as_str)
    }

    fn intern(&mut self, name: &str) -> usize {
        let last = self.rows.last().map_or(0, |row| row.sensor);
        intern(&mut self.sensors, name, last)
    }
}

/// Columns of a file of poses that are not always there.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PoseColumns {
    /// `sensor`.
    pub sensor: bool,
    /// `timecode`.
    pub timecode: bool,
    /// `qw,qx,qy,qz`.
    pub orientation: bool,
    /// `state`.
    pub state: bool,
}

/// Writes poses row by row.
pub struct PoseWriter {
    table: TableWriter,
    columns: PoseColumns,
}

impl PoseWriter {
    /// Begins a file.
    ///
    /// # Errors
    /// The folder is missing or cannot be written to.
    pub fn create(path: &Path, columns: PoseColumns) -> Result<Self, TableError> {
        let mut names = vec!["t"];
        names.extend(columns.timecode.then_some("timecode"));
        names.extend(columns.sensor.then_some("sensor"));
        names.extend(["x", "y", "z"]);
        names.extend(["qw", "qx", "qy", "qz"].iter().filter(|_| columns.orientation));
        names.extend(columns.state.then_some("state"));
        Ok(Self { table: TableWriter::create(path, &names)?, columns })
    }

    /// Appends a row of the sensor called `name`, at a time code that may not be known; columns that the file does not have are left out, what is `None` is an empty
    /// cell.
    ///
    /// # Errors
    /// The disk is full.
    pub fn row(&mut self, name: &str, timecode: Option<&str>, row: &PoseRow) -> Result<(), TableError> {
        let Self { table, columns } = self;
        table.number(row.t_s)?;
        if columns.timecode {
            table.text(timecode.unwrap_or_default())?;
        }
        if columns.sensor {
            table.text(name)?;
        }
        table.vector(row.position_m)?;
        if columns.orientation {
            table.vector(row.orientation_wxyz)?;
        }
        if columns.state {
            table.text(row.state.map_or("", state_name))?;
        }
        table.end_row()
    }

    /// Gives the file its name.
    ///
    /// # Errors
    /// The disk is full; nothing is left behind.
    pub fn finish(self) -> Result<(), TableError> {
        self.table.finish()
    }
}

/// A state as messages spell it.
fn state_name(state: SensorState) -> &'static str {
    match state {
        SensorState::Ok => "ok",
        SensorState::Suspect => "suspect",
        SensorState::Missing => "missing",
        SensorState::Late => "late",
        SensorState::Stuck => "stuck",
        SensorState::Repaired => "repaired",
        SensorState::Extrapolated => "extrapolated",
    }
}

/// A quaternion of length one; `None` where it is none. Rounded ones keep their digits.
fn unit(wxyz: [f64; 4]) -> Option<[f64; 4]> {
    let norm = wxyz.iter().map(|value| value * value).sum::<f64>().sqrt();
    match (norm - 1.0).abs() {
        off if off <= 1e-6 => Some(wxyz),
        off if off <= NORM_TOLERANCE => Some(wxyz.map(|value| value / norm)),
        _ => None,
    }
}

/// What a table needs of a `sensors` message.
#[derive(Deserialize)]
pub(super) struct SensorsMessage {
    pub(super) t_s: f64,
    #[serde(default)]
    timecode: Option<String>,
    pub(super) sensors: Vec<SensorEntry>,
}

#[derive(Deserialize)]
pub(super) struct SensorEntry {
    pub(super) name: String,
    pub(super) state: SensorState,
    pub(super) position_m: Option<[f64; 3]>,
    pub(super) orientation_wxyz: Option<[f64; 4]>,
    #[serde(default)]
    pub(super) measured: Option<MeasuredEntry>,
}

/// What streams need of a sensor's raw record.
#[derive(Deserialize)]
pub(super) struct MeasuredEntry {
    #[serde(default)]
    pub(super) specific_force_m_s2: Option<[f64; 3]>,
    #[serde(default)]
    pub(super) angular_velocity_rad_s: Option<[f64; 3]>,
}

impl SensorsMessage {
    pub(super) fn parse(json: &[u8]) -> Result<Self, ReadError> {
        serde_json::from_slice(json)
            .map_err(|error| ReadError::NotARecording(format!("a `sensors` message cannot be read: {error}")))
    }
}
