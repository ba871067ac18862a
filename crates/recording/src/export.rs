//! Files that other programs open: messages as JSON lines, poses as CSV, everything as MCAP.

use std::io::Write;
use std::path::Path;

use nalgebra::Isometry3;

use super::ending::ReadError;
use super::header::Header;
use super::reader::{Item, Reader};
use super::scribe::Scribe;
use super::take::Take;
use super::writer::WriteError;
use crate::atomic_file::AtomicFile;
use crate::table::{PoseColumns, PoseRow, PoseWriter, Poses, TableError, Which};
use posed_geometry::{isometry, orientation_from_wxyz, orientation_to_wxyz};
use posed_stage::input::{Input, Model};
use posed_stage::{RecordingContent, Stage};

/// Frame of reference of exported poses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum Frame {
    /// z up, metres.
    #[default]
    Room,
    /// The tracker's own axes.
    Transmitter,
}

/// Writes every published message of a recording as it is (JSON), one line each, in order; returns the number of lines.
/// `progress` receives the bytes of the recording read so far.
///
/// # Errors
/// The recording cannot be read or the file cannot be written; nothing is left behind.
pub fn jsonl(recording: &Path, output: &Path, mut progress: impl FnMut(u64)) -> Result<u64, TableError> {
    let failed = |source| TableError::Recording { file: recording.display().to_string(), source };
    let write = |source| TableError::Io { tried: "write", file: output.display().to_string(), source };
    let mut take = Take::open(recording).map_err(failed)?;
    let mut file = AtomicFile::create(output).map_err(write)?;
    let mut lines = 0;
    while let Some(item) = take.next() {
        progress(take.bytes_read());
        if let Item::Message(message) = item.map_err(failed)? {
            file.write_all(&message.json).and_then(|()| file.write_all(b"\n")).map_err(write)?;
            lines += 1;
        }
    }
    file.commit().map_err(write)?;
    Ok(lines)
}

/// Why a recording cannot be written with all that follows from it.
#[derive(Debug, thiserror::Error)]
pub enum FullError {
    /// It cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The file cannot be written, or the recording is of another version.
    #[error(transparent)]
    Write(#[from] WriteError),
}

/// Writes a recording anew with every message and all channels for viewers at the full rate, made from its log; returns the
/// number of messages. A torn recording gives what it has. `progress` receives the bytes of the recording read so far.
///
/// # Errors
/// The recording cannot be read, is of another version, or the file cannot be written; nothing is left behind.
pub fn full(recording: &Path, output: &Path, mut progress: impl FnMut(u64)) -> Result<u64, FullError> {
    let mut reader = Reader::open(recording)?;
    let header = Header { content: RecordingContent::Full, ..reader.header().clone() };
    let file = AtomicFile::create(output).map_err(WriteError::from)?;
    let mut scribe = Scribe::new(file, header)?;
    let mut messages = 0;
    while let Some(item) = reader.next() {
        progress(reader.bytes_read());
        match item? {
            Item::Entry(entry) => messages += scribe.entry(&entry)?,
            Item::Transmitted { device, t, bytes } => scribe.transmitted(device, t, &bytes)?,
            // It is made anew.
            Item::Message(_) => {}
        }
    }
    let file = scribe.finish(reader.end_reason().unwrap_or("the recording breaks off here"))?;
    file.commit().map_err(WriteError::from)?;
    Ok(messages)
}

/// Writes the filtered poses of a recording as CSV; returns the number of rows. Columns: `t` (capture time, s), `sensor`, `x,y,z`
/// (m), `qw,qx,qy,qz` (sensor to `frame`) and `state`; a row for every sensor with a pose in a `sensors` message, suspect ones
/// too. For [`Frame::Transmitter`] poses are taken back from the room by where the transmitter stood at that time. `progress`
/// receives the bytes of the recording read so far.
///
/// # Errors
/// The recording cannot be read, for transmitter axes its stage file does not fit this version, or the file cannot be written;
/// nothing is left behind.
pub fn csv(
    recording: &Path,
    output: &Path,
    frame: Frame,
    mut progress: impl FnMut(u64),
) -> Result<u64, TableError> {
    let failed = |source| TableError::Recording { file: recording.display().to_string(), source };
    let mut take = Take::open(recording).map_err(failed)?;
    let mut transmitter = match frame {
        Frame::Room => None,
        Frame::Transmitter => Some(Transmitter::at_beginning(take.header()).map_err(failed)?),
    };
    let columns = PoseColumns { sensor: true, orientation: true, state: true };
    let mut writer = PoseWriter::create(output, columns)?;
    let mut rows = 0;
    // Holds the rows of one message, and the sensors' names.
    let mut poses = Poses::default();
    while let Some(item) = take.next() {
        progress(take.bytes_read());
        match item.map_err(failed)? {
            Item::Entry(entry) => {
                if let (Some(transmitter), Input::Model(model)) = (&mut transmitter, &entry.input) {
                    transmitter.swap(model);
                }
            }
            Item::Message(message) if &*message.topic == "sensors" => {
                poses.rows.clear();
                poses.append_message(&message.json, Which::All).map_err(failed)?;
                if let Some(transmitter) = &transmitter {
                    poses.rows.iter_mut().for_each(|row| transmitter.transform(row));
                }
                for row in &poses.rows {
                    writer.row(poses.name(row), row)?;
                }
                rows += poses.rows.len() as u64;
            }
            Item::Message(_) | Item::Transmitted { .. } => {}
        }
    }
    writer.finish()?;
    Ok(rows)
}

/// Where the transmitter stands, as the log goes on.
struct Transmitter {
    room_from_transmitter: Isometry3<f64>,
}

impl Transmitter {
    fn at_beginning(header: &Header) -> Result<Self, ReadError> {
        let stage = Stage::parse(&header.stage_toml)
            .map_err(|problems| ReadError::NotARecording(format!("its stage file is wrong: {problems}")))?;
        let room_from_transmitter = match stage.transmitter.pose_in_room {
            None => Isometry3::identity(),
            Some(pose) => isometry(pose.position_m, pose.orientation_wxyz).ok_or_else(|| {
                ReadError::NotARecording("its transmitter's orientation is no quaternion".to_owned())
            })?,
        };
        let mut transmitter = Self { room_from_transmitter };
        header.models.iter().for_each(|model| transmitter.swap(model));
        Ok(transmitter)
    }

    /// A model whose numbers are none changes nothing, as in the pipeline.
    fn swap(&mut self, model: &Model) {
        if let Model::Transmitter { position_m, orientation_wxyz } = model
            && let Some(placed) = isometry(*position_m, *orientation_wxyz)
        {
            self.room_from_transmitter = placed;
        }
    }

    /// From room to transmitter axes.
    fn transform(&self, row: &mut PoseRow) {
        let transmitter_from_room = self.room_from_transmitter.inverse();
        row.position_m =
            row.position_m.map(|position| transmitter_from_room.transform_point(&position.into()).into());
        row.orientation_wxyz = row.orientation_wxyz.and_then(orientation_from_wxyz).map(|room_from_sensor| {
            orientation_to_wxyz(&(transmitter_from_room.rotation * room_from_sensor))
        });
    }
}
