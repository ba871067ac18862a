//! One IMU of a body: how it sits, its own orientation and its health.
//!
//! In: its samples. Out: how its segment is turned and moves by this sensor alone, and what a calibrated unit is systematically wrong by. It knows no other sensor, but for
//! what hands and feet share with the limbs that they end.

use nalgebra::{UnitQuaternion, Vector3};
use posed_state::Plain;

use super::health::{self, Watch};
use super::moving::Moving;
use super::skeleton::{BodySegment, SEGMENTS};
use super::{HOLD_S, SETTLED_S, SensorMount, yaw_from_upright};
use crate::ahrs::{Ahrs, CALIBRATED_HEADING_RAD, CALIBRATED_TILT_RAD, ImuSample, Params};
use posed_geometry::{GRAVITY_M_S2, so3};

/// Rate at which a heading drifts that the gyro holds where the field is not believed, rad/s.
const DRIFT_RAD_S: f64 = 3e-4;
/// After so long the sensor may have been turned, s.
const AWAY_S: f64 = 0.5;
/// What the first sample after that stands for, s.
const FIRST_S: f64 = 0.01;
/// For so long a sensor that is switched on waits for a specific force within this share of gravity, s: which way is up it learns from the first, and limbs that
/// begin askew find no way back.
const CALM_S: f64 = 1.0;
const CALM: f64 = 0.5;

/// One sensor: how it sits, its own orientation and its health.
#[derive(Clone, Debug, PartialEq, Plain)]
pub(super) struct Sensor {
    pub(super) mount: SensorMount,
    /// How it was said to sit when the body began.
    pub(super) began: SensorMount,
    pub(super) ahrs: Ahrs,
    pub(super) started: bool,
    /// Time since its last sample, s, and what that one stood for.
    pub(super) behind_s: f64,
    pub(super) step_s: f64,
    /// Angular acceleration since the sample before, sensor axes, rad/s²; zero where there was none for a while.
    pub(super) accel_rad_s2: Vector3<f64>,
    /// Time since its first sample, or since it came back, s.
    pub(super) settled_s: f64,
    /// For so long a field is still waited for, s.
    pub(super) patience_s: f64,
    /// Whether its samples carry a field.
    pub(super) magnetometer: bool,
    /// From its level frame to the room, where it has no magnetometer.
    pub(super) heading: UnitQuaternion<f64>,
    pub(super) watch: Watch,
}

impl Sensor {
    /// One that has seen nothing.
    pub(super) fn new(mount: SensorMount, params: &Params) -> Self {
        Self {
            mount,
            began: mount,
            ahrs: Ahrs::new(params.clone()),
            started: false,
            behind_s: 0.0,
            step_s: 0.0,
            accel_rad_s2: Vector3::zeros(),
            settled_s: 0.0,
            patience_s: 0.0,
            magnetometer: false,
            heading: UnitQuaternion::identity(),
            watch: Watch::default(),
        }
    }

    /// Whether it shows its segment now, and has done so for long enough to be held against others.
    pub(super) fn is_settled(&self) -> bool {
        self.settled_s >= SETTLED_S && self.behind_s <= HOLD_S
    }

    /// Whether movements show how it sits: what was given as exact stays.
    pub(super) fn is_learnt(&self) -> bool {
        self.mount.sigma_rad != Vector3::zeros()
    }

    /// What calibrated sensors are systematically wrong by, rms about an axis, rad: the accelerometer's bias tilts, the magnetometer'
    /// iron turns the heading, the gyro's bias for `held_s` while the field is not believed, or without one `drift_rad2`, and its mounting is as good as the calibration was.
    pub(super) fn systematic_rad(&self, held_s: f64, drift_rad2: f64) -> f64 {
        libm::hypot(self.unmounted_rad(held_s, drift_rad2), self.mount.rms_rad()).min(std::f64::consts::PI)
    }

    /// The same without the mounting.
    pub(super) fn unmounted_rad(&self, held_s: f64, drift_rad2: f64) -> f64 {
        let [tilt, heading] = self.lasting_rad2(held_s, drift_rad2);
        ((2.0 * tilt + heading) / 3.0).sqrt().min(std::f64::consts::PI)
    }

    /// The same as variances of a tilt about each level axis and of the heading, rad².
    pub(super) fn lasting_rad2(&self, held_s: f64, drift_rad2: f64) -> [f64; 2] {
        let magnetometer_rad2 = CALIBRATED_HEADING_RAD.powi(2) + (DRIFT_RAD_S * held_s).powi(2);
        let heading = if self.magnetometer { magnetometer_rad2 } else { drift_rad2 };
        [CALIBRATED_TILT_RAD.powi(2), heading]
    }

