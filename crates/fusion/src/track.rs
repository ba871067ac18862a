//! The error-state filter of one magnetic sensor without inertial measurements.

use nalgebra::{Matrix3, Matrix6, UnitQuaternion, Vector3};
use posed_geometry::Timestamp;
use posed_state::Plain;

use super::half::Half;
use super::level::NoiseLevel;
use crate::faults::{MeasuredPose, Prediction, squared_distance};
use crate::noise::TrackerNoise;
use posed_geometry::so3;

/// How the filter expects a sensor to move; effects of each number in `docs/methods/magnetic-pose.md`.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub struct Tuning {
    /// Least and greatest root-mean-square acceleration, m/s². The filter moves between them by its innovations: slow motion
    /// is smoothed, fast motion followed.
    pub acceleration_m_s2: [f64; 2],
    /// The same for angular acceleration, rad/s².
    pub angular_acceleration_rad_s2: [f64; 2],
    /// Velocity of a sensor that has just appeared (standard deviation per axis), m/s.
    pub velocity_m_s: f64,
    /// The same for angular velocity, rad/s.
    pub angular_velocity_rad_s: f64,
    /// Greatest factor on the noise model's variances that the filter may learn, at least 1; 1 where the model is measured.
    pub noise_scale_max: f64,
    /// Nominal interval of the measurements, s; a [`Tracker`](crate::Tracker) holds it within 1 ms to 0.2 s.
    pub interval_s: f64,
    /// Variance that the field map leaves of a measured position, per axis, m²: joins its noise.
    pub position_doubt_m2: f64,
    /// The field is disturbed: nothing is learnt about the noise.
    pub disturbed: bool,
}

impl Default for Tuning {
    /// Limbs: 3 m/s and 30 m/s^2 at the hand, ten times that about the wrist's axes.
    fn default() -> Self {
        Self {
            acceleration_m_s2: [10.0, 60.0],
            angular_acceleration_rad_s2: [60.0, 600.0],
            velocity_m_s: 1.5,
            angular_velocity_rad_s: 6.0,
            noise_scale_max: 1000.0,
            interval_s: 0.01,
            position_doubt_m2: 0.0,
            disturbed: false,
        }
    }
}

/// Longest innovation that one record is believed, m and rad, at 100 Hz: what a flipped bit may cost at most.
const REACH_M: f64 = 0.02;
const REACH_RAD: f64 = 0.08;
/// Share of an interval by which records may be out of step when noise is learnt from them.
const IN_STEP: f64 = 0.2;
/// Interval that the reach is given for, s; it grows with the square, as accelerated motion does.
const REACH_INTERVAL_S: f64 = 0.0105;

/// A sensor's motion: position and velocity in the transmitter frame, orientation, angular velocity in sensor
/// axes, each with the covariance of its error.
///
/// Nominal state: `p, v, R, w`; error state: `p + dp, v + dv, R exp(dtheta), w + dw`, 12 in all, in two
/// uncoupled halves. Constant velocity and constant angular velocity, driven by white (angular) acceleration.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub struct Track {
    t: Timestamp,
    position_m: Vector3<f64>,
    velocity_m_s: Vector3<f64>,
    orientation: UnitQuaternion<f64>,
    angular_velocity_rad_s: Vector3<f64>,
    translation: Half,
    rotation: Half,
    has: Halves,
    adaptation: Adaptation,
}

/// Which halves of a pose the format carries.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Plain)]
struct Halves {
    position: bool,
    orientation: bool,
}

/// What the measurements have taught.
///
/// Innovations that are larger than expected and keep their direction mean more motion than the model has; the
/// acceleration is raised at once, for a lag is worse than a loss of smoothing.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
struct Adaptation {
    acceleration2: f64,
    angular_acceleration2: f64,
    position_noise: NoiseLevel,
    rotation_noise: NoiseLevel,
    last_innovation_m: Vector3<f64>,
    last_innovation_rad: Vector3<f64>,
    /// The latest measurement, and when it was.
    last_pose: MeasuredPose,
    last_t: Timestamp,
}

