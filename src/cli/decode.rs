//! `posed decode DRIVER FILE`: a capture made elsewhere, as a table of its records.
//!
//! Poses are in device axes, as measured: nothing is filtered, corrected or left out. Times are written with the
//! very digits of the capture.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use posed_drivers::flock::capture::{self, CapturedRecord, Decoded, Options};
use posed_drivers::flock::wire::{Format, QuaternionSense, Range};
use serde::Serialize;
use serde::de::{DeserializeOwned, IntoDeserializer, value};

use super::{Error, decode_recording, decode_x_imu3, decode_xbus, output, print, print_json, tell};

/// What to decode, and where to put it.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  posed decode flock-of-birds session.txt -o poses.csv\n  \
    posed decode flock-of-birds session.txt -o session.mcap\n  \
    posed decode xbus output.bin -o records.jsonl\n\n\
    A Flock's file is a two-way log (lines `TIME : (LEVEL) N. receive[COUNT] DATA`) or the device's raw bytes;\n\
    columns of the table: t,sensor,x,y,z,qw,qx,qy,qz,format,button; metres, sensor to transmitter.\n\
    An Xbus file is raw bytes; columns: t,sensor,ax..az (m/s2),gx..gz (rad/s),mx..mz,qw..qz (sensor to room).\n\
    An x-IMU3 file is a log of the unit or raw bytes; the same columns, one row per inertial message.")]
pub(crate) struct Args {
    /// The driver that understands the bytes.
    driver: Driver,
    /// The capture.
    file: PathBuf,
    /// Where to write the records, by extension: `.csv`, `.csv.gz` or `.jsonl`, or `.mcap` for a recording to
    /// replay; absent: CSV on stdout.
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    /// Record format of a capture of raw bytes: position, angles, matrix, quaternion, position-angles,
    /// position-matrix or position-quaternion; absent: found from the bytes.
    #[arg(long, value_parser = word::<Format>)]
    format: Option<Format>,
    /// Full scale of positions in inches: 36, 72 or 144; absent: what the session says, else 36.
    #[arg(long, value_name = "INCHES", value_parser = number::<Range>)]
    range_in: Option<Range>,
    /// Which rotation the quaternions describe: vendor or direct.
    #[arg(long, default_value = "vendor", value_parser = word::<QuaternionSense>)]
    quaternion_sense: QuaternionSense,
    /// Print the summary as one JSON object: records, rejected, bytes_skipped, answers, warnings.
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum Driver {
    FlockOfBirds,
    Xbus,
    #[value(name = "x-imu3")]
    XImu3,
}

/// Reads a word as the stage file does.
fn word<T: DeserializeOwned>(text: &str) -> Result<T, value::Error> {
    T::deserialize(text.into_deserializer())
}

/// Reads a number as the stage file does.
fn number<T: DeserializeOwned>(text: &str) -> Result<T, String> {
    let number: u16 = text.parse().map_err(|_| format!("`{text}` is not a whole number"))?;
    T::deserialize(number.into_deserializer()).map_err(|error: value::Error| error.to_string())
}

pub(crate) fn run(args: Args) -> Result<(), Error> {
    let file = args.output.as_deref().map(|path| Table::of(path).map(|table| (path, table))).transpose()?;
    let target = Target { file, json: args.json };
    match args.driver {
        Driver::FlockOfBirds => flock(&args, target),
        Driver::XImu3 => decode_x_imu3::run(&args.file, target),
        Driver::Xbus => decode_xbus::run(&args.file, target),
    }
}

fn flock(args: &Args, target: Target<'_>) -> Result<(), Error> {
    let file = std::fs::read(&args.file).map_err(|error| Error::file("read", &args.file, &error))?;
    let options =
        Options { format: args.format, range: args.range_in, quaternion_sense: args.quaternion_sense };
    let decoded = capture::decode(&file, options)
        .map_err(|error| Error::Failed(format!("cannot decode {}: {error}", args.file.display())))?;
    for warning in &decoded.warnings {
        tracing::warn!("{warning}");
    }
    if let Some((path, Table::Recording)) = target.file {
        decode_recording::write(path, &file, &decoded, args.quaternion_sense)?;
    } else {
        let records = &decoded.records;
        target.write(|file| csv(records, file), |file| json_lines(records, file))?;
    }
    let summary = Summary::of(&decoded);
    target.tell(&summary, &summary.sentence())
}

/// Where records and their summary go.
#[derive(Clone, Copy)]
pub(super) struct Target<'a> {
    pub(super) file: Option<(&'a Path, Table)>,
    json: bool,
}

impl Target<'_> {
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

