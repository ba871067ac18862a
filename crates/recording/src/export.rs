//! Files that other programs open: messages as JSON lines, poses as CSV, everything as MCAP, the body in the formats of animation and biomechanics.

use std::io::Write;
use std::path::Path;

use clap::ValueEnum;
use nalgebra::Isometry3;

use super::ending::ReadError;
use super::header::Header;
use super::reader::{Item, Reader};
use super::scribe::Scribe;
use super::take::Take;
use super::writer::WriteError;
use crate::animation::{self, BoneNames, OpensimModel};
use crate::atomic_file::AtomicFile;
use crate::movement::{self, MovementError};
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

/// Kinds of files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
#[expect(missing_docs, reason = "their names are those of the files")]
pub enum Format {
    Jsonl,
    Csv,
    Bvh,
    Trc,
    Glb,
    Vrm,
    Vrma,
    Usda,
    C3d,
    Sto,
    Mot,
    Mcap,
    Columns,
}

/// What to write of a recording: always one file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Export {
    /// As what.
    pub format: Format,
    /// Names of the bones in a BVH file, and its unit.
    pub bones: BoneNames,
    /// The model of OpenSim whose coordinates a MOT file has.
    pub model: OpensimModel,
    /// The body that is shown, by name, of a recording with several.
    pub body: Option<String>,
    /// Axes of the poses in a CSV file.
    pub frame: Frame,
}

