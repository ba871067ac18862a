//! `posed body solve IMUS.csv --stage S.toml -o ANGLES.csv`: joint angles and body pose from a recording; `posed body calibrate`: how
//! the sensors of a running daemon sit.

mod calibrate;
mod chain;
mod human;

use std::path::PathBuf;

use nalgebra::Vector3;
use posed_fusion::ahrs::ImuSample;
use posed_recording::table::Imu;
use posed_stage::output::Inertial;
use posed_stage::{Skeleton, Stage};

use super::{Error, imus, print, print_json};

/// What to do with a body.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  posed body solve imus.csv --stage chain.toml -o angles.csv")]
pub(crate) struct Args {
    #[command(subcommand)]
    action: Action,
}

#[derive(clap::Subcommand)]
enum Action {
    /// Solves a recording of IMUs: segment orientations and joint angles.
    Solve(Solve),
    /// Calibrates the body of a running daemon: states what to do next, and how well each sensor's mounting shows.
    Calibrate(calibrate::Calibrate),
}

/// What to solve.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  posed body solve imus.csv --stage body.toml -o angles.csv\n  \
    posed body solve imus.csv --stage body.toml -o dance.bvh\n  \
    posed body solve imus.csv --stage body.toml --assign -o angles.csv\n  \
    posed body solve imus.csv --stage body.toml --limbs euler -o angles.csv\n  \
    posed body solve take.mcap -o angles.csv\n\n\
    The stage's [body] names the segments; each sensor is named like its segment, or says `segment`.\n\
    The human skeleton needs `height_m`, and poses and movements in [[body.calibration]] or a given mounting.\n\
    A custom skeleton of hinges needs neither lengths nor magnetometers nor a calibration.")]
struct Solve {
    /// Samples of the IMUs, `.csv` or `.csv.gz`, with a column `sensor`; or a recording of a stage, `.mcap`.
    imus: PathBuf,
    /// The stage file with the body; absent: the recording's own.
    #[arg(long, value_name = "S.toml")]
    stage: Option<PathBuf>,
    /// The body of the stage, by name, where it has several.
    #[arg(long, value_name = "NAME")]
    body: Option<String>,
    /// Where segments and angles go; the human skeleton also to an animation that ends in .bvh, .trc, .glb, .vrm, .vrma, .usda, .c3d, .sto or .mot.
    #[arg(short, long, value_name = "ANGLES.csv")]
    output: PathBuf,
    /// Samples per second of each sensor, for a file without a column `t`.
    #[arg(long, value_name = "HZ")]
    rate_hz: Option<f64>,
    /// What samples of a table are of the interval since the one before; means are true in its middle, half an interval before their `t`, and so is what is
    /// written.
    #[arg(long, value_enum, default_value = "instantaneous")]
    sampling: imus::Sampled,
    /// Find also which sensor sits on which segment, from the movements in [[body.calibration]]: `segment` in the stage file specifies
    /// which are worn, not by whom; ten sensors need not say.
    #[arg(long)]
    assign: bool,
    /// `joints`: the filter of the live daemon, rotations; `euler`: the limbs of Weber et al. (2011), chains of single axes, which go astray where an
    /// arm or a leg points sideways.
    #[arg(long, value_enum, default_value = "joints")]
    limbs: Limbs,
    /// Also the angles of the joints of 23 segments that no sensor shows by itself: within the spine, neck and foot (`l5s1_flexion_deg`, `ball_r_flexion_deg`, ...).
    #[arg(long)]
    whole: bool,
    /// Print one JSON object: epochs, and how well axes and mountings show.
    #[arg(long)]
    json: bool,
}

/// Which filter follows the limbs.
#[derive(Clone, Copy, PartialEq, clap::ValueEnum)]
enum Limbs {
    Joints,
    Euler,
}

pub(crate) fn run(args: Args) -> Result<(), Error> {
    match args.action {
        Action::Solve(args) => solve(&args),
        Action::Calibrate(args) => calibrate::run(&args),
    }
}

fn solve(args: &Solve) -> Result<(), Error> {
    let (recorded, mut imu) = imus::read(&args.imus, args.rate_hz, Inertial::sample)?;
    if args.sampling == imus::Sampled::Mean {
        if recorded.is_some() {
            return Err(imus::sampling_is_known());
        }
        imus::centre(&mut imu);
    }
    let stage = match (&args.stage, recorded) {
        (Some(path), _) => Stage::load(path).map_err(Error::failed)?,
        (None, Some(stage)) => stage,
        (None, None) => return Err(Error::Usage("give --stage: a table does not know its body".into())),
    };
    let stage =
        stage.of_body(args.body.as_deref()).map_err(|reason| Error::Failed(format!("--body: {reason}")))?;
    let body = stage.bodies.first().ok_or_else(|| Error::failed("the stage file has no [body] table"))?;
    match body.skeleton {
        Skeleton::Custom if args.limbs == Limbs::Euler => {
            Err(Error::Usage("--limbs euler is of the human skeleton".into()))
        }
        Skeleton::Custom => chain::solve(args, &stage, body, &imu),
        Skeleton::Human => human::solve(args, &stage, body, &imu),
    }
}

/// Samples of all segments at one time.
type Epoch = (f64, Vec<Option<ImuSample>>);

/// The segment of each of the file's sensors; by the stage's `[[sensor]]`, else by name.
fn places(stage: &Stage, imu: &Imu, segments: &[&str]) -> Vec<Option<usize>> {
    imu.sensors
        .iter()
        .map(|name| {
            let sensor = stage.sensors.iter().find(|sensor| sensor.name == *name);
            if sensor.is_some_and(|sensor| stage.wearer_of(sensor).is_none()) {
                // Somebody else's.
                return None;
            }
            let place = sensor.and_then(|sensor| sensor.segment.as_ref()).unwrap_or(name);
            segments.iter().position(|segment| segment == place)
        })
        .collect()
}

/// Each segment has at most one sensor, or exactly one.
fn one_each(imu: &Imu, places: &[Option<usize>], segments: &[&str], all: bool) -> Result<(), Error> {
    for (index, segment) in segments.iter().enumerate() {
        let count = places.iter().filter(|place| **place == Some(index)).count();
        if count > 1 || (all && count == 0) {
            return Err(Error::Failed(format!(
                "segment `{segment}` has {count} sensors in the file (sensors: {}); it takes one, named like the segment \
                 or with `segment` in the stage file",
                imu.sensors.join(", ")
            )));
        }
    }
    Ok(())
}

/// Rows of one time become one epoch. Times within half a millisecond are one.
fn epochs(imu: &Imu, places: &[Option<usize>], segments: usize) -> Vec<Epoch> {
    let mut order: Vec<usize> = (0..imu.rows.len()).collect();
    order.sort_by(|a, b| imu.rows[*a].t_s.total_cmp(&imu.rows[*b].t_s));
    let mut epochs: Vec<Epoch> = Vec::new();
    for row in order.into_iter().map(|index| &imu.rows[index]) {
        let Some(segment) = places[row.sensor] else { continue };
        if epochs.last().is_none_or(|(t_s, _)| row.t_s - t_s > 5e-4) {
            epochs.push((row.t_s, vec![None; segments]));
        }
        if let (Some((_, samples)), Some(gyro), Some(accel)) =
            (epochs.last_mut(), row.gyro_rad_s, row.accel_m_s2)
        {
            samples[segment] = Some(ImuSample {
                gyro_rad_s: Vector3::from(gyro),
                accel_m_s2: Vector3::from(accel),
                mag: row.mag.map(Vector3::from),
            });
        }
    }
    epochs
}
