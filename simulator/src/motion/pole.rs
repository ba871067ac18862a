//! A pole that an operator waves through a stage.

use std::f64::consts::TAU;

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// A straight pole. Its x axis runs along it, its origin is its middle: sensors sit at `offset_m = [x, 0, 0]`.
///
/// The middle wanders through a box, never twice on the same way; meanwhile the pole goes round, up and down through
/// all directions, and turns slowly about itself.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Pole {
    /// Middle of the box, room, m.
    pub center_m: [f64; 3],
    /// Half of the box along each axis, m.
    pub reach_m: [f64; 3],
    /// About how long the middle takes from one end of the box to the other and back, s.
    pub period_s: f64,
    /// How long the pole takes once around, s.
    pub turn_period_s: f64,
    /// How far up and down it is tilted, degrees.
    pub tilt_deg: f64,
}

impl Default for Pole {
    fn default() -> Self {
        Self {
            center_m: [0.8, 0.0, 0.0],
            reach_m: [0.2, 0.35, 0.25],
            period_s: 6.0,
            turn_period_s: 9.0,
            tilt_deg: 80.0,
        }
    }
}

impl Pole {
    pub(super) fn pose(&self, t_s: f64) -> Isometry3<f64> {
        // Waves whose periods have no common multiple, axis by axis.
        let wave = |rate: f64, phase: f64| libm::sin(TAU * (rate * t_s / self.period_s + phase));
        let position_m = Vector3::from_fn(|axis, _| {
            let rate = [1.0, 1.171, 1.363][axis];
            let way = 0.75 * wave(rate, 0.13 * axis as f64) + 0.25 * wave(2.237 * rate, 0.31);
            self.center_m[axis] + self.reach_m[axis] * way
        });
        let azimuth = TAU * t_s / self.turn_period_s;
        let tilt = self.tilt_deg.to_radians() * libm::sin(TAU * 1.618 * t_s / self.turn_period_s);
        let spin = TAU * 0.29 * t_s / self.turn_period_s;
        let about = |axis, angle| UnitQuaternion::from_axis_angle(&axis, angle);
        let rotation = about(Vector3::z_axis(), azimuth)
            * about(Vector3::y_axis(), -tilt)
            * about(Vector3::x_axis(), spin);
        Isometry3::from_parts(position_m.into(), rotation)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pole_stays_in_its_box_and_is_held_in_all_directions() {
        let pole = Pole::default();
        let mut octants = [0; 8];
        for k in 0..3000 {
            let pose = pole.pose(f64::from(k) * 0.02);
            let off = pose.translation.vector - Vector3::from(pole.center_m);
            assert!((0..3).all(|axis| off[axis].abs() <= pole.reach_m[axis]), "{off}");
            let along = pose.rotation * Vector3::x();
            let bits = along.map(|x| usize::from(x < 0.0));
            octants[bits.x + 2 * bits.y + 4 * bits.z] += 1;
        }
        assert!(octants.iter().all(|seen| *seen > 150), "{octants:?}");
    }
}
