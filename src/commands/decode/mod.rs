//! `posed decode DRIVER FILE`: a capture made elsewhere, as a table of its records.
//!
//! Poses are in device axes, as measured: nothing is filtered, corrected or left out. Times are written with the
//! very digits of the capture.

mod flock;
mod recording;
mod target;
mod x_imu3;
mod xbus;

use std::path::PathBuf;

use posed_drivers::flock::capture::Options;
use posed_drivers::flock::wire::{Format, QuaternionSense, Range};
use serde::de::{DeserializeOwned, IntoDeserializer, value};

use self::target::Target;
use super::Error;

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
    let target = Target::new(args.output.as_deref(), args.json)?;
    let options =
        Options { format: args.format, range: args.range_in, quaternion_sense: args.quaternion_sense };
    match args.driver {
        Driver::FlockOfBirds => flock::run(&args.file, options, target),
        Driver::XImu3 => x_imu3::run(&args.file, target),
        Driver::Xbus => xbus::run(&args.file, target),
    }
}
