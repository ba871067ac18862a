//! A unit that somebody places in one direction after the other, as the calibration of an IMU asks for.

use std::f64::consts::TAU;

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use super::scripted::smooth_step;

/// The body axis that is up, in their order: six sides, then eight corners; no two that follow one another are opposite.
const UP: [[f64; 3]; 14] = [
    [0.0, 0.0, 1.0],
    [1.0, 0.0, 0.0],
    [0.0, 1.0, 0.0],
    [0.0, 0.0, -1.0],
    [-1.0, 0.0, 0.0],
    [0.0, -1.0, 0.0],
    [1.0, 1.0, 1.0],
    [-1.0, 1.0, 1.0],
    [-1.0, -1.0, 1.0],
    [1.0, -1.0, 1.0],
    [1.0, -1.0, -1.0],
    [1.0, 1.0, -1.0],
    [-1.0, 1.0, -1.0],
    [-1.0, -1.0, -1.0],
];

/// A body that rests on each of its sides and corners in turn, and is turned over between.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct ImuCalibration {
    /// Where it lies, room, m.
    pub position_m: [f64; 3],
    /// How long it rests in each direction, s.
    pub rest_s: f64,
    /// How long each turn takes, s.
    pub turn_s: f64,
    /// How many of the 14 directions are held before it begins again with the first: six sides, then eight corners.
    pub directions: u32,
}

impl Default for ImuCalibration {
    fn default() -> Self {
        Self { position_m: [0.5, 0.0, 0.0], rest_s: 2.5, turn_s: 1.5, directions: UP.len() as u32 }
    }
}

impl ImuCalibration {
    /// Body to room in direction `k`, which also looks another way each time.
    fn lies(k: i64, directions: i64) -> UnitQuaternion<f64> {
        let index = k.rem_euclid(directions) as usize;
        let up = Vector3::from(UP[index]).normalize();
        let about = |axis, angle| UnitQuaternion::from_axis_angle(&axis, angle);
        let upright = UnitQuaternion::rotation_between(&up, &Vector3::z())
            .unwrap_or_else(|| about(Vector3::x_axis(), 0.5 * TAU));
        about(Vector3::z_axis(), 0.29 * TAU * index as f64) * upright
    }

    pub(super) fn pose(&self, t_s: f64) -> Isometry3<f64> {
        let round = t_s / (self.rest_s + self.turn_s);
        let (k, within_s) =
            (round.floor() as i64, round.fract().rem_euclid(1.0) * (self.rest_s + self.turn_s));
        let directions = i64::from(self.directions).clamp(1, UP.len() as i64);
        let (from, to) = (Self::lies(k, directions), Self::lies(k + 1, directions));
        let turned = smooth_step(((within_s - self.rest_s) / self.turn_s).clamp(0.0, 1.0));
        let rotation = UnitQuaternion::from_scaled_axis((from.inverse() * to).scaled_axis() * turned);
        Isometry3::from_parts(self.position_m.into(), from * rotation)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_side_and_corner_is_up_once_in_a_round_and_at_rest() {
        let motion = ImuCalibration::default();
        for (k, up) in UP.into_iter().enumerate() {
            for within_s in [0.1, 2.4] {
                let shown = motion.pose(4.0 * k as f64 + within_s).rotation * Vector3::from(up).normalize();
                assert!((shown - Vector3::z()).norm() < 1e-9, "{up:?} at {within_s}: {shown}");
            }
        }
        assert!(motion.pose(0.3).rotation.angle_to(&motion.pose(56.3).rotation) < 1e-9);
    }
}
