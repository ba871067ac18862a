//! How uncertain the angles of a joint are: from the covariance of its rotation to that of its angles.
//!
//! In: a joint's rotation and the covariance of its error, rad², in the lower segment's axes. Out: the covariance of the angles
//! in the table of `docs/body.md`. For small errors `rotation = M d(angles)` with the axes of the sequence as columns of `M`.
//! Where two of its axes fall together their angles are as uncertain as an angle can be.

use nalgebra::{Matrix3, SMatrix, UnitQuaternion, Vector3};
use posed_state::Plain;
use serde::{Deserialize, Serialize};
use serde_big_array::BigArray;

use super::BodyFilter;
use super::angles::{ANGLES, joint_angles, of_joint};
use super::skeleton::{BodySegment, Limb, SEGMENTS};
use crate::limb::LimbSpread;

/// Variance of an angle of which nothing is known, rad²: all values from -pi to pi are as likely.
const UNKNOWN_RAD2: f64 = std::f64::consts::PI * std::f64::consts::PI / 3.0;
/// What cross-axis errors of 0.3 % add to the tilt of a calibrated sensor: of gravity, and on limbs also of the 10 m/s² that they are
/// shaken by; variances, rad².
const TRUNK_RAD2: f64 = 0.003 * 0.003;
const LIMB_RAD2: f64 = 2.0 * TRUNK_RAD2;
/// Determinant of a sequence's axes below which two count as one.
const SINGULAR: f64 = 1e-4;

/// How uncertain the angles of a body are: the filter's covariance, the systematic errors of calibrated sensors and what a calibration leaves of the mountings
/// ([`super::SensorMount::sigma_rad`]), no soft tissue. How far it is right: `docs/body.md`; equations: `docs/methods/body.md`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Plain)]
pub struct AngleSpread {
    /// Standard deviation of each angle, rad, in the order of [`super::ANGLE_NAMES`]; at most pi / sqrt(3), that of an
    /// unknown angle. Zero for a joint that was not set: its angle is `None`.
    #[serde(with = "BigArray")]
    pub sigma_rad: [f64; ANGLES],
    /// By the segment below the joint ([`BodySegment::index`]): covariance of its independent angles, rad², order of
    /// [`super::joint_angles`]: the upper triangle row by row, for as many angles as [`independent`] gives, the rest zero.
    pub covariance_rad2: [[f64; 6]; SEGMENTS],
}

/// How many angles of the joint above a segment are independent of one another, 0 to 3: flexion and abduction of a shoulder
/// follow from its plane and elevation.
pub fn independent(segment: BodySegment) -> usize {
    of_joint(segment).len().min(3)
}

impl Default for AngleSpread {
    fn default() -> Self {
        Self { sigma_rad: [0.0; ANGLES], covariance_rad2: [[0.0; 6]; SEGMENTS] }
    }
}

impl AngleSpread {
    /// Fills in one joint, from segment to parent and the covariance of that rotation's error, rad², 3 x 3, segment's axes
    /// (error local, right-multiplied). Near a singular posture the angles that fall together count as unknown; the pelvis
    /// has no joint and changes nothing.
    pub fn set(
        &mut self,
        segment: BodySegment,
        q_parent_segment: &UnitQuaternion<f64>,
        rotation_rad2: &Matrix3<f64>,
    ) {
        let range = of_joint(segment);
        let by_rotation = derivative(segment, q_parent_segment);
        let all = by_rotation * rotation_rad2 * by_rotation.transpose();
        let known = |k: usize| {
            let variance = all[(k, k)];
            if variance.is_finite() && variance < UNKNOWN_RAD2 { variance.max(0.0) } else { UNKNOWN_RAD2 }
        };
        for (k, sigma_rad) in self.sigma_rad[range].iter_mut().enumerate() {
            *sigma_rad = known(k).sqrt();
        }
        // An angle that is capped takes its covariances with it.
        let share = |k: usize| if all[(k, k)] > 0.0 { (known(k) / all[(k, k)]).sqrt() } else { 1.0 };
        let count = independent(segment);
        let mut at = 0;
        for i in 0..count {
            for j in i..count {
                let value = if i == j { known(i) } else { all[(i, j)] * share(i) * share(j) };
                self.covariance_rad2[segment.index()][at] = if value.is_finite() { value } else { 0.0 };
                at += 1;
            }
        }
    }
}

