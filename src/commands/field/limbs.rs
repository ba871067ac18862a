//! From a stage file's body to joints and bones between its sensors.

use nalgebra::Vector3;
use posed_field::{Bone, Joint, Limbs, PoleRun, Way};
use posed_fusion::body::BodySegment;
use posed_geometry::orientation_from_wxyz;
use posed_stage::layout::skeleton_of;
use posed_stage::{Mounting, Stage};

use super::Error;
use super::posture::{Worn, add_priors};

/// A bone in proportion to the height is known to this share, a measured one to this, m.
const PROPORTION: f64 = 0.02;
const MEASURED_M: f64 = 5e-4;

/// A bone that was measured, as the command line gives it.
#[derive(Clone, Debug)]
pub(super) struct Measured {
    segment: String,
    length_m: f64,
}

/// Reads `SEGMENT=LENGTH`.
pub(super) fn measured(text: &str) -> Result<Measured, String> {
    let wrong = || "write SEGMENT=LENGTH in metres, such as upper_arm_r=0.31".to_owned();
    let (segment, length) = text.split_once('=').ok_or_else(wrong)?;
    let length_m: f64 = length.trim().parse().map_err(|_| wrong())?;
    if (0.02..2.0).contains(&length_m) {
        Ok(Measured { segment: segment.trim().to_owned(), length_m })
    } else {
        Err(wrong())
    }
}

/// A segment that wears a sensor.
struct Wears<'a> {
    name: &'a str,
    parent: Option<&'a str>,
    /// Index among the sensors that are asked for.
    sensor: usize,
    entry: &'a posed_stage::Sensor,
}

/// When the person stood in an N-pose, s of the session.
pub(super) fn span(text: &str) -> Result<[f64; 2], String> {
    let wrong = || "write FROM,TO in seconds of the session, such as 0,3".to_owned();
    let (from, to) = text.split_once(',').ok_or_else(wrong)?;
    match (from.trim().parse::<f64>(), to.trim().parse::<f64>()) {
        (Ok(from_s), Ok(to_s)) if from_s >= 0.0 && to_s > from_s && to_s.is_finite() => Ok([from_s, to_s]),
        _ => Err(wrong()),
    }
}

/// Adds what the person's first posture tells.
pub(super) fn add_posture(
    limbs: &mut Limbs,
    run: &PoleRun,
    stage: &Stage,
    span_s: [f64; 2],
) -> Result<(), Error> {
    let body = stage.bodies.first();
    let skeleton = body.filter(|body| body.skeleton == posed_stage::Skeleton::Human).and_then(skeleton_of);
    let skeleton = skeleton
        .ok_or_else(|| Error::failed("--n-pose needs the human skeleton with `height_m` in [body]"))?;
    let worn: Option<Vec<Worn>> = run
        .sensors
        .iter()
        .map(|name| {
            let entry = stage.sensors.iter().find(|sensor| sensor.name == *name)?;
            let segment = BodySegment::named(entry.segment.as_deref().unwrap_or(&entry.name))?;
            Some(Worn { segment, offset_m: entry.offset_m.map(Vector3::from) })
        })
        .collect();
    let worn =
        worn.ok_or_else(|| Error::failed("--n-pose: a sensor sits on no segment of the human skeleton"))?;
    let room = stage.transmitter.pose_in_room.and_then(|pose| orientation_from_wxyz(pose.orientation_wxyz));
    let up = room.unwrap_or_default().inverse() * Vector3::z();
    add_priors(limbs, run, span_s, &worn, &skeleton, &up)
        .map_err(|error| Error::Failed(format!("--n-pose: {error}")))
}

