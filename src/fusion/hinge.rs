//! A hinge between two IMUs without magnetometers: their relative heading and the angle.
//!
//! In: the level orientations of the sensors on both sides ([`super::ahrs::Ahrs::orientation_6d`]), whose headings drift
//! apart, and the hinge's axis in each. Out: the angle between them, and the turn about the vertical that makes
//! them agree. It never lets the hinge tilt a sensor: the axis corrects the heading alone.
//!
//! Seen from both sensors the axis must point the same way in the room. Its horizontal part gives the heading
//! between them; where the axis stands upright it gives nothing, and the gyros hold.

use nalgebra::{Matrix2, UnitQuaternion, Vector2, Vector3};
use serde::{Deserialize, Serialize};

/// What the hinge filter assumes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct HingeParams {
    /// How far the axis departs from its place in a sensor (skin, straps, play), rad.
    pub axis_sigma: f64,
    /// Time after which such a departure is another one, s.
    pub axis_tau_s: f64,
    /// Standard deviation of the rate at which the headings drift apart, rad/s.
    pub rate_sigma: f64,
    /// Time in which that rate changes, s.
    pub rate_tau_s: f64,
    /// Drift of the heading beside it, rad per sqrt(s): what bias and scale of a gyro do that is turned to and fro. With the axis'
    /// departures it makes the heading the mean of some eight seconds to either side.
    pub drift: f64,
}

impl Default for HingeParams {
    fn default() -> Self {
        Self {
            axis_sigma: 3_f64.to_radians(),
            axis_tau_s: 0.3,
            rate_sigma: 0.05_f64.to_radians(),
            rate_tau_s: 100.0,
            drift: 0.3_f64.to_radians(),
        }
    }
}

/// A hinge's filter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Hinge {
    params: HingeParams,
    /// Unit axis in the sensor before and the sensor behind the hinge.
    axes: [Vector3<f64>; 2],
    /// Turns both axes to z.
    to_z: [UnitQuaternion<f64>; 2],
    /// Heading of the sensor behind relative to the one before, and its rate.
    x: Vector2<f64>,
    p: Matrix2<f64>,
    started: bool,
}

