//! Motions by formula.

use std::f64::consts::TAU;

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, Unit, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

/// A body that does not move.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Still {
    /// Where it is, room, m.
    pub position_m: [f64; 3],
    /// How it stands: body to room.
    pub orientation_wxyz: [f64; 4],
}

impl Default for Still {
    fn default() -> Self {
        Self { position_m: [0.5, 0.0, 0.0], orientation_wxyz: [1.0, 0.0, 0.0, 0.0] }
    }
}

impl Still {
    pub(super) fn pose(&self) -> Isometry3<f64> {
        Isometry3::from_parts(self.position_m.into(), quaternion(self.orientation_wxyz))
    }
}

/// A body on a closed curve.
///
/// Axis i of its position is `center + radius * sin(harmonic * 2 pi t / period + phase_i)`, with x a
/// quarter of a turn ahead: harmonics 1, 1, 2 are a circle that bobs twice a round.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Orbit {
    /// Middle of the curve, room, m.
    pub center_m: [f64; 3],
    /// Reach along each axis, m.
    pub radius_m: [f64; 3],
    /// Whole waves of each axis in one period.
    pub harmonics: [u32; 3],
    /// Duration of a round, s.
    pub period_s: f64,
    /// Where on the curve it starts, degrees.
    pub phase_deg: f64,
    /// Orientation in the middle of its turning: body to room.
    pub orientation_wxyz: [f64; 4],
    /// How far it turns about each room axis, degrees.
    pub turn_deg: [f64; 3],
    /// Duration of one turning to and fro, s.
    pub turn_period_s: f64,
}

impl Default for Orbit {
    fn default() -> Self {
        Self {
            center_m: [0.55, 0.0, 0.0],
            radius_m: [0.15, 0.25, 0.1],
            harmonics: [1, 1, 2],
            period_s: 6.0,
            phase_deg: 0.0,
            orientation_wxyz: [1.0, 0.0, 0.0, 0.0],
            turn_deg: [20.0, 20.0, 60.0],
            turn_period_s: 5.0,
        }
    }
}

impl Orbit {
    pub(super) fn pose(&self, t_s: f64) -> Isometry3<f64> {
        let phase = TAU * t_s / self.period_s + self.phase_deg.to_radians();
        let quarter = [0.25 * TAU, 0.0, 0.0];
        let position = Vector3::from_fn(|i, _| {
            self.center_m[i] + self.radius_m[i] * libm::sin(f64::from(self.harmonics[i]) * phase + quarter[i])
        });
        let rotation_vector_rad = Vector3::from_fn(|i, _| {
            let third = i as f64 / 3.0 * TAU;
            self.turn_deg[i].to_radians() * libm::sin(TAU * t_s / self.turn_period_s + third)
        });
        let rotation =
            UnitQuaternion::from_scaled_axis(rotation_vector_rad) * quaternion(self.orientation_wxyz);
        Isometry3::from_parts(position.into(), rotation)
    }
}

/// A body that turns about an axis and advances along it, to and fro.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Screw {
    /// A point of the axis, room, m.
    pub point_m: [f64; 3],
    /// Direction of the axis, room, any length.
    pub axis: [f64; 3],
    /// Distance of the body from the axis, m.
    pub radius_m: f64,
    /// How far it turns, degrees.
    pub angle_deg: f64,
    /// Advance along the axis per full turn, m.
    pub pitch_m_per_turn: f64,
    /// Duration of one turn to and fro, s.
    pub period_s: f64,
}

impl Default for Screw {
    fn default() -> Self {
        Self {
            point_m: [0.5, 0.0, 0.0],
            axis: [0.0, 0.0, 1.0],
            radius_m: 0.1,
            angle_deg: 180.0,
            pitch_m_per_turn: 0.2,
            period_s: 4.0,
        }
    }
}

impl Screw {
    pub(super) fn pose(&self, t_s: f64) -> Isometry3<f64> {
        let axis = Unit::try_new(Vector3::from(self.axis), 1e-9).unwrap_or(Vector3::z_axis());
        let angle = self.angle_deg.to_radians() * 0.5 * (1.0 - libm::cos(TAU * t_s / self.period_s));
        let across = axis.cross(&if axis.x.abs() < 0.9 { Vector3::x() } else { Vector3::y() }).normalize();
        let rotation = UnitQuaternion::from_axis_angle(&axis, angle);
        let position = Vector3::from(self.point_m)
            + axis.into_inner() * (self.pitch_m_per_turn * angle / TAU)
            + rotation * (self.radius_m * across);
        Isometry3::from_parts(position.into(), rotation)
    }
}