/// The names of the sensors that sit on segments, and how they hang together.
pub(super) fn of_stage(stage: &Stage, measured: &[Measured]) -> Result<(Vec<String>, Limbs), Error> {
    let body = stage.bodies.first().ok_or_else(|| Error::Failed("the stage file has no [body]".into()))?;
    let human = body.skeleton == posed_stage::Skeleton::Human;
    let parent = |name: &str| -> Option<&str> {
        if human {
            return BodySegment::named(name)?.parent().map(BodySegment::name);
        }
        body.segments.iter().find(|segment| segment.name == name)?.parent.as_deref()
    };
    let is_segment = |name: &str| {
        if human { BodySegment::named(name).is_some() } else { body.segments.iter().any(|s| s.name == name) }
    };
    let mut names = Vec::new();
    let mut wearing: Vec<Wears<'_>> = Vec::new();
    for entry in &stage.sensors {
        let name = entry.segment.as_deref().unwrap_or(&entry.name);
        if is_segment(name) && wearing.iter().all(|other| other.name != name) {
            wearing.push(Wears { name, parent: parent(name), sensor: names.len(), entry });
            names.push(entry.name.clone());
        }
    }
    for bone in measured {
        if !wearing.iter().any(|segment| segment.name == bone.segment) {
            return Err(Error::Usage(format!("--bone: no sensor sits on {:?}", bone.segment)));
        }
    }
    // A measured bone is worth more than proportions, and the two may contradict each other.
    let skeleton = skeleton_of(body).filter(|_| human && measured.is_empty());
    let given = body.mounting == Mounting::Given;
    let mut limbs = Limbs::default();
    for child in &wearing {
        let Some(parent) = wearing.iter().find(|other| Some(other.name) == child.parent) else { continue };
        let joints_m = skeleton.as_ref().zip(BodySegment::named(child.name)).map(|(skeleton, segment)| {
            [skeleton.joint_in_segment_m(segment), skeleton.joint_in_parent_m(segment)]
        });
        let way = |wears: &Wears<'_>, joint_m: Option<Vector3<f64>>| {
            let rotation = orientation_from_wxyz(wears.entry.mount_quat_wxyz?)?;
            let offset = Vector3::from(wears.entry.offset_m?);
            given.then_some(Way::stated(rotation.inverse() * (joint_m? - offset)))
        };
        limbs.joints.push(Joint {
            name: format!("{} to {}", parent.name, child.name),
            sensors: [child.sensor, parent.sensor],
            range: None,
            ways: [way(child, joints_m.map(|p| p[0])), way(parent, joints_m.map(|p| p[1]))],
        });
    }
    for segment in &wearing {
        let joints: Vec<usize> =
            (0..limbs.joints.len()).filter(|j| limbs.joints[*j].sensors.contains(&segment.sensor)).collect();
        let joint_m = |joint: usize| {
            let other = limbs.joints[joint].sensors[0];
            let skeleton = skeleton.as_ref()?;
            if other == segment.sensor {
                return Some(skeleton.joint_in_segment_m(BodySegment::named(segment.name)?));
            }
            let child = wearing.iter().find(|wears| wears.sensor == other)?;
            Some(skeleton.joint_in_parent_m(BodySegment::named(child.name)?))
        };
        for (k, first) in joints.iter().enumerate() {
            for second in &joints[k + 1..] {
                let reported = measured.iter().find(|bone| bone.segment == segment.name && joints.len() == 2);
                let proportion = joint_m(*first).zip(joint_m(*second)).map(|(a, b)| (a - b).norm());
                let length_m =
                    reported.map(|bone| bone.length_m).or(proportion).filter(|length| *length > 0.02);
                let sigma_m =
                    if reported.is_some() { MEASURED_M } else { PROPORTION * length_m.unwrap_or(0.0) };
                let name = segment.name.to_owned();
                let joints = [*first, *second];
                limbs.bones.push(Bone { name, sensor: segment.sensor, joints, length_m, sigma_m });
            }
        }
    }
    if limbs.joints.is_empty() {
        let text = "no two sensors sit on segments that meet in a joint: name sensors after segments";
        return Err(Error::Failed(text.into()));
    }
    Ok((names, limbs))
}