impl Hinge {
    /// A hinge whose axis (unit, same sign) in the sensors before and behind it is known.
    pub fn new(params: HingeParams, axes: [Vector3<f64>; 2]) -> Self {
        let to_z = axes.map(|axis| {
            UnitQuaternion::rotation_between(&axis, &Vector3::z())
                .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI))
        });
        let sigmas = Vector2::new(std::f64::consts::PI, params.rate_sigma);
        let p = Matrix2::from_diagonal(&sigmas.component_mul(&sigmas));
        Self { params, axes, to_z, x: Vector2::zeros(), p, started: false }
    }

    /// Moves on by `dt_s` and looks at both sensors' level orientations.
    pub fn push(&mut self, before: &UnitQuaternion<f64>, behind: &UnitQuaternion<f64>, dt_s: f64) {
        self.predict(dt_s);
        self.look(before, behind, dt_s);
    }

    /// The transition over `dt_s`.
    fn transition(&self, dt_s: f64) -> Matrix2<f64> {
        Matrix2::new(1.0, dt_s, 0.0, (-dt_s / self.params.rate_tau_s).exp())
    }

    fn predict(&mut self, dt_s: f64) {
        let n = &self.params;
        let f = self.transition(dt_s);
        self.x = f * self.x;
        self.p = f * self.p * f.transpose();
        self.p[(0, 0)] += n.drift.powi(2) * dt_s;
        self.p[(1, 1)] += n.rate_sigma.powi(2) * (1.0 - f[(1, 1)].powi(2));
    }

    fn look(&mut self, before: &UnitQuaternion<f64>, behind: &UnitQuaternion<f64>, dt_s: f64) {
        let n = &self.params;
        let (a, b) = (before * self.axes[0], behind * self.axes[1]);
        let (across, along) = (b.x * a.y - b.y * a.x, b.x * a.x + b.y * a.y);
        let (h2, k2) = (a.x.hypot(a.y).powi(2), b.x.hypot(b.y).powi(2));
        // An axis within some degrees of the vertical has no heading.
        let least = (2.0 * n.axis_sigma).powi(2);
        if h2 < least || k2 < least {
            return;
        }
        let measured = across.atan2(along);
        if !self.started {
            self.started = true;
            self.x[0] = measured;
        }
        self.observe(measured, [h2, k2], dt_s);
    }

    /// The axis was seen at `measured`, with squared horizontal parts `h2` in the two sensors.
    fn observe(&mut self, measured: f64, h2: [f64; 2], dt_s: f64) {
        let n = &self.params;
        let variance = n.axis_sigma.powi(2) * (0.5 / h2[0] + 0.5 / h2[1]);
        let r = variance * (2.0 * n.axis_tau_s / dt_s).max(1.0);
        let innovation = wrap(measured - self.x[0]);
        let s = self.p[(0, 0)] + r;
        // A blow or a slipping strap: what is too far away counts as much as what is just credible.
        let credible = 3.0 * (self.p[(0, 0)] + variance).sqrt();
        let gain = self.p.column(0) / s;
        self.x += gain * innovation.clamp(-credible, credible);
        self.p -= gain * self.p.row(0);
        self.p = (self.p + self.p.transpose()) * 0.5;
    }

    /// The headings of a whole recording, each from all of it: the filter forward, then Rauch, Tung and Striebel's
    /// smoother backward. Needed because an axis that stands upright at the beginning says nothing of the heading until later.
    /// `steps` gives both sensors' level orientations and the time since the step before, s. Result in rad.
    pub fn smooth(
        mut self,
        steps: impl Iterator<Item = (UnitQuaternion<f64>, UnitQuaternion<f64>, f64)>,
    ) -> Vec<f64> {
        // Filtered and predicted state of each step, and the transition into it.
        let mut run: Vec<[(Vector2<f64>, Matrix2<f64>); 2]> = Vec::with_capacity(steps.size_hint().0);
        let mut transitions = Vec::with_capacity(steps.size_hint().0);
        for (before, behind, dt_s) in steps {
            let unseen = !self.started;
            self.predict(dt_s);
            let mut predicted = (self.x, self.p);
            self.look(&before, &behind, dt_s);
            if unseen && self.started {
                // Nothing was known of the heading: the first look counts from its own place, without a jump.
                predicted.0[0] = self.x[0];
                for earlier in &mut run {
                    earlier[0].0[0] = self.x[0];
                    earlier[1].0[0] = self.x[0];
                }
            }
            run.push([predicted, (self.x, self.p)]);
            transitions.push(self.transition(dt_s));
        }
        let Some(mut later) = run.last().map(|step| step[1]) else { return Vec::new() };
        let mut headings = vec![later.0[0]; run.len()];
        for k in (0..run.len() - 1).rev() {
            let (predicted, filtered) = (run[k + 1][0], run[k][1]);
            let Some(inverse) = predicted.1.try_inverse() else {
                later = filtered;
                headings[k] = later.0[0];
                continue;
            };
            let gain = filtered.1 * transitions[k + 1].transpose() * inverse;
            let x = filtered.0 + gain * (later.0 - predicted.0);
            let p = filtered.1 + gain * (later.1 - predicted.1) * gain.transpose();
            later = (x, p);
            headings[k] = x[0];
        }
        headings
    }

    /// Unit axis in the sensor before and the sensor behind the hinge.
    pub fn axes(&self) -> &[Vector3<f64>; 2] {
        &self.axes
    }

    /// Turn about the vertical from the level frame behind the hinge into the one before it.
    pub fn heading(&self) -> UnitQuaternion<f64> {
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.x[0])
    }

    /// Standard deviation of that heading, rad.
    pub fn heading_sigma_rad(&self) -> f64 {
        self.p[(0, 0)].max(0.0).sqrt()
    }

    /// Angle about the axis from the sensor before to the one behind, rad in (-pi, pi]; its zero depends on how the
    /// sensors are mounted.
    pub fn angle_rad(&self, before: &UnitQuaternion<f64>, behind: &UnitQuaternion<f64>) -> f64 {
        self.angle_at_rad(self.x[0], before, behind)
    }

    /// The same with a `heading_rad` from [`Self::smooth`].
    pub fn angle_at_rad(
        &self,
        heading_rad: f64,
        before: &UnitQuaternion<f64>,
        behind: &UnitQuaternion<f64>,
    ) -> f64 {
        let heading = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), heading_rad);
        let relative = before.inverse() * heading * behind;
        let q = self.to_z[0] * relative * self.to_z[1].inverse();
        wrap(2.0 * q.k.atan2(q.w))
    }
}

/// Into (-pi, pi].
pub(crate) fn wrap(angle: f64) -> f64 {
    use std::f64::consts::{PI, TAU};
    let wrapped = angle.rem_euclid(TAU);
    if wrapped > PI { wrapped - TAU } else { wrapped }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::so3;

    #[test]
    fn the_angle_survives_headings_that_drift_apart() {
        let axes = [Vector3::new(0.6, 0.0, 0.8), Vector3::new(0.0, -0.8, 0.6)];
        let mut hinge = Hinge::new(HingeParams::default(), axes);
        let dt = 0.01;
        let mut worst = 0.0_f64;
        for k in 0..6000 {
            let t = dt * f64::from(k);
            let before = so3::exp(&Vector3::new((0.9 * t).sin(), 0.8 * (0.7 * t).cos(), (1.1 * t).sin()));
            let angle = 0.8 + 0.7 * (2.3 * t).sin();
            // Behind: the same axis after the bend, seen from a level frame that drifts by 0.05 deg/s from 40 degrees.
            let bend = hinge.to_z[0].inverse() * so3::exp(&(Vector3::z() * angle)) * hinge.to_z[1];
            let drift = so3::exp(&(Vector3::z() * (0.7 + 0.05_f64.to_radians() * t)));
            let behind = drift * before * bend;
            hinge.push(&before, &behind, dt);
            if t > 10.0 {
                worst = worst.max(wrap(hinge.angle_rad(&before, &behind) - angle).abs().to_degrees());
            }
        }
        assert!(worst < 0.6, "{worst} degrees");
        assert!(hinge.heading_sigma_rad() < 2_f64.to_radians());
    }

    #[test]
    fn an_upright_axis_says_nothing_of_the_heading() {
        let mut hinge = Hinge::new(HingeParams::default(), [Vector3::z(); 2]);
        let before = UnitQuaternion::identity();
        for _ in 0..100 {
            hinge.push(&before, &before, 0.01);
        }
        assert_eq!(hinge.heading_sigma_rad().to_degrees().round(), 180.0);
    }
}
