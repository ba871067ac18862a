//! MOT: coordinates of joints for OpenSim's models, degrees and metres. Their joints turn about z, then x, then y (ahead x, up y, right z), those of
//! the left as in a mirror; all are zero in the anatomical pose, whose palms face ahead.

use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::fmt::Write;

use nalgebra::{UnitQuaternion, Vector3};

use super::Frame;
use super::bvh::zxy;
use posed_fusion::body::{BodySegment as B, to_right, upright};
use posed_geometry::so3::exp;

/// Whose coordinates a MOT file has.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
pub enum OpensimModel {
    /// Rajagopal's whole body (2015, 2016) and those made of it: knees bend by positive angles.
    #[default]
    Rajagopal,
    /// Gait 2392 and 2354, without arms: knees bend by negative angles.
    Gait2392,
}

/// Coordinates of the joint above a segment, about z, x and y; none where the models' joint does not turn so. Subtalar joints and those of the toes turn about
/// slanting axes and are locked: they are left out.
const JOINTS: [(B, [&str; 3]); 14] = [
    (B::Pelvis, ["pelvis_tilt", "pelvis_list", "pelvis_rotation"]),
    (B::ThighR, ["hip_flexion_r", "hip_adduction_r", "hip_rotation_r"]),
    (B::ShankR, ["knee_angle_r", "", ""]),
    (B::FootR, ["ankle_angle_r", "", ""]),
    (B::ThighL, ["hip_flexion_l", "hip_adduction_l", "hip_rotation_l"]),
    (B::ShankL, ["knee_angle_l", "", ""]),
    (B::FootL, ["ankle_angle_l", "", ""]),
    (B::Torso, ["lumbar_extension", "lumbar_bending", "lumbar_rotation"]),
    (B::UpperArmR, ["arm_flex_r", "arm_add_r", "arm_rot_r"]),
    (B::ForearmR, ["elbow_flex_r", "", "pro_sup_r"]),
    (B::HandR, ["wrist_flex_r", "wrist_dev_r", ""]),
    (B::UpperArmL, ["arm_flex_l", "arm_add_l", "arm_rot_l"]),
    (B::ForearmL, ["elbow_flex_l", "", "pro_sup_l"]),
    (B::HandL, ["wrist_flex_l", "wrist_dev_l", ""]),
];
/// Those of a model without arms come first.
const WITHOUT_ARMS: usize = 8;

pub(super) fn text(rate_hz: f64, frames: &[Frame], model: OpensimModel) -> String {
    let joints = match model {
        OpensimModel::Rajagopal => &JOINTS[..],
        OpensimModel::Gait2392 => &JOINTS[..WITHOUT_ARMS],
    };
    let places = ["pelvis_tx", "pelvis_ty", "pelvis_tz"];
    let coordinates = joints.iter().flat_map(|(_, names)| names).filter(|name| !name.is_empty());
    let labels: Vec<&str> = std::iter::once("time").chain(places).chain(coordinates.copied()).collect();
    let mut out = format!(
        "Coordinates\nversion=1\nnRows={}\nnColumns={}\nDataRate={rate_hz:.6}\ninDegrees=yes\nendheader\n{}\n",
        frames.len(),
        labels.len(),
        labels.join("\t")
    );
    let up = upright().inverse();
    let mut latest: Option<Vec<[f64; 3]>> = None;
    for frame in frames {
        let hips_m = up * frame.pelvis_m;
        // Writing to a string cannot fail.
        let _ = write!(out, "{:.6}\t{:.6}\t{:.6}\t{:.6}", frame.t_s, hips_m.x, hips_m.y, hips_m.z);
        let mut turned = Vec::with_capacity(joints.len());
        for (at, (segment, names)) in joints.iter().enumerate() {
            let angles = zxy(&rotation(frame, *segment));
            let angles = latest.as_ref().map_or(angles, |latest| nearest(&latest[at], angles));
            let bends_by_positive =
                model == OpensimModel::Rajagopal && matches!(segment, B::ShankR | B::ShankL);
            let sign = if bends_by_positive { -1.0 } else { 1.0 };
            for (angle, _) in angles.iter().zip(names).filter(|(_, name)| !name.is_empty()) {
                let _ = write!(out, "\t{:.6}", (sign * angle).to_degrees());
            }
            turned.push(angles);
        }
        latest = Some(turned);
        out.push('\n');
    }
    out
}

/// What the joint above a segment turns it by, in the models' axes, on the left as in a mirror; the pelvis in OpenSim's world.
fn rotation(frame: &Frame, segment: B) -> UnitQuaternion<f64> {
    let own = frame.orientations[segment.index()];
    let Some(parent) = segment.parent() else { return upright().inverse() * own };
    let q = frame.orientations[parent.index()].inverse() * own;
    anatomical(parent).inverse() * to_right(segment, &q) * anatomical(segment)
}

/// A segment's axes in the models, in ours: theirs of forearm and hand are ahead where the palm looks, ours where the thumb points.
fn anatomical(segment: B) -> UnitQuaternion<f64> {
    match segment {
        B::ForearmR | B::ForearmL | B::HandR | B::HandL => exp(&(Vector3::y() * FRAC_PI_2)),
        _ => UnitQuaternion::identity(),
    }
}

/// The same rotation in the angles that lie nearest to those before it: programs that filter them must find no jump.
fn nearest(before: &[f64; 3], [z, x, y]: [f64; 3]) -> [f64; 3] {
    let near = |angles: [f64; 3]| {
        let mut near = [0.0; 3];
        for k in 0..3 {
            near[k] = angles[k] - TAU * ((angles[k] - before[k]) / TAU).round();
        }
        near
    };
    let off = |angles: &[f64; 3]| -> f64 { angles.iter().zip(before).map(|(a, b)| (a - b).powi(2)).sum() };
    // Every rotation has two triples.
    let (one, other) = (near([z, x, y]), near([z + PI, PI - x, y + PI]));
    if off(&other) < off(&one) { other } else { one }
}
