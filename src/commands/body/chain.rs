//! `posed body solve` of a custom skeleton: a tree of hinges, its mounting found from the movement alone.

use posed_fusion::chain::{self, ChainSegment, Epoch, Solved};
use posed_geometry::orientation_to_wxyz;
use posed_recording::animation;
use posed_recording::table::{Imu, TableError, TableWriter};
use posed_stage::{Body, JointKind, Mounting, Stage};

use super::{Error, Solve, epochs, one_each, places, print, print_json};

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
    angular_velocity_residual_rad_s: f64,
    excitation: f64,
}

pub(super) fn solve(args: &Solve, stage: &Stage, body: &Body, imu: &Imu) -> Result<(), Error> {
    if animation::Format::of(&args.output).is_some() {
        return Err(Error::Usage("a chain has no lengths to animate: write a table, `-o angles.csv`".into()));
    }
    if args.assign {
        return Err(Error::Usage(
            "--assign knows the movements of people: the sensors of a chain are named".into(),
        ));
    }
    let segments = hinges(body)?;
    let names: Vec<&str> = segments.iter().map(|segment| segment.name.as_str()).collect();
    let places = places(stage, imu, &names);
    one_each(imu, &places, &names, true)?;
    let epochs: Vec<Epoch> = epochs(imu, &places, segments.len())
        .into_iter()
        .map(|(t_s, samples)| Epoch { t_s, samples })
        .collect();
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
                angular_velocity_residual_rad_s: axes.angular_velocity_residual_rad_s,
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
        text += &format!(
            "{}: rates agree within {:.2} rad/s\n",
            joint.name, joint.angular_velocity_residual_rad_s
        );
    }
    print(&text)
}

/// The stage's custom skeleton, which must be a tree of hinges.
fn hinges(body: &Body) -> Result<Vec<ChainSegment>, Error> {
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

fn write(args: &Solve, segments: &[ChainSegment], solved: &Solved) -> Result<(), TableError> {
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
