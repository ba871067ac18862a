//! `posed orient IMU.csv -o Q.csv`: the orientation of single IMUs, causally.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use nalgebra::{UnitQuaternion, Vector3};
use posed_fusion::ahrs::{Ahrs, ImuSample, Params, Sampling};
use posed_geometry::orientation_to_wxyz;
use posed_recording::table::{ImuRow, TableWriter};
use posed_stage::output::Inertial;

use super::{Error, imus, print, print_json};

/// What to orient, and how.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  posed orient imu.csv -o q.csv\n  \
    posed orient trial.csv.gz --rate-hz 285.7142857142857 -o q.csv --json\n\n\
    Reads t (or --rate-hz), sensor, ax,ay,az (m/s²), gx,gy,gz (rad/s) and, where they are there, mx,my,mz (any unit).\n\
    Writes t,sensor,qw,qx,qy,qz: sensor to room, z up; x east and y north with a magnetometer.")]
pub(crate) struct Args {
    /// Samples of one or several IMUs, `.csv` or `.csv.gz`, or a recording of a stage, `.mcap`.
    imu: PathBuf,
    /// Where the orientations go.
    #[arg(short, long, value_name = "Q.csv")]
    output: PathBuf,
    /// Samples per second of each sensor, for a file without a column `t`.
    #[arg(long, value_name = "HZ")]
    rate_hz: Option<f64>,
    /// Leave the magnetometer out: the heading starts at 0 and drifts.
    #[arg(long)]
    no_magnetometer: bool,
    /// How far the gyro lags behind its time stamps, ms: the unit's data sheet says so. A low-pass at 95 Hz has about 2.4;
    /// a unit that integrates inside (Xsens) has 0.
    #[arg(long, default_value_t = 0.0, value_name = "MS")]
    gyro_delay_ms: f64,
    /// What a sample's angular velocity is of the interval since the one before [default: mean, as published filters take it; of a recording
    /// instantaneous, as its stage stamps them].
    #[arg(long, value_enum)]
    sampling: Option<imus::Sampled>,
    /// Print one JSON object: samples, ns_per_sample.
    #[arg(long)]
    json: bool,
}

/// The answer.
#[derive(serde::Serialize)]
struct Summary {
    /// Rows read.
    samples: usize,
    /// Time of the filter alone, per row.
    ns_per_sample: f64,
}

pub(crate) fn run(args: Args) -> Result<(), Error> {
    if !(0.0..=100.0).contains(&args.gyro_delay_ms) {
        return Err(Error::Usage(format!("--gyro-delay-ms {}: give 0 to 100", args.gyro_delay_ms)));
    }
    let (stage, imu) = imus::read(&args.imu, args.rate_hz, Inertial::sample)?;
    if imu.rows.is_empty() {
        return Err(Error::Failed(format!("{} has no samples", args.imu.display())));
    }
    let sampling = match (args.sampling, stage) {
        (Some(_), Some(_)) => {
            return Err(imus::sampling_is_known());
        }
        (Some(sampling), None) => sampling.into(),
        (None, Some(_)) => Sampling::Instantaneous,
        (None, None) => Sampling::Mean,
    };
    let params = Params { gyro_delay_s: 1e-3 * args.gyro_delay_ms, sampling, ..Params::default() };
    let first_dt_s = args.rate_hz.map_or(0.01, |rate| 1.0 / rate);
    let mut sensors = vec![Oriented::new(params, first_dt_s, !args.no_magnetometer); imu.sensors.len()];
    let mut orientations = Vec::with_capacity(imu.rows.len());
    let time = Stopwatch::start();
    for row in &imu.rows {
        let oriented = sensors[row.sensor].push(row).ok_or_else(|| {
            let name = &imu.sensors[row.sensor];
            Error::Failed(format!("the time of sensor `{name}` does not rise at t = {} s", row.t_s))
        })?;
        orientations.push(oriented);
    }
    let summary = Summary {
        samples: imu.rows.len(),
        ns_per_sample: time.elapsed().as_nanos() as f64 / imu.rows.len() as f64,
    };

    let mut table =
        TableWriter::create(&args.output, &["t", "sensor", "qw", "qx", "qy", "qz"]).map_err(Error::failed)?;
    for (row, q) in imu.rows.iter().zip(&orientations) {
        table.number(row.t_s).map_err(Error::failed)?;
        table.text(&imu.sensors[row.sensor]).map_err(Error::failed)?;
        table.vector(q.as_ref().map(orientation_to_wxyz)).map_err(Error::failed)?;
        table.end_row().map_err(Error::failed)?;
    }
    table.finish().map_err(Error::failed)?;
    if args.json {
        print_json(&summary)
    } else {
        print(&format!("{} samples, {:.0} ns each\n", summary.samples, summary.ns_per_sample))
    }
}

/// One sensor of the file.
#[derive(Clone)]
struct Oriented {
    filter: Ahrs,
    first_dt_s: f64,
    magnetometer: bool,
    last_t_s: Option<f64>,
    started: bool,
}

impl Oriented {
    fn new(params: Params, first_dt_s: f64, magnetometer: bool) -> Self {
        Self { filter: Ahrs::new(params), first_dt_s, magnetometer, last_t_s: None, started: false }
    }

    /// Orientation after a row, none before the first sample; `None` outside where the time does not rise.
    fn push(&mut self, row: &ImuRow) -> Option<Option<UnitQuaternion<f64>>> {
        let dt_s = self.last_t_s.map_or(self.first_dt_s, |last| row.t_s - last);
        if dt_s.is_nan() || dt_s <= 0.0 {
            return None;
        }
        self.last_t_s = Some(row.t_s);
        if let (Some(gyro), Some(accel)) = (row.gyro_rad_s, row.accel_m_s2) {
            self.started = true;
            let sample = ImuSample {
                gyro_rad_s: Vector3::from(gyro),
                accel_m_s2: Vector3::from(accel),
                mag: row.mag.filter(|_| self.magnetometer).map(Vector3::from),
            };
            return Some(Some(self.filter.push(&sample, dt_s)));
        }
        self.filter.coast(dt_s);
        Some(self.started.then(|| self.filter.orientation()))
    }
}

/// Measures how long the filter took; nothing else here may ask for the time.
struct Stopwatch(Instant);

impl Stopwatch {
    #[expect(clippy::disallowed_methods, reason = "the cost of the filter is part of the answer")]
    fn start() -> Self {
        Self(Instant::now())
    }

    fn elapsed(&self) -> Duration {
        self.0.elapsed()
    }
}