/// The elbow exercise of a hanging arm. Segments: `upper_arm`, `forearm`.
///
/// Segment frames: origin at the proximal joint, x forward, y up, z right while the arm hangs straight.
/// Flexion turns the forearm about z, bending positive.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Curl {
    /// The shoulder, room, m.
    pub shoulder_m: [f64; 3],
    /// Where the person looks: 0 is along room x, counter-clockwise positive, degrees.
    pub heading_deg: f64,
    /// Length of the upper arm, m.
    pub upper_arm_m: f64,
    /// Flexion between repetitions, degrees.
    pub straight_deg: f64,
    /// Flexion at the turning point, degrees.
    pub bent_deg: f64,
    /// When the first repetition begins, s.
    pub start_s: f64,
    /// Duration of one repetition, s.
    pub period_s: f64,
    /// Rest between two repetitions, s.
    pub pause_s: f64,
    /// How many; absent: for ever.
    pub repetitions: Option<u32>,
    /// How far the upper arm sways meanwhile, degrees.
    pub sway_deg: f64,
}

impl Default for Curl {
    fn default() -> Self {
        Self {
            shoulder_m: [0.5, 0.0, 0.3],
            heading_deg: 0.0,
            upper_arm_m: 0.3,
            straight_deg: 10.0,
            bent_deg: 130.0,
            start_s: 1.0,
            period_s: 3.0,
            pause_s: 0.5,
            repetitions: None,
            sway_deg: 4.0,
        }
    }
}

impl Curl {
    pub(super) const SEGMENTS: [&'static str; 2] = ["upper_arm", "forearm"];

    /// Elbow flexion at `t_s`, rad.
    fn flexion_rad(&self, t_s: f64) -> f64 {
        let cycle_s = self.period_s + self.pause_s;
        let number = ((t_s - self.start_s) / cycle_s).floor();
        let done = self.repetitions.is_some_and(|n| number >= f64::from(n));
        let bend = if number < 0.0 || done {
            0.0
        } else {
            let s = (t_s - self.start_s - number * cycle_s) / self.period_s;
            smooth_step(2.0 * s) - smooth_step(2.0 * s - 1.0)
        };
        (self.straight_deg + (self.bent_deg - self.straight_deg) * bend).to_radians()
    }

    pub(super) fn pose(&self, segment: usize, t_s: f64) -> Isometry3<f64> {
        let sway = self.sway_deg.to_radians();
        let (forward, sideways) =
            (sway * libm::sin(TAU * t_s / 4.7), 0.5 * sway * libm::sin(TAU * t_s / 6.1));
        let upper = heading(self.heading_deg.to_radians())
            * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), forward)
            * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), sideways);
        let shoulder = Vector3::from(self.shoulder_m);
        if segment == 0 {
            return Isometry3::from_parts(shoulder.into(), upper);
        }
        let elbow = shoulder + upper * Vector3::new(0.0, -self.upper_arm_m, 0.0);
        let forearm = upper * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.flexion_rad(t_s));
        Isometry3::from_parts(elbow.into(), forearm)
    }
}

/// A person who walks around an ellipse.
///
/// Segments: `pelvis`, `torso`, `thigh_r`, `shank_r`, `thigh_l`, `shank_l`; x forward, y up, z right;
/// origins at the middle of the hips (pelvis, torso), the hip, the knee. Harmonic joint angles: it looks
/// like walking to a tracker, not to a physiotherapist.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Walk {
    /// Middle of the ellipse on the floor, room, m.
    pub center_m: [f64; 3],
    /// Half axes along room x and y, m.
    pub radius_m: [f64; 2],
    /// Mean speed, m/s.
    pub speed_m_s: f64,
    /// Length of one step, m.
    pub step_m: f64,
    /// Body height, m.
    pub height_m: f64,
}

impl Default for Walk {
    fn default() -> Self {
        Self { center_m: [0.0, 0.0, -1.0], radius_m: [1.2, 0.8], speed_m_s: 1.0, step_m: 0.6, height_m: 1.75 }
    }
}

