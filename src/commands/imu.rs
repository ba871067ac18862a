//! `posed imu calibrate REC.csv -o IMU.json`: intrinsics of one IMU.

use std::path::PathBuf;

use nalgebra::Vector3;
use posed_fusion::ahrs::ImuSample;
use posed_fusion::intrinsics::{Intrinsics, calibrate};
use posed_recording::AtomicFile;
use posed_stage::output::Inertial;

use super::{Error, imus, print, print_json};

/// What to do with an IMU.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  posed imu calibrate rests.csv -o imu-0123.json")]
pub(crate) struct Args {
    #[command(subcommand)]
    action: Action,
}

#[derive(clap::Subcommand)]
enum Action {
    /// Finds gyro bias, accelerometer bias and scale, and the magnetometer's ellipsoid.
    Calibrate(Calibrate),
}

/// What to calibrate.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  posed imu calibrate rests.csv -o imu-0123.json\n\n\
    Lay the unit on each of its six sides and on at least three edges, two seconds each, and turn it slowly \
    through all directions in between. One file per unit: name it after its serial number, or give that as --serial, \
    and put it into the folder `imus` beside a stage file: the stage then corrects the unit by it.")]
struct Calibrate {
    /// Samples of one unit, `.csv` or `.csv.gz`, or a recording of a stage, `.mcap`.
    recording: PathBuf,
    /// Where the intrinsics go.
    #[arg(short, long, value_name = "IMU.json")]
    output: PathBuf,
    /// The sensor of the file, where there are several.
    #[arg(long)]
    sensor: Option<String>,
    /// Serial number of the unit, where the file's name is not that.
    #[arg(long)]
    serial: Option<String>,
    /// Samples per second, for a file without a column `t`.
    #[arg(long, value_name = "HZ")]
    rate_hz: Option<f64>,
    /// Print the intrinsics as one JSON object.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: Args) -> Result<(), Error> {
    match args.action {
        Action::Calibrate(args) => run_calibrate(&args),
    }
}

fn run_calibrate(args: &Calibrate) -> Result<(), Error> {
    let (_, imu) = imus::read(&args.recording, args.rate_hz, Inertial::uncorrected)?;
    let index = match (&args.sensor, imu.sensors.len()) {
        (Some(name), _) => imu.sensors.iter().position(|sensor| sensor == name).ok_or_else(|| {
            Error::Failed(format!("no sensor `{name}` in the file; it has {}", imu.sensors.join(", ")))
        })?,
        (None, 0 | 1) => 0,
        (None, _) => {
            return Err(Error::Usage(format!("give --sensor: one of {}", imu.sensors.join(", "))));
        }
    };
    let rows: Vec<_> = imu.rows.iter().filter(|row| row.sensor == index).collect();
    let dt_s = match rows.as_slice() {
        [first, .., last] if last.t_s > first.t_s => (last.t_s - first.t_s) / (rows.len() - 1) as f64,
        _ => return Err(Error::failed("the file has no two samples in the order of time")),
    };
    let samples: Vec<ImuSample> = rows
        .iter()
        .filter_map(|row| {
            Some(ImuSample {
                gyro_rad_s: Vector3::from(row.gyro_rad_s?),
                accel_m_s2: Vector3::from(row.accel_m_s2?),
                mag: row.mag.map(Vector3::from),
            })
        })
        .collect();
    let mut found = calibrate(&samples, dt_s).map_err(Error::failed)?;
    found.unit.clone_from(&args.serial);
    write(args, &found)?;
    if args.json {
        return print_json(&found);
    }
    print(&format!(
        "{} directions; gyro bias to {:.3} deg/s, force to {:.3} m/s²{}\n",
        found.directions,
        found.gyro_bias_sigma_rad_s.to_degrees(),
        found.accel_residual_m_s2,
        found.mag.as_ref().map(|m| format!(", field to {:.1} %", 100.0 * m.residual)).unwrap_or_default(),
    ))
}

fn write(args: &Calibrate, found: &Intrinsics) -> Result<(), Error> {
    let mut text = serde_json::to_string_pretty(found).map_err(Error::failed)?;
    text.push('\n');
    AtomicFile::replace(&args.output, text.as_bytes())
        .map_err(|error| Error::file("write", &args.output, &error))
}
