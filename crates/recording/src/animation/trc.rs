//! TRC: joint centres as markers, metres.

use std::fmt::Write;
use std::path::Path;

use nalgebra::Vector3;

use super::Frame;
use posed_fusion::body::{BodySegment, SEGMENTS, Skeleton, upright};

/// Joint centres and far ends, by the names that OpenSim users expect of such points.
const MARKERS: [&str; 19] = [
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

pub(super) fn text(skeleton: &Skeleton, rate_hz: f64, frames: &[Frame], path: &Path) -> String {
    let name = path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
    let (count, markers) = (frames.len(), MARKERS.len());
    let mut out = format!("PathFileType\t4\t(X/Y/Z)\t{name}\n");
    // Writing to a string cannot fail.
    let _ = writeln!(
        out,
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames\n\
         {rate_hz:.6}\t{rate_hz:.6}\t{count}\t{markers}\tm\t{rate_hz:.6}\t1\t{count}"
    );
    let _ = writeln!(out, "Frame#\tTime\t{}", MARKERS.map(|marker| format!("{marker}\t\t")).join("\t"));
    let numbers: Vec<String> = (1..=markers).map(|k| format!("X{k}\tY{k}\tZ{k}")).collect();
    let _ = writeln!(out, "\t\t{}\n", numbers.join("\t"));
    for (k, frame) in frames.iter().enumerate() {
        let _ = write!(out, "{}\t{:.6}", k + 1, frame.t_s);
        for point in points(skeleton, frame) {
            let _ = write!(out, "\t{:.6}\t{:.6}\t{:.6}", point.x, point.y, point.z);
        }
        out.push('\n');
    }
    out
}

/// In the order of [`MARKERS`].
pub(super) fn points(skeleton: &Skeleton, frame: &Frame) -> [Vector3<f64>; MARKERS.len()] {
    // To x forward, y up, z right.
    let up = upright().inverse();
    let origins: [Vector3<f64>; SEGMENTS] = skeleton.origins_m(&frame.orientations, frame.pelvis_m);
    let origin = |segment: BodySegment| up * origins[segment.index()];
    let end = |segment: BodySegment| {
        let end_m = frame.orientations[segment.index()] * skeleton.end_in_segment_m(segment);
        up * (origins[segment.index()] + end_m)
    };
    [
        up * frame.pelvis_m,
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
