//! STO: orientations of segments for OpenSim's OpenSense, as if a sensor sat on each in the segment's own axes.

use std::fmt::Write;

use super::Frame;
use posed_fusion::body::{BodySegment, upright};

/// Bodies of OpenSim's whole models. The head is the torso's there.
const BODIES: [(BodySegment, &str); 14] = [
    (BodySegment::Pelvis, "pelvis"),
    (BodySegment::Torso, "torso"),
    (BodySegment::ThighR, "femur_r"),
    (BodySegment::ShankR, "tibia_r"),
    (BodySegment::FootR, "calcn_r"),
    (BodySegment::ThighL, "femur_l"),
    (BodySegment::ShankL, "tibia_l"),
    (BodySegment::FootL, "calcn_l"),
    (BodySegment::UpperArmR, "humerus_r"),
    (BodySegment::ForearmR, "radius_r"),
    (BodySegment::HandR, "hand_r"),
    (BodySegment::UpperArmL, "humerus_l"),
    (BodySegment::ForearmL, "radius_l"),
    (BodySegment::HandL, "hand_l"),
];

/// In OpenSim's axes: x forward, y up, z right of a body that looks along the room's x.
pub(super) fn text(rate_hz: f64, frames: &[Frame]) -> String {
    let labels = BODIES.map(|(_, body)| format!("{body}_imu")).join("\t");
    let mut out =
        format!("DataRate={rate_hz:.6}\nDataType=Quaternion\nversion=3\nendheader\ntime\t{labels}\n");
    let up = upright().inverse();
    for frame in frames {
        // Writing to a string cannot fail.
        let _ = write!(out, "{:.6}", frame.t_s);
        for (segment, _) in BODIES {
            let q = up * frame.orientations[segment.index()];
            let _ = write!(out, "\t{:.7},{:.7},{:.7},{:.7}", q.w, q.i, q.j, q.k);
        }
        out.push('\n');
    }
    out
}
