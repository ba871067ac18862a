//! Points of the body that laboratories know: joint centres, and where head, hands and feet end.

use nalgebra::Vector3;

use super::Frame;
use posed_fusion::body::{BodySegment, SEGMENTS, Skeleton};

/// Joint centres and far ends, by the names that OpenSim users expect of such points.
pub(super) const MARKERS: [&str; 19] = [
    "hips",
    "neck",
    "shoulder_r",
    "elbow_r",
    "wrist_r",
    "hip_r",
    "knee_r",
    "ankle_r",
    "shoulder_l",
    "elbow_l",
    "wrist_l",
    "hip_l",
    "knee_l",
    "ankle_l",
    "head_top",
    "finger_r",
    "toe_r",
    "finger_l",
    "toe_l",
];

/// Where they are in the room (z up), m, in the order of [`MARKERS`].
pub(super) fn points(skeleton: &Skeleton, frame: &Frame) -> [Vector3<f64>; MARKERS.len()] {
    let origins: [Vector3<f64>; SEGMENTS] = skeleton.origins_m(&frame.orientations, frame.pelvis_m);
    let origin = |segment: BodySegment| origins[segment.index()];
    let end = |segment: BodySegment| {
        origins[segment.index()] + frame.orientations[segment.index()] * skeleton.end_in_segment_m(segment)
    };
    [
        frame.pelvis_m,
        end(BodySegment::Torso),
        origin(BodySegment::UpperArmR),
        origin(BodySegment::ForearmR),
        end(BodySegment::ForearmR),
        origin(BodySegment::ThighR),
        origin(BodySegment::ShankR),
        end(BodySegment::ShankR),
        origin(BodySegment::UpperArmL),
        origin(BodySegment::ForearmL),
        end(BodySegment::ForearmL),
        origin(BodySegment::ThighL),
        origin(BodySegment::ShankL),
        end(BodySegment::ShankL),
        end(BodySegment::Head),
        end(BodySegment::HandR),
        end(BodySegment::FootR),
        end(BodySegment::HandL),
        end(BodySegment::FootL),
    ]
}
