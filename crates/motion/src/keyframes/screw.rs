//! One screw motion for each segment between key poses, as Merckel and Nishida (2010) animate it (Figs. 12 to 14).
//!
//! What comes in: key poses. What goes out: a [`Screw`] for a segment, the [`ScrewPath`] of a whole recording. What it never does: follow what a segment
//! does between its ends; [`Spline`](super::Spline) does.

use nalgebra::{Isometry3, Point3, Vector3};
use serde::{Deserialize, Serialize};

use super::{Deviation, KeyPose, segment_ends};
use posed_geometry::se3;
use posed_state::Plain;

/// Below this angle a segment is a translation: its axis would be anywhere, rad.
const LEAST_TURN_RAD: f64 = 1e-3;

/// A screw motion: a rotation about an axis, and a translation along it (Chasles).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Plain)]
pub struct Screw {
    /// The point of the axis that is nearest to where the sensor begins, frame of reference, m. Of a translation: where it begins.
    pub axis_point_m: [f64; 3],
    /// Direction of the axis, frame of reference: a unit vector, about which the rotation is positive. Of a translation: its own.
    pub axis_direction: [f64; 3],
    /// How far it turns, 0 to pi, rad.
    pub angle_rad: f64,
    /// How far it goes along the axis, m.
    pub advance_m: f64,
}

impl Screw {
    /// The one from a pose to another by the shorter turn (m; sensor to the frame of reference); `None` where they are the same.
    pub fn between(from: &Isometry3<f64>, to: &Isometry3<f64>) -> Option<Self> {
        let twist = se3::log(&from.inv_mul(to));
        let angle_rad = twist.angular.norm();
        let (point_m, direction, angle_rad) = if angle_rad > LEAST_TURN_RAD {
            let point_m = twist.angular.cross(&twist.linear) / (angle_rad * angle_rad);
            (point_m, twist.angular / angle_rad, angle_rad)
        } else {
            (Vector3::zeros(), twist.linear.try_normalize(f64::MIN_POSITIVE)?, 0.0)
        };
        Some(Self {
            axis_point_m: (from * Point3::from(point_m)).coords.into(),
            axis_direction: (from.rotation * direction).into(),
            angle_rad,
            advance_m: direction.dot(&twist.linear),
        })
    }
}

/// A path of one screw motion per motion segment, between key poses: constant linear and angular velocity in the sensor's axes.
#[derive(Clone, Debug)]
pub struct ScrewPath {
    keys: Vec<(usize, Isometry3<f64>)>,
}

impl ScrewPath {
    /// The path through the recorded key poses and both ends of a recording (m; sensor to the frame of reference), evenly spaced
    /// frames; `None` for fewer than two poses. Key poses outside the recording or out of order are left out.
    pub fn new(poses: &[Isometry3<f64>], keys: &[KeyPose]) -> Option<Self> {
        let ends = segment_ends(poses.len(), keys)?;
        Some(Self { keys: ends.into_iter().map(|(frame, _)| (frame, poses[frame])).collect() })
    }

    /// Pose at a frame, which may lie between two: sensor to the frame of reference, m; the first and the last pose beyond the
    /// ends.
    pub fn pose(&self, frame: f64) -> Isometry3<f64> {
        let after = self.keys.partition_point(|(key, _)| (*key as f64) <= frame);
        let last = after.clamp(1, self.keys.len() - 1);
        let ((from, a), (to, b)) = (self.keys[last - 1], self.keys[last]);
        let s = ((frame - from as f64) / (to - from) as f64).clamp(0.0, 1.0);
        let twist = se3::log(&a.inv_mul(&b));
        a * se3::exp(&se3::Twist { angular: twist.angular * s, linear: twist.linear * s })
    }

    /// First and last frame of each segment that moves, and its screw, in order.
    pub fn screws(&self) -> impl Iterator<Item = ([usize; 2], Screw)> {
        self.keys.windows(2).filter_map(|pair| {
            let ((from, a), (to, b)) = (pair[0], pair[1]);
            Some(([from, to], Screw::between(&a, &b)?))
        })
    }

    /// Root mean square distance from the recording, over some of its frames (both ends included; those beyond it are left out):
    /// m, rad.
    pub fn deviation(&self, poses: &[Isometry3<f64>], frames: std::ops::RangeInclusive<usize>) -> Deviation {
        Deviation::of(|frame| self.pose(frame as f64), poses, frames)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_a_turn_and_a_step_along_an_axis_are_found() {
        // About the vertical line through (1, 0), 0.2 m up.
        let from = Isometry3::new(Vector3::new(2.0, 0.0, 0.5), Vector3::new(0.3, 0.0, 0.0));
        let turned = Isometry3::new(Vector3::new(1.0, 0.0, 0.2), Vector3::new(0.0, 0.0, 1.2))
            * Isometry3::translation(-1.0, 0.0, 0.0);
        let screw = Screw::between(&from, &(turned * from)).unwrap();
        let near = |a: [f64; 3], b: [f64; 3]| (Vector3::from(a) - Vector3::from(b)).norm() < 1e-9;
        assert!(
            near(screw.axis_point_m, [1.0, 0.0, 0.5]) && near(screw.axis_direction, [0.0, 0.0, 1.0]),
            "{screw:?}"
        );
        assert!((screw.angle_rad - 1.2).abs() < 1e-9 && (screw.advance_m - 0.2).abs() < 1e-9, "{screw:?}");
    }

    #[test]
    fn a_translation_has_its_own_axis_and_rest_has_none() {
        let from = Isometry3::new(Vector3::new(2.0, 0.0, 0.5), Vector3::new(0.3, 0.1, 0.0));
        let screw = Screw::between(&from, &(Isometry3::translation(0.0, -0.4, 0.0) * from)).unwrap();
        assert_eq!((screw.axis_point_m, screw.angle_rad), ([2.0, 0.0, 0.5], 0.0));
        assert!((screw.axis_direction[1] + 1.0).abs() < 1e-9 && (screw.advance_m - 0.4).abs() < 1e-9);
        assert_eq!(Screw::between(&from, &from), None);
    }
}