impl BodyFilter {
    /// How uncertain the angles between these segments (to room) are: what the filters say of the joint's rotation, or what is said of it where a segment was
    /// `inferred`, rad², and what both sensors are systematically wrong by. Elbows and knees hold the headings of their segments together, so that
    /// magnetometers do not count there.
    pub(super) fn spread(
        &self,
        orientations: &[Option<UnitQuaternion<f64>>; SEGMENTS],
        inferred_rad2: &[Matrix3<f64>; SEGMENTS],
        limbs: &[Option<LimbSpread>; 4],
    ) -> AngleSpread {
        let mut spread = AngleSpread::default();
        let mut rotations_rad2 = *inferred_rad2;
        for (limb, spread) in Limb::ALL.into_iter().zip(limbs) {
            let [_, upper, lower] = limb.segments().map(BodySegment::index);
            if let Some(LimbSpread { rotations_rad2: of, .. }) = spread {
                [rotations_rad2[upper], rotations_rad2[lower]] = *of;
            }
        }
        for segment in BodySegment::ALL {
            let Some(parent) = segment.parent() else { continue };
            let (Some(above), Some(q)) = (orientations[parent.index()], orientations[segment.index()]) else {
                continue;
            };
            let limb = Limb::ALL
                .into_iter()
                .zip(limbs)
                .filter(|(_, spread)| spread.is_some())
                .map(|(limb, _)| limb.segments())
                .find(|of| of[1..].contains(&segment));
            let hinged = limb.is_some_and(|[.., lower]| lower == segment);
            let shaken = if segment == BodySegment::Torso { TRUNK_RAD2 } else { LIMB_RAD2 };
            let up = q.inverse() * Vector3::z();
            let level = [parent, segment].into_iter().filter_map(|of| self.sensors[of.index()].as_ref());
            // Without a field, what is between the two counts once.
            let drift_rad2 = 0.5 * self.links.between_rad2(parent, segment);
            let lasting: Matrix3<f64> = level
                .map(|sensor| {
                    let [tilt, heading] = sensor.lasting_rad2(self.held_s, drift_rad2);
                    let (tilt, heading) = (tilt + shaken, if hinged { 0.0 } else { heading });
                    Matrix3::identity() * tilt + up * up.transpose() * (heading - tilt)
                })
                .sum();
            // A mounting is wrong in its segment's own axes, and stays so; a limb's filter knows of its own.
            let mounted = |of: BodySegment| match &self.sensors[of.index()] {
                Some(sensor) if !limb.is_some_and(|limb| limb[1..].contains(&of)) => {
                    sensor.mount.rotation_rad2()
                }
                _ => Matrix3::zeros(),
            };
            let from_above = (q.inverse() * above).to_rotation_matrix();
            let mounts = mounted(segment) + from_above * mounted(parent) * from_above.transpose();
            spread.set(
                segment,
                &(above.inverse() * q),
                &(rotations_rad2[segment.index()] + lasting + mounts),
            );
        }
        spread
    }
}