/// Why a recording is not exported.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// What is asked for does not go together, or there is no such thing.
    #[error("{0}")]
    Unfit(String),
    /// As messages or poses.
    #[error(transparent)]
    Table(#[from] TableError),
    /// As a recording.
    #[error(transparent)]
    Anew(#[from] AnewError),
    /// As a body.
    #[error(transparent)]
    Movement(#[from] MovementError),
}

impl ExportError {
    /// Whether it was cancelled, rather than failed.
    pub fn is_cancelled(&self) -> bool {
        let read = match self {
            Self::Table(TableError::Recording { source, .. }) => source,
            Self::Anew(AnewError::Read(source)) | Self::Movement(MovementError::Read(source)) => source,
            _ => return false,
        };
        matches!(read, ReadError::Cancelled)
    }
}

impl Export {
    /// From the words of `posed export`; what is absent is as usual.
    ///
    /// # Errors
    /// There is no such word, or the options do not go together ([`ExportError::Unfit`]).
    pub fn parse(
        format: &str,
        bones: Option<&str>,
        model: Option<&str>,
        body: Option<String>,
        frame: Option<&str>,
    ) -> Result<Self, ExportError> {
        fn word<T: ValueEnum>(key: &str, text: &str) -> Result<T, ExportError> {
            T::from_str(text, false).map_err(|_| {
                let words = T::value_variants().iter().filter_map(T::to_possible_value);
                let words: Vec<_> = words.map(|word| word.get_name().to_owned()).collect();
                ExportError::Unfit(format!("{key}: give one of {}", words.join(", ")))
            })
        }
        let bones = bones.map(|text| word("bones", text)).transpose()?;
        let model = model.map(|text| word("model", text)).transpose()?;
        let frame = frame.map(|text| word("frame", text)).transpose()?;
        let export = Self {
            format: word("format", format)?,
            bones: bones.unwrap_or(BoneNames::Posed),
            model: model.unwrap_or(OpensimModel::Rajagopal),
            body,
            frame: frame.unwrap_or_default(),
        };
        export.check()?;
        Ok(export)
    }

    /// Whether the options go together.
    ///
    /// # Errors
    /// One is of another format ([`ExportError::Unfit`]).
    pub fn check(&self) -> Result<(), ExportError> {
        let Self { format, bones, model, body, frame } = self;
        let of_another = if *frame != Frame::Room && *format != Format::Csv {
            "a frame is chosen for csv; everything else is in the room's axes"
        } else if *bones != BoneNames::Posed && *format != Format::Bvh {
            "names of bones are chosen for bvh; the other formats have names of their own"
        } else if *model != OpensimModel::Rajagopal && *format != Format::Mot {
            "a model is chosen for mot"
        } else if body.is_some()
            && matches!(format, Format::Jsonl | Format::Csv | Format::Mcap | Format::Columns)
        {
            "a body is chosen for formats that show one; this one holds all of them"
        } else {
            return Ok(());
        };
        Err(ExportError::Unfit(of_another.to_owned()))
    }

    /// A name for the file beside others of the same recording, which is called `stem`: an export in another way has another.
    pub fn file_name(&self, stem: &str) -> String {
        let word =
            |value: Option<clap::builder::PossibleValue>| value.map(|value| value.get_name().to_owned());
        let how = match self.format {
            Format::Csv if self.frame != Frame::Room => word(self.frame.to_possible_value()),
            Format::Bvh if self.bones != BoneNames::Posed => word(self.bones.to_possible_value()),
            Format::Mot if self.model != OpensimModel::Rajagopal => word(self.model.to_possible_value()),
            Format::Mcap => Some("full".to_owned()),
            Format::Columns => Some("columns".to_owned()),
            _ => None,
        };
        // A body may be called anything.
        let plain = |name: &String| name.replace(|c: char| !c.is_alphanumeric() && c != '-' && c != '_', "-");
        let format = if self.format == Format::Columns { Format::Mcap } else { self.format };
        let ending = word(format.to_possible_value());
        let parts = [Some(stem.to_owned()), self.body.as_ref().map(plain), how, ending];
        parts.into_iter().flatten().collect::<Vec<_>>().join(".")
    }

    /// Writes the file; returns the number of its rows: of messages, poses, or frames of an animation. `progress` receives the bytes
    /// of the recording read so far and says whether to go on.
    ///
    /// # Errors
    /// The recording cannot be read or does not hold what is asked for, the file cannot be written, or `progress` has ended it; nothing
    /// is left behind.
    pub fn write(
        &self,
        recording: &Path,
        output: &Path,
        progress: impl FnMut(u64) -> bool,
    ) -> Result<u64, ExportError> {
        self.check()?;
        let format = match self.format {
            Format::Jsonl => return Ok(jsonl(recording, output, progress)?),
            Format::Csv => return Ok(csv(recording, output, self.frame, progress)?),
            Format::Mcap => return Ok(anew(recording, output, Anew::Full, progress)?),
            Format::Columns => return Ok(anew(recording, output, Anew::Columns, progress)?),
            Format::Bvh => animation::Format::Bvh(self.bones),
            Format::Trc => animation::Format::Trc,
            Format::Glb => animation::Format::Glb,
            Format::Vrm => animation::Format::Vrm,
            Format::Vrma => animation::Format::Vrma,
            Format::Usda => animation::Format::Usda,
            Format::C3d => animation::Format::C3d,
            Format::Sto => animation::Format::Sto,
            Format::Mot => animation::Format::Mot(self.model),
        };
        Ok(movement::animation(recording, output, format, self.body.as_deref(), progress)?)
    }
}

/// Writes every published message of a recording as it is (JSON), one line each, in order; returns the number of lines.
/// `progress` receives the bytes of the recording read so far and says whether to go on.
///
/// # Errors
/// The recording cannot be read or the file cannot be written; nothing is left behind.
pub fn jsonl(
    recording: &Path,
    output: &Path,
    mut progress: impl FnMut(u64) -> bool,
) -> Result<u64, TableError> {
    let failed = |source| TableError::Recording { file: recording.display().to_string(), source };
    let write = |source| TableError::Io { tried: "write", file: output.display().to_string(), source };
    let mut take = Take::open(recording).map_err(failed)?;
    let mut file = AtomicFile::create(output).map_err(write)?;
    let mut lines = 0;
    while let Some(item) = take.next() {
        go_on(progress(take.bytes_read())).map_err(failed)?;
        if let Item::Message(message) = item.map_err(failed)? {
            file.write_all(&message.json).and_then(|()| file.write_all(b"\n")).map_err(write)?;
            lines += 1;
        }
    }
    file.commit().map_err(write)?;
    Ok(lines)
}

/// Why a recording cannot be written anew.
#[derive(Debug, thiserror::Error)]
pub enum AnewError {
    /// It cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The file cannot be written, or the recording is of another version.
    #[error(transparent)]
    Write(#[from] WriteError),
}

/// Which recording is made of another one's log.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Anew {
    /// The one with everything; with columns where its stage file asks for them.
    Full,
    /// The one with columns.
    Columns,
}

/// Writes a recording anew, as this version makes it of the log, with its digest; returns the number of messages that follow from it. A torn recording gives
/// what it has. `progress` receives the bytes of the recording read so far and says whether to go on.
///
/// # Errors
/// The recording cannot be read, is of another version, or the file cannot be written; nothing is left behind.
fn anew(
    recording: &Path,
    output: &Path,
    which: Anew,
    mut progress: impl FnMut(u64) -> bool,
) -> Result<u64, AnewError> {
    let mut reader = Reader::open(recording)?;
    let file = AtomicFile::create(output).map_err(WriteError::from)?;
    let header = |content| Header { content, ..reader.header().clone() };
    let mut scribe = match which {
        Anew::Full => Scribe::new(file, header(RecordingContent::Full))?,
        Anew::Columns => Scribe::with_columns(file, header(RecordingContent::Log))?,
    };
    let mut messages = 0;
    while let Some(item) = reader.next() {
        go_on(progress(reader.bytes_read()))?;
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

/// Writes the filtered poses of a recording as CSV; returns the number of rows. Columns: `t` (capture time, s), of a stage with time code `timecode`, `sensor`, `x,y,z`
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
    mut progress: impl FnMut(u64) -> bool,
) -> Result<u64, TableError> {
    let failed = |source| TableError::Recording { file: recording.display().to_string(), source };
    let mut take = Take::open(recording).map_err(failed)?;
    let mut transmitter = match frame {
        Frame::Room => None,
        Frame::Transmitter => Some(Transmitter::at_beginning(take.header()).map_err(failed)?),
    };
    let stage = Stage::parse(&take.header().stage_toml).ok();
    let timecode = stage.is_some_and(|stage| stage.timecode.is_some());
    let columns = PoseColumns { sensor: true, timecode, orientation: true, state: true };
    let mut writer = PoseWriter::create(output, columns)?;
    let mut rows = 0;
    // Holds the rows of one message, and the sensors' names.
    let mut poses = Poses::default();
    while let Some(item) = take.next() {
        go_on(progress(take.bytes_read())).map_err(failed)?;
        match item.map_err(failed)? {
            Item::Entry(entry) => {
                if let (Some(transmitter), Input::Model(model)) = (&mut transmitter, &entry.input) {
                    transmitter.swap(model);
                }
            }
            Item::Message(message) if &*message.topic == "sensors" => {
                poses.rows.clear();
                let code = poses.append_message(&message.json, Which::All).map_err(failed)?;
                if let Some(transmitter) = &transmitter {
                    poses.rows.iter_mut().for_each(|row| transmitter.transform(row));
                }
                for row in &poses.rows {
                    writer.row(poses.name(row), code.as_deref(), row)?;
                }
                rows += poses.rows.len() as u64;
            }
            Item::Message(_) | Item::Transmitted { .. } => {}
        }
    }
    writer.finish()?;
    Ok(rows)
}

/// Ends what is not to go on.
pub(super) fn go_on(wanted: bool) -> Result<(), ReadError> {
    if wanted { Ok(()) } else { Err(ReadError::Cancelled) }
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
