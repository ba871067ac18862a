//! `posed body solve` of a custom skeleton: a tree of hinges, its mounting found from the movement alone.

use posed_fusion::chain::{self, ChainSegment, Epoch, GOOD_DEG, LOOSE_DEG, Solved};
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
    /// What is left out of the table, and why.
    warnings: Vec<String>,
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
    /// As in the live calibration's answer: how well the axis is known, degrees.
    quality_deg: f64,
    /// How far its two sensors play against each other, root mean square, degrees.
    play_deg: f64,
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
    let joints: Vec<JointSummary> = segments
        .iter()
        .enumerate()
        .filter_map(|(at, segment)| {
            let (_, name) = segment.hinge.as_ref()?;
            let axes = solved.axes[at].as_ref()?;
            Some(JointSummary {
                name: name.clone(),
                parent_axis: axes.first.into(),
                axis: axes.second.into(),
                angular_velocity_residual_rad_s: axes.angular_velocity_residual_rad_s,
                excitation: axes.excitation,
                quality_deg: solved.quality_deg[at]?,
                play_deg: solved.play_deg[at]?,
            })
        })
        .collect();
    let warnings: Vec<String> = joints.iter().filter_map(unknown).collect();
    if !joints.is_empty() && warnings.len() == joints.len() {
        return Err(Error::Failed(warnings.join("\n")));
    }
    let is_unknown = |joint: &str| joints.iter().any(|of| of.name == joint && unknown(of).is_some());
    write(args, &segments, &solved, is_unknown).map_err(Error::failed)?;
    let summary = Summary { epochs: epochs.len(), joints, warnings };
    if args.json {
        return print_json(&summary);
    }
    let mut text = format!("{} epochs\n", summary.epochs);
    for joint in &summary.joints {
        text += &format!(
            "{}: axis known to {:.1} degrees, sensors play by {:.1} degrees, rates agree within {:.2} rad/s\n",
            joint.name, joint.quality_deg, joint.play_deg, joint.angular_velocity_residual_rad_s
        );
    }
    for warning in &summary.warnings {
        text += &format!("warning: {warning}\n");
    }
    print(&text)
}

/// Why nothing behind a joint is written, where it is not.
fn unknown(joint: &JointSummary) -> Option<String> {
    let JointSummary { name, quality_deg, play_deg, .. } = joint;
    if *quality_deg > GOOD_DEG {
        return Some(format!(
            "joint `{name}`: its axis is known to {quality_deg:.0} degrees only, and its angle could be anything: record a minute in which \
             it bends while the whole chain turns, so that the axis does not stay level (limit {GOOD_DEG:.0} degrees)"
        ));
    }
    (*play_deg > LOOSE_DEG).then(|| {
        format!(
            "joint `{name}`: its two sensors turn against each other by {play_deg:.0} degrees about other axes than one (limit \
             {LOOSE_DEG:.0}): it is no hinge, or they sit on other segments than the stage file says"
        )
    })
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

/// Writes a row per epoch; cells of what is not known are empty: the angle of a hinge whose axis does not show or that is none, and how segments behind it
/// are turned.
fn write(
    args: &Solve,
    segments: &[ChainSegment],
    solved: &Solved,
    is_unknown: impl Fn(&str) -> bool,
) -> Result<(), TableError> {
    let mut columns = vec!["t".to_owned()];
    for segment in segments {
        columns.extend(["qw", "qx", "qy", "qz"].map(|part| format!("{}_{part}", segment.name)));
    }
    for (_, joint) in segments.iter().filter_map(|segment| segment.hinge.as_ref()) {
        columns.extend(["flexion_deg", "flexion_sigma_deg"].map(|part| format!("{joint}_{part}")));
    }
    let good: Vec<bool> = segments
        .iter()
        .map(|segment| segment.hinge.as_ref().is_none_or(|(_, joint)| !is_unknown(joint)))
        .collect();
    let mut known: Vec<bool> = Vec::with_capacity(segments.len());
    for (segment, good) in segments.iter().zip(&good) {
        known.push(*good && segment.hinge.as_ref().is_none_or(|(parent, _)| known[*parent]));
    }
    let mut table = TableWriter::create(&args.output, &columns)?;
    for pose in &solved.poses {
        table.number(pose.t_s)?;
        for (q, is_known) in pose.orientations.iter().zip(&known) {
            table.vector(is_known.then(|| orientation_to_wxyz(q)))?;
        }
        for at in (0..segments.len()).filter(|at| segments[*at].hinge.is_some()) {
            let angle_rad = [pose.flexion_rad[at], pose.sigma_rad[at]];
            table.vector(good[at].then(|| angle_rad.map(f64::to_degrees)))?;
        }
        table.end_row()?;
    }
    table.finish()
}