impl Track {
    /// A track that begins with a measurement: its pose with the noise model's covariance, velocities zero with the standard
    /// deviations of `tuning`. A half that the format does not carry is never given out as a position or an orientation.
    pub fn new(t: Timestamp, pose: &MeasuredPose, noise: &TrackerNoise, tuning: &Tuning) -> Self {
        let position_m = pose.position_m.unwrap_or_default();
        let position_m2 = pose.position_m.map_or(Matrix3::identity(), |p| noise.position_m2(&p));
        let rotation_rad2 = noise.rotation_rad2(pose.position_m.as_ref());
        Self {
            t,
            position_m,
            velocity_m_s: Vector3::zeros(),
            orientation: pose.orientation.unwrap_or_default(),
            angular_velocity_rad_s: Vector3::zeros(),
            translation: Half::new(&position_m2, tuning.velocity_m_s),
            rotation: Half::new(&rotation_rad2, tuning.angular_velocity_rad_s),
            has: Halves { position: pose.position_m.is_some(), orientation: pose.orientation.is_some() },
            adaptation: Adaptation {
                acceleration2: middle(tuning.acceleration_m_s2),
                angular_acceleration2: middle(tuning.angular_acceleration_rad_s2),
                position_noise: NoiseLevel::new(),
                rotation_noise: NoiseLevel::new(),
                last_innovation_m: Vector3::zeros(),
                last_innovation_rad: Vector3::zeros(),
                last_pose: *pose,
                last_t: t,
            },
        }
    }

    /// Time of the state, on the clock of the measurements.
    pub fn t(&self) -> Timestamp {
        self.t
    }

    /// Position in the transmitter frame, m; `None` where the format has none.
    pub fn position_m(&self) -> Option<&Vector3<f64>> {
        self.has.position.then_some(&self.position_m)
    }

    /// Orientation, sensor to transmitter; `None` where the format has none.
    pub fn orientation(&self) -> Option<&UnitQuaternion<f64>> {
        self.has.orientation.then_some(&self.orientation)
    }

    /// Velocity in the transmitter frame, m/s; zero where the format has no position.
    pub fn velocity_m_s(&self) -> &Vector3<f64> {
        &self.velocity_m_s
    }

    /// Angular velocity in sensor axes, rad/s; zero where the format has no orientation.
    pub fn angular_velocity_rad_s(&self) -> &Vector3<f64> {
        &self.angular_velocity_rad_s
    }

    /// Covariance of the position's error in the transmitter frame, m², 3 x 3. It holds noise and motion, not what the field
    /// map leaves for good. Too small where the device's own filters correlate its noise (`docs/methods/magnetic-pose.md`).
    pub fn position_m2(&self) -> Matrix3<f64> {
        self.translation.error()
    }

    /// Covariance of the orientation's error, rad², 3 x 3, sensor axes: the true orientation is `orientation * exp(error)`.
    pub fn rotation_rad2(&self) -> Matrix3<f64> {
        self.rotation.error()
    }

    /// The track moved to `t` at constant velocity and angular velocity, its covariance with it where `t` is later. Where `t` is
    /// earlier the covariance stays: that is for the few milliseconds by which a measurement may follow the time it is wanted
    /// for. How far either may go is for the caller to say.
    pub fn predicted(&self, t: Timestamp, tuning: &Tuning) -> Self {
        let dt = t.seconds_since(self.t);
        if dt == 0.0 {
            return *self;
        }
        let mut next = *self;
        next.t = t;
        next.position_m += self.velocity_m_s * dt;
        next.orientation = self.orientation * so3::exp(&(self.angular_velocity_rad_s * dt));
        // Products of unit quaternions drift from unit length by rounding.
        next.orientation.renormalize_fast();
        if dt > 0.0 {
            let density = self.adaptation.acceleration2 * tuning.interval_s;
            next.translation.predict(&translation_transition(dt), density, dt);
            let density = self.adaptation.angular_acceleration2 * tuning.interval_s;
            next.rotation.predict(&rotation_transition(&self.angular_velocity_rad_s, dt), density, dt);
        }
        next
    }

    /// What this (predicted) track expects of a measurement at its time, transmitter frame: for the fault detector and the
    /// gate.
    pub fn expectation(&self, tuning: &Tuning) -> Prediction {
        let stretch = (tuning.interval_s / REACH_INTERVAL_S).max(1.0).powi(2);
        Prediction {
            position_m: self.position_m,
            orientation: self.orientation,
            position_m2: self.translation.error(),
            rotation_rad2: self.rotation.error(),
            position_noise_scale: self.adaptation.position_noise.scale(),
            rotation_noise_scale: self.adaptation.rotation_noise.scale(),
            position_doubt_m2: tuning.position_doubt_m2,
            reach_m: REACH_M * stretch,
            reach_rad: REACH_RAD * stretch,
        }
    }

