//! The magnetic field of the Earth in the room, and what a script does to it.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// The magnetic field in the room.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct EarthSpec {
    /// Where north is: clockwise from room y (which is north), degrees.
    pub azimuth_deg: f64,
    /// How far the field points down, degrees.
    pub dip_deg: f64,
    /// Strength, in units of the field at the place of calibration.
    pub norm: f64,
    /// Times at which it is another one.
    #[serde(rename = "disturbance")]
    pub disturbances: Vec<DisturbanceSpec>,
}

impl Default for EarthSpec {
    fn default() -> Self {
        Self { azimuth_deg: 0.0, dip_deg: 60.0, norm: 1.0, disturbances: Vec::new() }
    }
}

/// Another magnetic field for a while.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DisturbanceSpec {
    /// When it begins, s.
    pub at_s: f64,
    /// How long it lasts, s.
    pub duration_s: f64,
    /// Time from the one field to the other at either end, within the duration, s.
    #[serde(default = "half")]
    pub ramp_s: f64,
    /// As in `[simulation.earth]`, degrees.
    pub azimuth_deg: f64,
    /// As in `[simulation.earth]`, degrees.
    pub dip_deg: f64,
    /// As in `[simulation.earth]`.
    pub norm: f64,
    /// Names of the sensors that feel it; empty: all.
    #[serde(default)]
    pub sensors: Vec<String>,
}

fn half() -> f64 {
    0.5
}

/// Field in room axes (x east, y north, z up) of an azimuth (clockwise from y), dip and norm.
fn field(azimuth_deg: f64, dip_deg: f64, norm: f64) -> Vector3<f64> {
    let (sin, cos) = libm::sincos(azimuth_deg.to_radians());
    let (down, along) = libm::sincos(dip_deg.to_radians());
    norm * Vector3::new(along * sin, along * cos, -down)
}

impl DisturbanceSpec {
    /// Its share of the field at `t_s`: 0 outside, 1 between the ramps.
    fn share(&self, t_s: f64) -> f64 {
        let inside_s = (t_s - self.at_s).min(self.at_s + self.duration_s - t_s);
        let ramp_s = self.ramp_s.min(0.5 * self.duration_s);
        if inside_s < 0.0 {
            0.0
        } else if inside_s < ramp_s {
            let s = inside_s / ramp_s;
            s * s * (3.0 - 2.0 * s)
        } else {
            1.0
        }
    }
}

impl EarthSpec {
    /// What the sensor of this name feels.
    pub(crate) fn felt_by(&self, sensor: &str) -> Self {
        let felt = |d: &&DisturbanceSpec| d.sensors.is_empty() || d.sensors.iter().any(|name| name == sensor);
        Self { disturbances: self.disturbances.iter().filter(felt).cloned().collect(), ..*self }
    }

    /// Field in room axes at `t_s`, and whether it is disturbed.
    pub(crate) fn field(&self, t_s: f64) -> (Vector3<f64>, bool) {
        let mut result = field(self.azimuth_deg, self.dip_deg, self.norm);
        let mut is_disturbed = false;
        for other in &self.disturbances {
            let share = other.share(t_s);
            result += share * (field(other.azimuth_deg, other.dip_deg, other.norm) - result);
            is_disturbed |= share > 0.0;
        }
        (result, is_disturbed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn north_is_y_and_a_positive_dip_points_down() {
        let earth = EarthSpec { dip_deg: 30.0, norm: 2.0, ..EarthSpec::default() };
        let (b, is_disturbed) = earth.field(0.0);
        assert!((b - Vector3::new(0.0, 3f64.sqrt(), -1.0)).norm() < 1e-12 && !is_disturbed);
        let east = EarthSpec { azimuth_deg: 90.0, dip_deg: 0.0, ..EarthSpec::default() };
        assert!((east.field(0.0).0 - Vector3::x()).norm() < 1e-12);
    }

    #[test]
    fn a_disturbance_comes_and_goes_without_a_jump_for_those_who_feel_it() {
        let other = DisturbanceSpec {
            at_s: 1.0,
            duration_s: 4.0,
            ramp_s: 1.0,
            azimuth_deg: 40.0,
            dip_deg: 10.0,
            norm: 1.5,
            sensors: vec!["a".into()],
        };
        let earth = EarthSpec { disturbances: vec![other], ..EarthSpec::default() };
        let (felt, not) = (earth.felt_by("a"), earth.felt_by("b"));
        assert_eq!(not.field(3.0), (field(0.0, 60.0, 1.0), false));
        let (b, is_disturbed) = felt.field(3.0);
        assert!((b - field(40.0, 10.0, 1.5)).norm() < 1e-12 && is_disturbed);
        assert_eq!(felt.field(0.99), felt.field(5.01));
        let halfway = 0.5 * (field(0.0, 60.0, 1.0) + field(40.0, 10.0, 1.5));
        assert!((felt.field(1.5).0 - halfway).norm() < 1e-12);
        for i in 0..600 {
            let step = felt.field(f64::from(i + 1) * 0.01).0 - felt.field(f64::from(i) * 0.01).0;
            assert!(step.norm() < 0.03, "{i}: {}", step.norm());
        }
    }
}
