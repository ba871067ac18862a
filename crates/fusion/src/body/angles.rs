//! Joint angles of the table in `docs/body.md`, from segment orientations and back.
//!
//! In: orientations of the segments beside a joint. Out: its angles, rad, in the table's order and signs. ISB: Wu
//! et al. 2002 (hip, knee; spine), 2005 (shoulder, elbow). Where a sequence is singular the first of the two angles that
//! fall together is zero, so that the numbers stay finite; the orientation is never changed.

use nalgebra::{UnitQuaternion, Vector3};

use super::skeleton::{BodySegment, SEGMENTS};
use posed_geometry::so3::exp;

/// Below this sine two axes of a sequence count as one.
const SINGULAR: f64 = 1e-6;

/// Angles of a body; their meaning, axes and signs are in the table of `docs/body.md`.
pub const ANGLES: usize = 44;

/// How columns and fields of the angles are named: joint, side where there is one, angle.
pub const ANGLE_NAMES: [&str; ANGLES] = [
    "spine_flexion",
    "spine_lateral",
    "spine_rotation",
    "shoulder_r_plane",
    "shoulder_r_elevation",
    "shoulder_r_rotation",
    "shoulder_r_flexion",
    "shoulder_r_abduction",
    "elbow_r_flexion",
    "elbow_r_pronation",
    "hip_r_flexion",
    "hip_r_adduction",
    "hip_r_rotation",
    "knee_r_flexion",
    "shoulder_l_plane",
    "shoulder_l_elevation",
    "shoulder_l_rotation",
    "shoulder_l_flexion",
    "shoulder_l_abduction",
    "elbow_l_flexion",
    "elbow_l_pronation",
    "hip_l_flexion",
    "hip_l_adduction",
    "hip_l_rotation",
    "knee_l_flexion",
    "neck_flexion",
    "neck_lateral",
    "neck_rotation",
    "wrist_r_flexion",
    "wrist_r_deviation",
    "ankle_r_flexion",
    "ankle_r_inversion",
    "ankle_r_rotation",
    "wrist_l_flexion",
    "wrist_l_deviation",
    "ankle_l_flexion",
    "ankle_l_inversion",
    "ankle_l_rotation",
    "sternoclavicular_r_protraction",
    "sternoclavicular_r_elevation",
    "sternoclavicular_r_rotation",
    "sternoclavicular_l_protraction",
    "sternoclavicular_l_elevation",
    "sternoclavicular_l_rotation",
];

/// Where the angles of the joint above a segment are in [`ANGLE_NAMES`]; empty for the pelvis.
pub fn of_joint(segment: BodySegment) -> std::ops::Range<usize> {
    match segment {
        BodySegment::Pelvis => 0..0,
        BodySegment::Torso => 0..3,
        BodySegment::UpperArmR => 3..8,
        BodySegment::ForearmR => 8..10,
        BodySegment::ThighR => 10..13,
        BodySegment::ShankR => 13..14,
        BodySegment::UpperArmL => 14..19,
        BodySegment::ForearmL => 19..21,
        BodySegment::ThighL => 21..24,
        BodySegment::ShankL => 24..25,
        BodySegment::Head => 25..28,
        BodySegment::HandR => 28..30,
        BodySegment::FootR => 30..33,
        BodySegment::HandL => 33..35,
        BodySegment::FootL => 35..38,
        BodySegment::ShoulderR => 38..41,
        BodySegment::ShoulderL => 41..44,
    }
}

/// All angles in the order of [`ANGLE_NAMES`], rad, from segment orientations (segment to room, or to any other common
/// frame); `None` where one of the segments beside the joint is not known. How uncertain they are: [`super::AngleSpread`].
pub fn angles(orientations: &[Option<UnitQuaternion<f64>>; SEGMENTS]) -> [Option<f64>; ANGLES] {
    let mut out = [None; ANGLES];
    for segment in BodySegment::ALL {
        let Some(parent) = segment.parent() else { continue };
        let (Some(above), Some(below)) = (orientations[parent.index()], orientations[segment.index()]) else {
            continue;
        };
        let angles = joint_angles(segment, &(above.inverse() * below));
        for (slot, angle) in out[of_joint(segment)].iter_mut().zip(angles) {
            *slot = Some(angle);
        }
    }
    out
}

/// Angles of the joint above a segment, rad, from segment to parent; as many as [`of_joint`] has, the rest zero. Decomposed
/// as ISB recommends (Wu et al. 2002, 2005): Z-X-Y, shoulder Y-X-Y, left joints as in a mirror; the collar bone Y-X-Z; the wrist X-Z-Y, since the forearm's x points to the thumb here.
///
/// Where the sequence is singular (middle angle of 90 degrees, for the shoulder 0 or 180) the first angle is zero and the
/// last has both.
pub fn joint_angles(segment: BodySegment, q_parent_segment: &UnitQuaternion<f64>) -> [f64; 5] {
    let right = to_right(segment, q_parent_segment);
    match segment {
        BodySegment::Pelvis => [0.0; 5],
        BodySegment::Torso | BodySegment::Head => {
            let [z, x, y] = zxy(&right);
            [-z, x, y, 0.0, 0.0]
        }
        BodySegment::UpperArmR | BodySegment::UpperArmL => {
            let [plane, elevation, rotation] = yxy(&right);
            [plane, elevation, rotation, elevation * libm::sin(plane), elevation * libm::cos(plane)]
        }
        // The sequence Z-X-Y without the carrying angle X, which the filter's elbow does not have.
        BodySegment::ForearmR | BodySegment::ForearmL => {
            let [flexion, _, pronation] = zxy(&right);
            [flexion, pronation, 0.0, 0.0, 0.0]
        }
        // Of the ankle: dorsiflexion, inversion, rotation inwards.
        BodySegment::ThighR | BodySegment::ThighL | BodySegment::FootR | BodySegment::FootL => {
            let [flexion, adduction, rotation] = zxy(&right);
            [flexion, adduction, rotation, 0.0, 0.0]
        }
        // A hand does not turn about the forearm: what is left of that is in neither angle.
        BodySegment::HandR | BodySegment::HandL => {
            let [flexion, deviation] = xz(&right);
            [flexion, -deviation, 0.0, 0.0, 0.0]
        }
        BodySegment::ShankR | BodySegment::ShankL => [-zxy(&right)[0], 0.0, 0.0, 0.0, 0.0],
        BodySegment::ShoulderR | BodySegment::ShoulderL => {
            let [protraction, depression, rotation] = yxz(&right);
            [protraction, -depression, rotation, 0.0, 0.0]
        }
    }
}

