//! `posed body solve IMUS.csv --stage S.toml -o ANGLES.csv`: joint angles and body pose from a recording.

use std::path::PathBuf;

use nalgebra::Vector3;
use posed::fusion::ahrs::ImuSample;
use posed::fusion::chain::{self, ChainSegment, Epoch, Solved};
use posed::geometry::orientation_to_wxyz;
use posed::stage::{JointKind, Mounting, Skeleton, Stage};
use posed::table::{Imu, TableWriter};

use super::{Error, print, print_json};

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
}

/// What to solve.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  posed body solve imus.csv --stage chain.toml -o angles.csv\n\n\
    The stage's [body] names the segments; each sensor is named like its segment, or says `segment`.\n\
    A custom skeleton of hinges needs neither lengths nor magnetometers nor a calibration.")]
struct Solve {
    /// Samples of the IMUs, `.csv` or `.csv.gz`, with a column `sensor`.
    imus: PathBuf,
    /// The stage file with the body.
    #[arg(long, value_name = "S.toml")]
    stage: PathBuf,
    /// Where segments and angles go.
    #[arg(short, long, value_name = "ANGLES.csv")]
    output: PathBuf,
    /// Samples per second of each sensor, for a file without a column `t`.
    #[arg(long, value_name = "HZ")]
    rate_hz: Option<f64>,
    /// Print one JSON object: epochs, and per joint its axes and how well they show.
    #[arg(long)]
    json: bool,
}

/// The answer.
#[derive(serde::Serialize)]
struct Summary {
    epochs: usize,
    joints: Vec<JointSummary>,
}

#[derive(serde::Serialize)]
struct JointSummary {
    name: String,
    /// Unit axis in the parent's sensor.
    parent_axis: [f64; 3],
    /// The same in the segment's own sensor.
    axis: [f64; 3],
    rate_residual_rad_s: f64,
    excitation: f64,
}

pub(crate) fn run(args: Args) -> Result<(), Error> {
    match args.action {
        Action::Solve(args) => solve(&args),
    }
}

fn solve(args: &Solve) -> Result<(), Error> {
    let stage = Stage::load(&args.stage).map_err(Error::failed)?;
    let segments = hinges(&stage)?;
    let imu = Imu::read(&args.imus, args.rate_hz).map_err(Error::failed)?;
    let epochs = epochs(&imu, &places(&stage, &imu, &segments)?, segments.len());
    let solved = chain::solve(&segments, &epochs).map_err(Error::failed)?;
    write(args, &segments, &solved).map_err(Error::failed)?;

    let joints: Vec<JointSummary> = segments
        .iter()
        .zip(&solved.axes)
        .filter_map(|(segment, axes)| {
            let (_, name) = segment.hinge.as_ref()?;
            let axes = axes.as_ref()?;
            Some(JointSummary {
                name: name.clone(),
                parent_axis: axes.first.into(),
                axis: axes.second.into(),
                rate_residual_rad_s: axes.rate_residual_rad_s,
                excitation: axes.excitation,
            })
        })
        .collect();
    let summary = Summary { epochs: epochs.len(), joints };
    if args.json {
        return print_json(&summary);
    }
    let mut text = format!("{} epochs\n", summary.epochs);
    for joint in &summary.joints {
        text += &format!("{}: rates agree within {:.2} rad/s\n", joint.name, joint.rate_residual_rad_s);
    }
    print(&text)
}