impl Walk {
    pub(super) const SEGMENTS: [&'static str; 6] =
        ["pelvis", "torso", "thigh_r", "shank_r", "thigh_l", "shank_l"];

    pub(super) fn pose(&self, segment: usize, t_s: f64) -> Isometry3<f64> {
        let [a, b] = self.radius_m;
        let round = self.speed_m_s * t_s / (0.5 * (a + b)).max(0.1);
        let (sin, cos) = libm::sincos(round);
        // Along the tangent of the ellipse; on the spot, along room x.
        let yaw = if a.min(b) > 0.0 { libm::atan2(b * cos, -a * sin) } else { 0.0 };
        let facing = heading(yaw);
        let phase = TAU * self.speed_m_s * t_s / (2.0 * self.step_m);
        let [hip_height, thigh, half_width] = [0.52, 0.245, 0.055].map(|share| share * self.height_m);
        let bob = 0.02 * libm::cos(2.0 * phase);
        let hips = Vector3::from(self.center_m) + Vector3::new(a * cos, b * sin, hip_height + bob);
        let sway = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), 0.08 * libm::sin(phase));
        let pelvis = Isometry3::from_parts(hips.into(), facing * sway);
        let about_z = |angle: f64| UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle);
        let leg = |side: f64, phase: f64| {
            let hip = Translation3::new(0.0, 0.0, side * half_width);
            pelvis * hip * about_z(0.1 + 0.45 * libm::sin(phase))
        };
        let shank = |thigh_pose: Isometry3<f64>, phase: f64| {
            // The knee bends backwards, most while the leg swings forward.
            let bend = about_z(-(0.1 + 0.5 * (1.0 + libm::cos(phase))));
            thigh_pose * Translation3::new(0.0, -thigh, 0.0) * bend
        };
        let half = 0.5 * TAU;
        match segment {
            0 => pelvis,
            1 => Isometry3::from_parts(hips.into(), facing * sway.inverse()),
            2 => leg(1.0, phase),
            3 => shank(leg(1.0, phase), phase),
            4 => leg(-1.0, phase + half),
            _ => shank(leg(-1.0, phase + half), phase + half),
        }
    }
}

/// Body axes (x forward, y up, z right) of a person who looks `yaw` rad to the left of room x.
fn heading(yaw: f64) -> UnitQuaternion<f64> {
    let upright = Rotation3::from_matrix_unchecked(Matrix3::new(
        1.0, 0.0, 0.0, //
        0.0, 0.0, -1.0, //
        0.0, 1.0, 0.0,
    ));
    UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw) * UnitQuaternion::from_rotation_matrix(&upright)
}

/// 0 below 0, 1 above 1, between them 6 x^5 - 15 x^4 + 10 x^3: twice continuously differentiable.
pub(super) fn smooth_step(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * x * (x * (6.0 * x - 15.0) + 10.0)
}

/// A unit quaternion from (w, x, y, z); the identity when it has no length.
pub(crate) fn quaternion([w, x, y, z]: [f64; 4]) -> UnitQuaternion<f64> {
    UnitQuaternion::try_new(nalgebra::Quaternion::new(w, x, y, z), 1e-9).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn near(a: Vector3<f64>, b: [f64; 3]) -> bool {
        (a - Vector3::from(b)).norm() < 1e-9
    }

    #[test]
    fn a_hanging_arm_points_down_and_a_bent_one_forward() {
        let curl = Curl { straight_deg: 0.0, bent_deg: 90.0, sway_deg: 0.0, ..Curl::default() };
        let hand = Vector3::new(0.0, -0.25, 0.0);
        let at = |t_s| curl.pose(1, t_s) * nalgebra::Point3::from(hand);
        assert!(near(at(0.0).coords, [0.5, 0.0, 0.3 - 0.3 - 0.25]));
        let turning_point_s = 1.0 + 1.5;
        assert!(near(at(turning_point_s).coords, [0.5 + 0.25, 0.0, 0.0]), "{}", at(turning_point_s));
    }

    #[test]
    fn curls_are_counted() {
        let curl = Curl { repetitions: Some(3), ..Curl::default() };
        let bent = |t: &f64| curl.flexion_rad(*t) > 100f64.to_radians();
        let samples: Vec<bool> = (0..3000).map(|i| bent(&(f64::from(i) * 0.01))).collect();
        assert_eq!(samples.windows(2).filter(|pair| !pair[0] && pair[1]).count(), 3);
    }

    #[test]
    fn a_walker_looks_where_it_goes() {
        let walk = Walk::default();
        for i in 0..40 {
            let t_s = f64::from(i) * 0.37;
            let ahead =
                walk.pose(1, t_s + 1e-4).translation.vector - walk.pose(1, t_s - 1e-4).translation.vector;
            let forward = walk.pose(1, t_s).rotation * Vector3::x();
            let cosine = ahead.xy().normalize().dot(&forward.xy().normalize());
            assert!(cosine > 0.99, "{t_s}: {cosine}");
            assert!((walk.pose(1, t_s).rotation * Vector3::y()).z > 0.999_9, "upright");
        }
    }

    #[test]
    fn feet_of_a_walker_stay_near_the_floor_of_the_stage() {
        let walk = Walk::default();
        let ankle = nalgebra::Point3::new(0.0, -0.245 * 1.75, 0.0);
        for i in 0..200 {
            let z = (walk.pose(3, f64::from(i) * 0.02) * ankle).z + 1.0;
            assert!((0.0..0.4).contains(&z), "{z}");
        }
    }
}