    pub(super) fn push(&mut self, sample: Option<&ImuSample>, age_s: f64, dt_s: f64) {
        self.watch.sample(sample, dt_s);
        self.behind_s += dt_s;
        self.settled_s = if self.started && self.behind_s <= HOLD_S { self.settled_s + dt_s } else { 0.0 };
        let Some(sample) = sample.filter(|sample| health::usable(sample)) else { return };
        if !self.started && self.behind_s < CALM_S && !is_calm(sample) {
            return;
        }
        let since_s = (self.behind_s - age_s).max(1e-4);
        self.behind_s = age_s;
        self.step_s = since_s;
        if since_s > AWAY_S {
            self.step_s = FIRST_S;
            self.ahrs.resume();
        }
        self.patience_s -= self.step_s;
        self.magnetometer |= sample.mag.is_some();
        let before = self.ahrs.angular_velocity_rad_s();
        self.ahrs.push(sample, self.step_s);
        let changed_rad_s = self.ahrs.angular_velocity_rad_s() - before;
        let follows = self.started && since_s <= HOLD_S;
        self.accel_rad_s2 = if follows { changed_rad_s / self.step_s } else { Vector3::zeros() };
        if !self.started {
            self.started = true;
            if !self.magnetometer {
                let heading = self.mount.heading_rad.unwrap_or_else(|| {
                    let segment = self.ahrs.orientation_6d() * self.mount.q_segment_sensor.inverse();
                    -yaw_from_upright(&segment)
                });
                self.heading = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), heading);
            }
        }
    }

    /// It sits on another segment than was said, there, and as it was found to sit when the body began.
    pub(super) fn reseat(&mut self, offset_m: Vector3<f64>) {
        self.began.offset_m = offset_m;
        self.mount = self.began;
        self.watch = Watch::default();
    }

    /// What was taken for its segment's front is its back.
    pub(super) fn face_back(&mut self) {
        let half = |axis| UnitQuaternion::from_axis_angle(&axis, std::f64::consts::PI);
        self.began.q_segment_sensor = half(Vector3::y_axis()) * self.began.q_segment_sensor;
        self.mount = self.began;
        if !self.magnetometer {
            self.heading = half(Vector3::z_axis()) * self.heading;
        }
    }

    /// Its segment looks so far to the left of the room's x, rad; nothing where a field tells that.
    pub(super) fn look(&mut self, heading_rad: f64) {
        if let (false, Some(q)) = (self.magnetometer, self.orientation()) {
            let turn_rad = heading_rad - yaw_from_upright(&q);
            self.heading = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn_rad) * self.heading;
        }
    }

    /// Segment to room by this sensor alone.
    pub(super) fn orientation(&self) -> Option<UnitQuaternion<f64>> {
        let q_room_sensor = if self.magnetometer {
            self.ahrs.orientation()
        } else {
            self.heading * self.ahrs.orientation_6d()
        };
        // Since its last sample it went on turning as it did.
        let ahead_s = self.behind_s.min(HOLD_S);
        let rotation = UnitQuaternion::from_scaled_axis(self.ahrs.angular_velocity_rad_s() * ahead_s);
        let waits = self.patience_s > 0.0 && !self.ahrs.has_field();
        (self.started && !waits).then(|| q_room_sensor * rotation * self.mount.q_segment_sensor.inverse())
    }

    /// How its segment moves by a sample of this time, if it sits so on it, and the segment is turned so.
    pub(super) fn moving(
        &self,
        sample: &ImuSample,
        q_segment_sensor: &UnitQuaternion<f64>,
        q_room_segment: UnitQuaternion<f64>,
    ) -> Moving {
        Moving {
            q_room_segment,
            angular_velocity_rad_s: q_segment_sensor * (sample.gyro_rad_s - self.ahrs.bias_rad_s()),
            accel_rad_s2: q_segment_sensor * self.accel_rad_s2,
            specific_force_m_s2: q_segment_sensor * sample.accel_m_s2,
        }
    }

    /// What a magnetometer in the sensor would say, sensor axes: north, if the heading is believed at all.
    pub(super) fn north(&self) -> Option<Vector3<f64>> {
        (self.started && self.magnetometer).then(|| self.ahrs.orientation().inverse() * Vector3::y())
    }
}

/// A hand hangs straight on its forearm in a pose, however that one leans: what movements show the forearm's mounting to be wrong by, the hand's is wrong by, too,
/// as far as both go by the pose alone. The same of a foot and its shank.
pub(super) fn share(sensors: &mut [Option<Sensor>; SEGMENTS], lower: BodySegment, end: BodySegment) {
    let Some((mount, began)) = sensors[lower.index()].as_ref().map(|lower| (lower.mount, lower.began)) else {
        return;
    };
    let Some(end) = &mut sensors[end.index()] else { return };
    if began.sigma_rad == Vector3::zeros() || end.began.sigma_rad == Vector3::zeros() {
        return;
    }
    let turned_rad = so3::log(&(mount.q_segment_sensor * began.q_segment_sensor.inverse()));
    let variances = |mount: &SensorMount| mount.sigma_rad.component_mul(&mount.sigma_rad);
    let (known, before, own) = (variances(&mount), variances(&began), variances(&end.began));
    let part = before.zip_map(&own, |lower, end| (lower / end).min(1.0));
    end.mount.q_segment_sensor = so3::exp(&turned_rad.component_mul(&part)) * end.began.q_segment_sensor;
    let shown = (before - known).map(|shown| shown.max(0.0));
    end.mount.sigma_rad = (own - shown.component_mul(&part).component_mul(&part)).map(f64::sqrt);
}

/// Whether its specific force may be gravity's, more or less.
fn is_calm(sample: &ImuSample) -> bool {
    (sample.accel_m_s2.norm() / GRAVITY_M_S2 - 1.0).abs() < CALM
}
