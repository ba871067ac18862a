//! From joint angles to a whole figure: how a demonstration is shown.
//!
//! In: some angles of [`super::ANGLE_NAMES`], rad. Out: orientations of all segments in the room, of a body that looks along the room's x with
//! its pelvis upright. A joint of which no angle is known hangs straight.

use nalgebra::UnitQuaternion;

use super::angles::{ANGLES, joint_rotation, of_joint};
use super::skeleton::{BodySegment, SEGMENTS, Skeleton, upright};

/// Segment to room, by [`BodySegment::index`], from the angles that are known, rad, in the order of [`super::ANGLE_NAMES`].
///
/// A shoulder is placed by its flexion and abduction where either is known, else by plane and elevation; a plane that is not known is
/// that of the front.
pub fn orientations(known_rad: &[Option<f64>; ANGLES]) -> [UnitQuaternion<f64>; SEGMENTS] {
    let mut orientations = [upright(); SEGMENTS];
    for segment in Skeleton::PARENTS_FIRST {
        let Some(parent) = segment.parent() else { continue };
        let known = &known_rad[of_joint(segment)];
        let mut angles: [f64; 5] =
            std::array::from_fn(|index| known.get(index).copied().flatten().unwrap_or(0.0));
        if let BodySegment::UpperArmR | BodySegment::UpperArmL = segment {
            [angles[0], angles[1]] = match (known[3], known[4]) {
                (None, None) => [known[0].unwrap_or(std::f64::consts::FRAC_PI_2), angles[1]],
                // Flexion is elevation * sin(plane), abduction elevation * cos(plane).
                _ => [libm::atan2(angles[3], angles[4]), libm::hypot(angles[3], angles[4])],
            };
            // Rotation is the turn about the arm beside that of the plane, which falls together with it where the arm hangs.
            angles[2] = known[2].unwrap_or(-angles[0]);
        }
        orientations[segment.index()] = orientations[parent.index()] * joint_rotation(segment, &angles);
    }
    orientations
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::{ANGLE_NAMES, angles};

    fn index(name: &str) -> usize {
        ANGLE_NAMES.iter().position(|known| *known == name).unwrap()
    }

    /// What is known comes back, and what is not hangs.
    #[test]
    fn known_angles_come_back() {
        let cases: [&[(&str, f64)]; 6] = [
            &[("elbow_r_flexion", 120.0)],
            &[("shoulder_l_flexion", 70.0)],
            &[("shoulder_r_abduction", 80.0), ("shoulder_r_flexion", 10.0)],
            &[("shoulder_r_elevation", 60.0)],
            &[("hip_r_flexion", 80.0), ("knee_r_flexion", 90.0), ("spine_flexion", 20.0)],
            &[("shoulder_l_flexion", 0.0), ("shoulder_l_rotation", 20.0), ("elbow_l_flexion", 90.0)],
        ];
        for case in cases {
            let mut known_rad = [None; ANGLES];
            case.iter().for_each(|(name, degrees)| known_rad[index(name)] = Some(degrees.to_radians()));
            let found = angles(&orientations(&known_rad).map(Some));
            for (name, degrees) in case.iter().filter(|(name, _)| !name.ends_with("_rotation")) {
                let off = found[index(name)].unwrap().to_degrees() - degrees;
                assert!(off.abs() < 1e-9, "{name} of {case:?}: {off}");
            }
        }
        assert_eq!(orientations(&[None; ANGLES]), [upright(); SEGMENTS]);
    }
}
