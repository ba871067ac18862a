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
    let table = args.output.as_deref().map(Table::of).transpose()?;
    match args.driver {
        Driver::FlockOfBirds => flock(&args, table),
        Driver::XImu3 => decode_x_imu3::run(&args.file, args.output.as_deref(), table, args.json),
        Driver::Xbus => decode_xbus::run(&args.file, args.output.as_deref(), table, args.json),
    }
}

fn flock(args: &Args, table: Option<Table>) -> Result<(), Error> {
    let file = std::fs::read(&args.file).map_err(|error| Error::file("read", &args.file, &error))?;
    let options =
        Options { format: args.format, range: args.range_in, quaternion_sense: args.quaternion_sense };
    let decoded = capture::decode(&file, options)
        .map_err(|error| Error::Failed(format!("cannot decode {}: {error}", args.file.display())))?;
    for warning in &decoded.warnings {
        tracing::warn!("{warning}");
    }
    match (&args.output, table) {
        (Some(path), Some(Table::Recording)) => {
            decode_recording::write(path, &file, &decoded, args.quaternion_sense)?;
        }
        (Some(path), Some(table)) => output::replace(path, |file| {
            table.write(file, |file| csv(&decoded.records, file), |file| json_lines(&decoded.records, file))
        })?,
        _ if !args.json => {
            let mut text = Vec::new();
            csv(&decoded.records, &mut text).map_err(Error::failed)?;
            print(&String::from_utf8_lossy(&text))?;
        }
        _ => {}
    }
    let summary = Summary::of(&decoded);
    if args.json {
        return print_json(&summary);
    }
    tell(&summary.sentence());
    Ok(())
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
    pub(super) fn write(
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