/// Derivatives of a joint's angles, in the order of [`joint_angles`], with respect to a small rotation in the segment's axes.
fn derivative(segment: BodySegment, q_parent_segment: &UnitQuaternion<f64>) -> SMatrix<f64, 5, 3> {
    let mut out = SMatrix::<f64, 5, 3>::zeros();
    let angles = joint_angles(segment, q_parent_segment);
    let about = |axis: Vector3<f64>, angle: f64| UnitQuaternion::new(axis * angle);
    let (x, y, z) = (Vector3::x(), Vector3::y(), Vector3::z());
    // Axes of the sequence, relative to the segment, each positive as its angle is.
    let axes = match segment {
        BodySegment::Pelvis => return out,
        BodySegment::UpperArmR | BodySegment::UpperArmL => {
            let [_, b, c, ..] = angles;
            let last = about(y, -c);
            [last * about(x, b) * y, last * -x, y]
        }
        BodySegment::ForearmR | BodySegment::ForearmL => {
            // The carrying angle between flexion and pronation is nought, as far as the joint goes.
            let last = about(y, -angles[1]);
            [last * z, y, last * x]
        }
        BodySegment::HandR | BodySegment::HandL => {
            // About itself a hand is not turned against the forearm, as far as the joint goes.
            [about(z, angles[1]) * x, -z, y]
        }
        BodySegment::Torso
        | BodySegment::Head
        | BodySegment::ThighR
        | BodySegment::ThighL
        | BodySegment::FootR
        | BodySegment::FootL => {
            let [_, b, c, ..] = angles;
            let sign = if matches!(segment, BodySegment::Torso | BodySegment::Head) { -1.0 } else { 1.0 };
            let last = about(y, -c);
            [last * about(x, -b) * z * sign, last * x, y]
        }
        BodySegment::ShankR | BodySegment::ShankL => [-z, x, y],
        BodySegment::ShoulderR | BodySegment::ShoulderL => {
            let [_, b, c, ..] = angles;
            let last = about(z, -c);
            [last * about(x, b) * y, last * -x, z]
        }
    };
    let Some(inverse) = Matrix3::from_columns(&axes)
        .try_inverse()
        .filter(|inverse| inverse.determinant().abs() < SINGULAR.recip())
    else {
        out.fill(f64::INFINITY);
        return out;
    };
    // A left joint is measured in a mirror.
    let mirror = if segment.side() < 0.0 { Vector3::new(-1.0, -1.0, 1.0) } else { Vector3::repeat(1.0) };
    let by_rotation = inverse * Matrix3::from_diagonal(&mirror);
    let count = of_joint(segment).len().min(3);
    out.fixed_rows_mut::<3>(0).copy_from(&by_rotation);
    (count..3).for_each(|row| out.row_mut(row).fill(0.0));
    if matches!(segment, BodySegment::UpperArmR | BodySegment::UpperArmL) {
        let [plane, elevation, ..] = angles;
        let (sin, cos) = libm::sincos(plane);
        let flexion = by_rotation.row(1) * sin + by_rotation.row(0) * (elevation * cos);
        let abduction = by_rotation.row(1) * cos - by_rotation.row(0) * (elevation * sin);
        out.row_mut(3).copy_from(&flexion);
        out.row_mut(4).copy_from(&abduction);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::super::angles::joint_rotation;
    use super::*;
    use posed_geometry::so3::exp;

    #[test]
    fn derivatives_are_those_of_central_differences() {
        let h = 1e-6;
        for segment in BodySegment::ALL.into_iter().filter(|segment| *segment != BodySegment::Pelvis) {
            for k in 1..8 {
                let at = |n: f64| libm::sin(1.3 * n * f64::from(k));
                let angles = [1.1 * at(1.0), 0.3 + 0.6 * at(2.0).abs(), 0.9 * at(3.0)];
                let q = joint_rotation(segment, &angles);
                let found = derivative(segment, &q);
                for axis in 0..3 {
                    let moved = |step: f64| {
                        let mut rotation_vector_rad = Vector3::zeros();
                        rotation_vector_rad[axis] = step;
                        joint_angles(segment, &(q * exp(&rotation_vector_rad)))
                    };
                    let (plus, minus) = (moved(h), moved(-h));
                    for row in 0..of_joint(segment).len() {
                        let numeric = (plus[row] - minus[row]) / (2.0 * h);
                        let analytic = found[(row, axis)];
                        assert!(
                            (numeric - analytic).abs() < 1e-5,
                            "{segment:?} {row} {axis}: {numeric} {analytic}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn an_even_rotation_is_an_even_angle_and_a_hanging_arm_has_no_plane() {
        let mut spread = AngleSpread::default();
        let variance = 4e-4;
        spread.set(BodySegment::ShankL, &UnitQuaternion::identity(), &(Matrix3::identity() * variance));
        let knee = of_joint(BodySegment::ShankL).start;
        assert!((spread.sigma_rad[knee] - 0.02).abs() < 1e-12);
        assert_eq!(spread.covariance_rad2[BodySegment::ShankL.index()], [variance, 0.0, 0.0, 0.0, 0.0, 0.0]);
        spread.set(BodySegment::UpperArmR, &UnitQuaternion::identity(), &(Matrix3::identity() * variance));
        let shoulder = of_joint(BodySegment::UpperArmR).start;
        assert!((spread.sigma_rad[shoulder].powi(2) - UNKNOWN_RAD2).abs() < 1e-9, "{spread:?}");
        assert!(spread.covariance_rad2.iter().flatten().all(|value| value.is_finite()));
        // An arm that is raised a little has all of them, and its flexion is as sure as the rotation.
        let raised = joint_rotation(BodySegment::UpperArmR, &[1.5, 0.4, 0.1]);
        spread.set(BodySegment::UpperArmR, &raised, &(Matrix3::identity() * variance));
        assert!((0.02..0.06).contains(&spread.sigma_rad[shoulder]), "{spread:?}");
        assert!((0.019..0.022).contains(&spread.sigma_rad[shoulder + 3]), "{spread:?}");
    }
}