/// Segment to parent from the joint's angles, rad, in the order of [`joint_angles`], missing ones zero; flexion and abduction
/// of a shoulder are not read. The inverse of [`joint_angles`] but for the carrying angle and what a knee cannot do.
pub fn joint_rotation(segment: BodySegment, angles: &[f64]) -> UnitQuaternion<f64> {
    let angle = |index: usize| angles.get(index).copied().unwrap_or(0.0);
    let (x, y, z) = (Vector3::x(), Vector3::y(), Vector3::z());
    let right = match segment {
        BodySegment::Pelvis => UnitQuaternion::identity(),
        BodySegment::Torso | BodySegment::Head => {
            exp(&(-z * angle(0))) * exp(&(x * angle(1))) * exp(&(y * angle(2)))
        }
        BodySegment::UpperArmR | BodySegment::UpperArmL => {
            exp(&(y * angle(0))) * exp(&(-x * angle(1))) * exp(&(y * angle(2)))
        }
        BodySegment::ForearmR | BodySegment::ForearmL => exp(&(z * angle(0))) * exp(&(y * angle(1))),
        BodySegment::HandR | BodySegment::HandL => exp(&(x * angle(0))) * exp(&(-z * angle(1))),
        BodySegment::ThighR | BodySegment::ThighL | BodySegment::FootR | BodySegment::FootL => {
            exp(&(z * angle(0))) * exp(&(x * angle(1))) * exp(&(y * angle(2)))
        }
        BodySegment::ShankR | BodySegment::ShankL => exp(&(-z * angle(0))),
        BodySegment::ShoulderR | BodySegment::ShoulderL => {
            exp(&(y * angle(0))) * exp(&(-x * angle(1))) * exp(&(z * angle(2)))
        }
    };
    to_right(segment, &right)
}

/// The rotation of a joint above a left segment as in a mirror, so that one table serves both sides; right ones as they are. Its own inverse.
pub fn to_right(segment: BodySegment, q: &UnitQuaternion<f64>) -> UnitQuaternion<f64> {
    if segment.side() < 0.0 {
        UnitQuaternion::new_unchecked(nalgebra::Quaternion::new(q.w, -q.i, -q.j, q.k))
    } else {
        *q
    }
}

/// Angles of `R_z(a) R_x(b) R_y(c)`.
fn zxy(q: &UnitQuaternion<f64>) -> [f64; 3] {
    let m = q.to_rotation_matrix().into_inner();
    let b = libm::asin(m[(2, 1)].clamp(-1.0, 1.0));
    if libm::cos(b) < SINGULAR {
        return [0.0, b, libm::atan2(m[(0, 2)], m[(0, 0)])];
    }
    [libm::atan2(-m[(0, 1)], m[(1, 1)]), b, libm::atan2(-m[(2, 0)], m[(2, 2)])]
}

/// Angles of `R_y(a) R_x(b) R_z(c)`.
fn yxz(q: &UnitQuaternion<f64>) -> [f64; 3] {
    let m = q.to_rotation_matrix().into_inner();
    let b = libm::asin((-m[(1, 2)]).clamp(-1.0, 1.0));
    if libm::cos(b) < SINGULAR {
        return [0.0, b, libm::atan2(-m[(0, 1)], m[(0, 0)])];
    }
    [libm::atan2(m[(0, 2)], m[(2, 2)]), b, libm::atan2(m[(1, 0)], m[(1, 1)])]
}

/// The first two angles of `R_x(a) R_z(b) R_y(c)`.
fn xz(q: &UnitQuaternion<f64>) -> [f64; 2] {
    let m = q.to_rotation_matrix().into_inner();
    let b = libm::asin((-m[(0, 1)]).clamp(-1.0, 1.0));
    if libm::cos(b) < SINGULAR {
        return [0.0, b];
    }
    [libm::atan2(m[(2, 1)], m[(1, 1)]), b]
}

/// Angles of `R_y(a) R_x(-b) R_y(c)` with b from 0 to pi.
fn yxy(q: &UnitQuaternion<f64>) -> [f64; 3] {
    let m = q.to_rotation_matrix().into_inner();
    let sine = libm::hypot(m[(0, 1)], m[(2, 1)]);
    let b = libm::atan2(sine, m[(1, 1)]);
    if sine < SINGULAR {
        return [0.0, b, libm::atan2(m[(0, 2)], m[(0, 0)])];
    }
    [libm::atan2(-m[(0, 1)], -m[(2, 1)]), b, libm::atan2(-m[(1, 0)], m[(1, 2)])]
}