/// The stage's custom skeleton, which must be a tree of hinges.
fn hinges(stage: &Stage) -> Result<Vec<ChainSegment>, Error> {
    let body = stage.body.as_ref().ok_or_else(|| Error::failed("the stage file has no [body] table"))?;
    if body.skeleton != Skeleton::Custom {
        return Err(Error::failed(
            "this build solves custom skeletons only: set skeleton = \"custom\" and list [[body.segments]]",
        ));
    }
    if body.mounting == Mounting::Given || !body.calibration.is_empty() {
        return Err(Error::failed(
            "this build finds the mounting of a hinge chain from its movement alone: set mounting = \"calibrate\" and leave \
             [[body.calibration]] out",
        ));
    }
    let mut segments: Vec<ChainSegment> = Vec::new();
    for segment in &body.segments {
        let hinge = match (&segment.parent, &segment.joint) {
            (Some(parent), Some(joint)) => {
                if segment.kind != Some(JointKind::Hinge) {
                    return Err(Error::Failed(format!("joint `{joint}`: this build solves hinges only")));
                }
                let parent = segments
                    .iter()
                    .position(|known| known.name == *parent)
                    .ok_or_else(|| Error::Failed(format!("`{parent}` is no segment above `{joint}`")))?;
                Some((parent, joint.clone()))
            }
            _ => None,
        };
        segments.push(ChainSegment { name: segment.name.clone(), hinge });
    }
    Ok(segments)
}

/// The segment of each of the file's sensors; by the stage's `[[sensor]]`, else by name.
fn places(stage: &Stage, imu: &Imu, segments: &[ChainSegment]) -> Result<Vec<Option<usize>>, Error> {
    let places: Vec<Option<usize>> = imu
        .sensors
        .iter()
        .map(|name| {
            let sensor = stage.sensors.iter().find(|sensor| sensor.name == *name);
            let place = sensor.and_then(|sensor| sensor.segment.as_ref()).unwrap_or(name);
            segments.iter().position(|segment| segment.name == *place)
        })
        .collect();
    for (index, segment) in segments.iter().enumerate() {
        let count = places.iter().filter(|place| **place == Some(index)).count();
        if count != 1 {
            return Err(Error::Failed(format!(
                "segment `{}` has {count} sensors in the file (sensors: {}); it takes one, named like the segment \
                 or with `segment` in the stage file",
                segment.name,
                imu.sensors.join(", ")
            )));
        }
    }
    Ok(places)
}

/// Rows of one time become one epoch. Times within half a millisecond are one.
fn epochs(imu: &Imu, places: &[Option<usize>], segments: usize) -> Vec<Epoch> {
    let mut order: Vec<usize> = (0..imu.rows.len()).collect();
    order.sort_by(|a, b| imu.rows[*a].t_s.total_cmp(&imu.rows[*b].t_s));
    let mut epochs: Vec<Epoch> = Vec::new();
    for row in order.into_iter().map(|index| &imu.rows[index]) {
        let Some(segment) = places[row.sensor] else { continue };
        if epochs.last().is_none_or(|epoch| row.t_s - epoch.t_s > 5e-4) {
            epochs.push(Epoch { t_s: row.t_s, samples: vec![None; segments] });
        }
        if let (Some(epoch), Some(gyro), Some(accel)) = (epochs.last_mut(), row.gyro_rad_s, row.accel_m_s2) {
            epoch.samples[segment] = Some(ImuSample {
                gyro_rad_s: Vector3::from(gyro),
                accel_m_s2: Vector3::from(accel),
                mag: row.mag.map(Vector3::from),
            });
        }
    }
    epochs
}

fn write(args: &Solve, segments: &[ChainSegment], solved: &Solved) -> Result<(), posed::table::TableError> {
    let mut columns = vec!["t".to_owned()];
    for segment in segments {
        columns.extend(["qw", "qx", "qy", "qz"].map(|part| format!("{}_{part}", segment.name)));
    }
    let joints: Vec<usize> = (0..segments.len()).filter(|index| segments[*index].hinge.is_some()).collect();
    for index in &joints {
        if let Some((_, joint)) = &segments[*index].hinge {
            columns.push(format!("{joint}_flexion_deg"));
        }
    }
    let mut table = TableWriter::create(&args.output, &columns)?;
    for pose in &solved.poses {
        table.number(pose.t_s)?;
        for q in &pose.orientations {
            table.vector(Some(orientation_to_wxyz(q)))?;
        }
        for index in &joints {
            table.number(pose.flexion_rad[*index].to_degrees())?;
        }
        table.end_row()?;
    }
    table.finish()
}