    /// Takes a measurement at the track's own time, ungated, and learns noise and acceleration from it. A half whose
    /// innovation covariance cannot be inverted stays as it is; `pose` must be finite, transmitter frame.
    pub fn update(&mut self, pose: &MeasuredPose, noise: &TrackerNoise, tuning: &Tuning) {
        self.learn_noise(pose, noise, tuning);
        let expected = self.expectation(tuning);
        let learnt = &mut self.adaptation;
        if let Some(position) = &pose.position_m {
            let innovation = expected.position_innovation(position);
            let r = noise.position_m2(&self.position_m) * expected.position_noise_scale
                + Matrix3::identity() * tuning.position_doubt_m2;
            let nis = squared_distance(&(self.translation.error() + r), &innovation) / 3.0;
            let along = innovation.dot(&learnt.last_innovation_m);
            adapt(&mut learnt.acceleration2, tuning.acceleration_m_s2, nis, along);
            learnt.last_innovation_m = innovation;
            if let Some((error, velocity_m_s)) = self.translation.update(&innovation, &r) {
                self.position_m += error;
                self.velocity_m_s += velocity_m_s;
            }
        }
        if let Some(orientation) = &pose.orientation {
            let innovation = expected.rotation_innovation(orientation);
            let position_m = self.has.position.then_some(&self.position_m);
            let r = noise.rotation_rad2(position_m) * expected.rotation_noise_scale;
            let nis = squared_distance(&(self.rotation.error() + r), &innovation) / 3.0;
            let along = innovation.dot(&learnt.last_innovation_rad);
            adapt(&mut learnt.angular_acceleration2, tuning.angular_acceleration_rad_s2, nis, along);
            learnt.last_innovation_rad = innovation;
            if let Some((error, angular_velocity_rad_s)) = self.rotation.update(&innovation, &r) {
                self.orientation *= so3::exp(&error);
                self.orientation.renormalize_fast();
                self.angular_velocity_rad_s += angular_velocity_rad_s;
                self.rotation.reset(&so3::right_jacobian(&error));
            }
        }
    }

    /// Holds the measurement against those before it; only records in step tell noise from motion.
    fn learn_noise(&mut self, pose: &MeasuredPose, noise: &TrackerNoise, tuning: &Tuning) {
        let learnt = &mut self.adaptation;
        let steps = self.t.seconds_since(learnt.last_t) / tuning.interval_s;
        if (steps - 1.0).abs() > IN_STEP || tuning.disturbed {
            learnt.position_noise.interrupt();
            learnt.rotation_noise.interrupt();
        } else {
            let max = tuning.noise_scale_max;
            if let (Some(before), Some(now)) = (&learnt.last_pose.position_m, &pose.position_m) {
                learnt.position_noise.push(&(now - before), &noise.position_m2(now), max);
            }
            if let (Some(before), Some(now)) = (&learnt.last_pose.orientation, &pose.orientation) {
                let step = so3::log(&(before.inverse() * now));
                let model = noise.rotation_rad2(pose.position_m.as_ref());
                learnt.rotation_noise.push(&step, &model, max);
            }
        }
        learnt.last_pose = *pose;
        learnt.last_t = self.t;
    }
}

/// Quick up, slowly down: being late with the first costs a lag, with the second some smoothing.
fn adapt(acceleration2: &mut f64, range: [f64; 2], nis: f64, along: f64) {
    if nis > 1.0 && along >= 0.0 {
        *acceleration2 *= 1.0 + 0.5 * (nis - 1.0).min(4.0);
    } else if nis < 1.0 {
        *acceleration2 *= 1.0 - 0.04 * (1.0 - nis);
    }
    *acceleration2 = acceleration2.clamp(range[0] * range[0], range[1] * range[1]);
}

/// Square of the geometric mean.
fn middle(range: [f64; 2]) -> f64 {
    range[0] * range[1]
}

/// `dp' = dp + dt dv, dv' = dv`.
fn translation_transition(dt_s: f64) -> Matrix6<f64> {
    let mut f = Matrix6::identity();
    f.fixed_view_mut::<3, 3>(0, 3).fill_diagonal(dt_s);
    f
}

/// `dtheta' = exp(-w dt) dtheta + J_r(w dt) dt dw, dw' = dw`.
fn rotation_transition(w_rad_s: &Vector3<f64>, dt_s: f64) -> Matrix6<f64> {
    let step = w_rad_s * dt_s;
    let mut f = Matrix6::identity();
    f.fixed_view_mut::<3, 3>(0, 0).copy_from(so3::exp(&-step).to_rotation_matrix().matrix());
    f.fixed_view_mut::<3, 3>(0, 3).copy_from(&(so3::right_jacobian(&step) * dt_s));
    f
}

#[cfg(test)]
#[path = "track_tests.rs"]
mod tests;