    /// Says what there was, as was asked for.
    pub(super) fn tell(&self, summary: &impl Serialize, sentence: &str) -> Result<(), Error> {
        if self.json {
            return print_json(summary);
        }
        tell(sentence);
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
                "cannot tell the form of {path}; end it in .csv, .csv.gz, .jsonl or .mcap"
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
    pub(super) angular_rate_rad_s: Option<[f64; 3]>,
    pub(super) magnetic_field: Option<[f64; 3]>,
    pub(super) orientation_wxyz: Option<[f64; 4]>,
}

/// A table of IMUs.
pub(super) fn imu_csv(rows: impl Iterator<Item = ImuRow>, file: &mut dyn Write) -> io::Result<()> {
    let mut table = csv::Writer::from_writer(file);
    table.write_record(IMU_COLUMNS)?;
    for row in rows {
        table.write_field(row.t_s.map(|t| t.to_string()).unwrap_or_default())?;
        table.write_field(row.sensor)?;
        let vectors = [row.specific_force_m_s2, row.angular_rate_rad_s, row.magnetic_field];
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

fn csv(records: &[CapturedRecord], file: &mut dyn Write) -> io::Result<()> {
    let mut table = csv::Writer::from_writer(file);
    table.write_record(["t", "sensor", "x", "y", "z", "qw", "qx", "qy", "qz", "format", "button"])?;
    for CapturedRecord { t, address, format, record } in records {
        table.write_field(t.as_deref().unwrap_or_default())?;
        table.write_field(format!("bird-{address}"))?;
        let position = record.position_m.map(|values| values.map(|value| value.to_string()));
        for field in position.unwrap_or_default() {
            table.write_field(field)?;
        }
        let orientation = record.orientation_wxyz.map(|values| values.map(|value| value.to_string()));
        for field in orientation.unwrap_or_default() {
            table.write_field(field)?;
        }
        table.write_field(format.to_string())?;
        table.write_field(record.button.map(|button| button.to_string()).unwrap_or_default())?;
        table.write_record(None::<&[u8]>)?;
    }
    table.flush()
}

/// One record in full, but for its time.
#[derive(Serialize)]
struct Line {
    sensor: String,
    format: Format,
    button: Option<u8>,
    position_m: Option<[f64; 3]>,
    orientation_wxyz: Option<[f64; 4]>,
}

fn json_lines(records: &[CapturedRecord], file: &mut dyn Write) -> io::Result<()> {
    for CapturedRecord { t, address, format, record } in records {
        let line = Line {
            sensor: format!("bird-{address}"),
            format: *format,
            button: record.button,
            position_m: record.position_m,
            orientation_wxyz: record.orientation_wxyz,
        };
        let line = serde_json::to_string(&line)?;
        // The time goes in as text: its digits may be more than a 64-bit number gives back.
        let t = match t {
            Some(t) if serde_json::from_str::<serde_json::Number>(t).is_ok() => t.clone(),
            Some(t) => serde_json::to_string(t)?,
            None => "null".to_owned(),
        };
        writeln!(file, "{{\"t\":{t},{}", line.trim_start_matches('{'))?;
    }
    Ok(())
}

/// What was in the capture.
#[derive(Serialize)]
struct Summary<'a> {
    records: u64,
    rejected: u64,
    bytes_skipped: u64,
    answers: u64,
    warnings: &'a [String],
}

impl<'a> Summary<'a> {
    fn of(decoded: &'a Decoded) -> Self {
        let capture::Summary { records, rejected, bytes_skipped, answers } = decoded.summary;
        Self { records, rejected, bytes_skipped, answers, warnings: &decoded.warnings }
    }

    fn sentence(&self) -> String {
        let Self { records, rejected, bytes_skipped, answers, .. } = self;
        format!(
            "{records} records, {rejected} rejected pieces, {bytes_skipped} bytes skipped, {answers} answers"
        )
    }
}
