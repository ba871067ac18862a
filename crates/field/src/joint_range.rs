//! How far two segments can turn against each other: what no joint allows was measured wrongly.

use nalgebra::{Unit, UnitQuaternion, Vector3};
use posed_geometry::wrapped_rad;

/// Rotations that a joint allows, from how its two sensors are turned in a known posture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointRange {
    /// First sensor to second in that posture.
    pub neutral: UnitQuaternion<f64>,
    /// The axis about which the joint has limits of its own, first sensor's axes.
    pub axis: Unit<Vector3<f64>>,
    /// Least and largest angle about it, rad.
    pub about_rad: [f64; 2],
    /// Largest angle beside it, rad.
    pub beside_rad: f64,
}

impl JointRange {
    /// Whether the joint allows these orientations of its first and second sensor.
    pub fn allows(&self, [first, second]: &[UnitQuaternion<f64>; 2]) -> bool {
        let turned = self.neutral.inverse() * (second.inverse() * first);
        // Swing and twist: first about the axis, then beside it.
        let along = turned.imag().dot(&self.axis);
        let about_rad = wrapped_rad(2.0 * libm::atan2(along, turned.w));
        let beside = (turned.w * turned.w + along * along).sqrt().min(1.0);
        let [least, largest] = self.about_rad;
        (least..=largest).contains(&about_rad) && 2.0 * libm::acos(beside) <= self.beside_rad
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hinge_allows_its_flexion_and_little_beside_it() {
        let [first, second] =
            [Vector3::new(0.3, -1.0, 0.4), Vector3::new(-0.7, 0.2, 1.1)].map(UnitQuaternion::new);
        let axis = Unit::new_normalize(Vector3::new(0.2, 0.9, -0.3));
        let range =
            JointRange { neutral: second.inverse() * first, axis, about_rad: [-0.2, 2.7], beside_rad: 0.4 };
        let turned = |about: f64, beside: f64| {
            let across = Unit::new_normalize(axis.cross(&Vector3::z()));
            let by = UnitQuaternion::from_axis_angle(&across, beside)
                * UnitQuaternion::from_axis_angle(&axis, about);
            range.allows(&[first * by, second])
        };
        for (about, beside, expected) in [
            (0.0, 0.0, true),
            (2.6, 0.0, true),
            (2.8, 0.0, false),
            (-0.3, 0.0, false),
            (1.0, 0.35, true),
            (1.0, 0.45, false),
        ] {
            assert_eq!(turned(about, beside), expected, "{about} {beside}");
        }
    }
}
