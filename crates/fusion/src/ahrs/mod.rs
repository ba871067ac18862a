//! Orientation of a single IMU, causally, with or without a magnetometer.
//!
//! In: rate gyro, accelerometer and (optionally) magnetometer samples of one sensor, each with the time since
//! the one before. Out: sensor to room, after every sample. It never looks ahead (but for [`smoothed`]), never lets the magnetometer
//! tilt the result, and never allocates.
//!
//! ```text
//! gyro - bias ──> strapdown ──> q_level_sensor ────────────────┐
//!                  │  ^ tilt, bias                             ├──> q_room_sensor
//!                  v  │ every `window_s`                       │
//! accel ──> inclination.rs: tilt, gyro bias, velocity          │
//! mag ────> heading.rs: field, disturbance, magnet on the sensor, lag ──> heading
//! rest.rs: is it lying still?
//! smooth.rs: a whole recording, back and forth
//! ```
//! As in Laidig & Seel, "VQF: Highly accurate IMU orientation estimation with bias estimation and magnetic
//! disturbance rejection" (2023), inclination and heading are decoupled: the strapdown runs in a frame that is
//! kept level by gravity and drifts about the vertical, and one angle turns it to north. Where VQF low-passes
//! the specific force and steers the heading by azimuth, both are Kalman filters here, whose states say what
//! a low-pass cannot: a hand's acceleration must integrate to a bounded velocity, and a magnet
//! attached to the sensor turns with it while the earth's field does not.

mod heading;
mod inclination;
mod rest;
mod smooth;
#[cfg(test)]
mod tests;

use crate::faults::ImuWords;
use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector2, Vector3};
use posed_geometry::GRAVITY_M_S2;
use posed_state::Plain;
use serde::{Deserialize, Serialize};

pub use heading::HeadingParams;
pub use inclination::InclinationParams;
pub use rest::RestParams;
pub use smooth::smoothed;

/// Error of tilt that a calibrated accelerometer leaves about each level axis, rad: 0.03 m/s² of gravity. Not in
/// [`Ahrs::rotation_rad2`], for it does not average out.
pub const CALIBRATED_TILT_RAD: f64 = 0.003;
/// Error of heading that a calibrated magnetometer leaves, rad: 0.5 uT of the 20 uT that lie level. Not in
/// [`Ahrs::rotation_rad2`], for it does not average out.
pub const CALIBRATED_HEADING_RAD: f64 = 0.025;
/// A sample so long after the one before leaves a gap, s.
const GAP_S: f64 = 0.05;
/// Without a sample the last rate goes on for so long, s.
const COAST_S: f64 = 0.1;
/// Who is switched on in the middle of a movement does not know which way is up, and learns it within this time, s; tilts by more than this in it begin the
/// heading anew, rad.
const LEVELS_S: f64 = 5.0;
const LEVELLED_RAD: f64 = 0.1;
/// After so long without a sample the sensor may have been turned anyhow, s.
const AWAY_S: f64 = 0.5;
/// What an angular velocity that changed by 1 rad/s in a gap of 1 s turned besides its mean, rad: a swing whose phase goes on
/// by 1 rad in the gap leaves a twelfth.
const BRIDGED: f64 = 0.1;

/// What the filter assumes; the defaults are one set for all sensors of MEMS class. Effect of each:
/// `docs/methods/orientation.md`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Plain)]
pub struct Params {
    /// The Kalman filters run once per window of this length, s, above 0; the strapdown runs on every sample.
    pub window_s: f64,
    /// How far the gyro's samples lag behind their time stamps (its low-pass), s: the published orientation is
    /// carried forward by that much.
    pub gyro_delay_s: f64,
    /// What a sample is of the time since the one before it.
    pub sampling: Sampling,
    /// Tilt and gyro bias.
    pub inclination: InclinationParams,
    /// Magnetic heading.
    pub heading: HeadingParams,
    /// Rest detection.
    pub rest: RestParams,
}

impl Default for Params {
    fn default() -> Self {
        Self {
            window_s: 0.028,
            gyro_delay_s: 0.0,
            sampling: Sampling::default(),
            inclination: InclinationParams::default(),
            heading: HeadingParams::default(),
            rest: RestParams::default(),
        }
    }
}

impl Params {
    /// The defaults, for samples that hold at their time stamps: so the pipeline stamps them, and so limbs take them.
    pub fn instantaneous() -> Self {
        Self { sampling: Sampling::Instantaneous, ..Self::default() }
    }
}

/// What the angular velocity of a sample is of the interval since the sample before. Taken for the other one, an orientation is wrong by what the sensor
/// turns in half an interval.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Plain)]
#[serde(rename_all = "lowercase")]
pub enum Sampling {
    /// Its mean, so that it times the interval is what the sensor turned: units that integrate inside; published filters assume it.
    #[default]
    Mean,
    /// Its value at the end, the time stamp.
    Instantaneous,
}

/// One sample of an IMU, in sensor axes, corrected by its [`crate::intrinsics`] where those are known.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Plain)]
pub struct ImuSample {
    /// Angular velocity, rad/s.
    pub gyro_rad_s: Vector3<f64>,
    /// Specific force, m/s² (+g on the axis that points up, at rest).
    pub accel_m_s2: Vector3<f64>,
    /// Magnetic field in any unit of constant scale; `None`: hold the heading by the gyro. Zero and what is not finite count
    /// as `None`.
    pub mag: Option<Vector3<f64>>,
}

impl ImuSample {
    /// Gyro and accelerometer, by which [`crate::faults`] detects whether the unit repeats itself.
    pub fn words(&self) -> ImuWords {
        ImuWords { angular_velocity_rad_s: self.gyro_rad_s, acceleration_m_s2: Some(self.accel_m_s2) }
    }
}

/// Orientation filter of one IMU, causal and without delay; inclination and heading are decoupled as in Laidig & Seel (2023).
/// Method: `docs/methods/orientation.md`; accuracy beside VQF, and what the covariance is worth: `docs/orientation.md`.
#[derive(Clone, Debug, PartialEq, Plain)]
pub struct Ahrs {
    params: Params,
    /// Sensor to the level frame: z up, heading free.
    q_level_sensor: UnitQuaternion<f64>,
    started: bool,
    /// The last angular velocity without its bias, rad/s.
    angular_velocity_rad_s: Vector3<f64>,
    /// Time without a sample since the last one, s.
    coasted_s: f64,
    window: Window,
    inclination: inclination::Inclination,
    heading: heading::Heading,
    /// Since the first sample, or since it was levelled anew, s.
    levelled_s: f64,
    /// By how much the tilt has been corrected since the heading began, in that time, rad.
    levelled_rad: Vector2<f64>,
    rest: rest::Rest,
    /// Whether a rest has shown the bias.
    rested: bool,
    /// What a rest has proven to be bias though it was more than a calibrated unit has, rad/s; taken off every sample.
    offset_rad_s: Vector3<f64>,
    /// Samples refused because a number in them was not finite.
    rejected: u64,
}

/// Sums over the running window; level frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Plain)]
struct Window {
    duration_s: f64,
    /// Integral of the rotation matrix, s.
    rotation_s: Matrix3<f64>,
    /// Integral of the specific force, m/s.
    velocity_m_s: Vector3<f64>,
    /// Integral of the squared departure of the specific force from gravity, m²/s³.
    shaking: f64,
    /// Integral of |angular velocity|, rad.
    turned_rad: f64,
    /// Variance of what it may have turned besides between samples far apart, rad².
    bridged_rad2: f64,
    mag_samples: u32,
    /// Sum of field samples.
    mag: Vector3<f64>,
    /// Sum of (angular velocity x field): what one second of magnetometer lag would add.
    mag_lag: Vector3<f64>,
    /// Sum of rotation matrices at the field samples.
    mag_rotation: Matrix3<f64>,
}

impl Ahrs {
    /// A filter that has seen nothing; the first sample levels it, the first field gives the heading.
    pub fn new(params: Params) -> Self {
        Self {
            q_level_sensor: UnitQuaternion::identity(),
            started: false,
            angular_velocity_rad_s: Vector3::zeros(),
            coasted_s: 0.0,
            window: Window::default(),
            inclination: inclination::Inclination::new(&params.inclination),
            heading: heading::Heading::new(&params.heading),
            levelled_s: 0.0,
            levelled_rad: Vector2::zeros(),
            rest: rest::Rest::default(),
            rested: false,
            offset_rad_s: Vector3::zeros(),
            rejected: 0,
            params,
        }
    }

    /// Takes one sample, `dt_s` seconds after the one before, and returns sensor to room as [`Self::orientation`]. The first
    /// sample levels the orientation; a `dt_s` above 0.5 s counts as 0.5 s.
    ///
    /// Over a gap the angular velocity is taken to have gone evenly from the one to the other, and tilt and heading are the
    /// less sure the more it changed; otherwise the gyro's bias would pay for what was missed.
    ///
    /// A sample with a number that is not finite (or a `dt_s` that is not positive) changes nothing but [`Self::rejected`].
    pub fn push(&mut self, sample: &ImuSample, dt_s: f64) -> UnitQuaternion<f64> {
        if self.coasted_s > AWAY_S {
            self.resume();
        }
        if self.advance(sample, dt_s) {
            self.close_window();
        }
        self.orientation()
    }

    /// Takes one sample into the window; returns whether that is full.
    fn advance(&mut self, sample: &ImuSample, dt_s: f64) -> bool {
        let mag = sample.mag.filter(|m| m.iter().all(|v| v.is_finite()) && m.norm_squared() > 0.0);
        let finite = sample.gyro_rad_s.iter().chain(sample.accel_m_s2.iter()).all(|v| v.is_finite());
        if !finite || !dt_s.is_finite() || dt_s <= 0.0 {
            self.rejected += 1;
            return false;
        }
        let dt_s = dt_s.min(0.5);
        let goes_on = self.started;
        if !goes_on {
            self.start(sample.accel_m_s2, mag);
        }
        let gyro = sample.gyro_rad_s - self.offset_rad_s;
        self.rest.push(&self.params.rest, gyro, sample.accel_m_s2, mag, dt_s);

        let angular_velocity_rad_s = gyro - self.inclination.bias_rad_s();
        let before = std::mem::replace(&mut self.angular_velocity_rad_s, angular_velocity_rad_s);
        let coasted_s = std::mem::take(&mut self.coasted_s);
        let since_s = coasted_s + dt_s;
        if goes_on && since_s > GAP_S {
            let coasted_rad = before * coasted_s.min(COAST_S);
            let turned_rad = 0.5 * (before + angular_velocity_rad_s) * since_s - coasted_rad;
            self.q_level_sensor = integrate(self.q_level_sensor, turned_rad, 1.0);
            self.window.bridged_rad2 +=
                (BRIDGED * since_s).powi(2) * (angular_velocity_rad_s - before).norm_squared();
        } else {
            let over_step_rad_s = match self.params.sampling {
                Sampling::Instantaneous if goes_on => 0.5 * (before + angular_velocity_rad_s),
                _ => angular_velocity_rad_s,
            };
            self.q_level_sensor = integrate(self.q_level_sensor, over_step_rad_s, dt_s);
        }
        let rotation = self.q_level_sensor.to_rotation_matrix();
        let rotation = rotation.matrix();
        let specific_force_m_s2 = rotation * sample.accel_m_s2;
        let w = &mut self.window;
        w.duration_s += dt_s;
        w.rotation_s += rotation * dt_s;
        w.velocity_m_s += specific_force_m_s2 * dt_s;
        w.shaking += dt_s * (specific_force_m_s2 - Vector3::z() * GRAVITY_M_S2).norm_squared();
        w.turned_rad += angular_velocity_rad_s.norm() * dt_s;
        if let Some(mag) = mag {
            w.mag_samples += 1;
            w.mag += rotation * mag;
            w.mag_lag += rotation * angular_velocity_rad_s.cross(&mag);
            w.mag_rotation += rotation;
        }
        w.duration_s >= self.params.window_s - 1e-9
    }

    /// Back to the beginning of the same recording, keeping the gyro bias that it showed and what is known of it; field, rest
    /// and motion are forgotten.
    pub fn restart(&mut self) {
        self.inclination.forget_motion();
        self.started = false;
        self.coasted_s = 0.0;
        self.window = Window::default();
        self.rest = rest::Rest::default();
        self.heading = heading::Heading::new(&self.params.heading);
    }

    /// Moves on by `dt_s`, s, without a sample: the last rate goes on for at most a tenth of a second, then it holds. The
    /// next sample, if it comes within half a second, bridges all of that; after longer it levels anew, as after
    /// [`Self::resume`]. A `dt_s` that is not positive changes nothing.
    pub fn coast(&mut self, dt_s: f64) {
        if self.started && dt_s > 0.0 && dt_s.is_finite() {
            let step_s = dt_s.min((COAST_S - self.coasted_s).max(0.0));
            self.coasted_s += dt_s;
            self.q_level_sensor = integrate(self.q_level_sensor, self.angular_velocity_rad_s, step_s);
        }
    }

    /// Prepares for samples after a silence in which the sensor may have been turned.
    ///
    /// The next sample levels the orientation anew and the next field sample gives the heading, both at once; without a
    /// magnetometer the heading stays. The gyro's bias is kept.
    pub fn resume(&mut self) {
        self.started = false;
        self.coasted_s = 0.0;
        self.window = Window::default();
        self.rest = rest::Rest::default();
        self.inclination.forget_motion();
        self.heading.resume(&self.params.heading);
    }

    /// Forgets all that was seen, the gyro's bias too; the parameters stay.
    pub fn forget(&mut self) {
        *self = Self::new(self.params.clone());
    }

    /// The latest angular velocity without its bias, rad/s, sensor axes; zero before the first sample.
    pub fn angular_velocity_rad_s(&self) -> Vector3<f64> {
        self.angular_velocity_rad_s
    }

    /// Sensor to room: z up, and x east, y (magnetic) north where there is a magnetometer; without one the heading starts at
    /// 0 and drifts. Carried forward by [`Params::gyro_delay_s`]. The identity before the first sample.
    pub fn orientation(&self) -> UnitQuaternion<f64> {
        let half = 0.5 * self.heading.offset_rad();
        let north =
            UnitQuaternion::new_unchecked(Quaternion::new(libm::cos(half), 0.0, 0.0, libm::sin(half)));
        north * self.orientation_6d()
    }

    /// Sensor to the level frame: z up, heading of the gyro alone, which drifts; carried forward by [`Params::gyro_delay_s`].
    /// Until a field was seen it equals [`Self::orientation`].
    pub fn orientation_6d(&self) -> UnitQuaternion<f64> {
        integrate(self.q_level_sensor, self.angular_velocity_rad_s, self.params.gyro_delay_s)
    }

    /// Covariance of the error of [`Self::orientation`], rad², 3 x 3, sensor axes: the true orientation is
    /// `orientation * exp(error)`. How far it is right: `docs/orientation.md`.
    ///
    /// It is the filters' own: tilt from the one, heading from the other, which do not know of one another, so that the two
    /// are uncoupled about level axes. It holds what the filters' models hold (noise, gyro bias and scale, acceleration of
    /// the body, disturbance and lag of the field), and not what a calibration has left in accelerometer and magnetometer
    /// ([`CALIBRATED_TILT_RAD`], [`CALIBRATED_HEADING_RAD`]). Until a field has given the heading, that may be any.
    pub fn rotation_rad2(&self) -> Matrix3<f64> {
        let mut level = Matrix3::zeros();
        level.fixed_view_mut::<2, 2>(0, 0).copy_from(&self.inclination.tilt_rad2());
        level[(2, 2)] = self.heading.variance_rad2();
        let rotation = self.orientation_6d().to_rotation_matrix().into_inner();
        rotation.transpose() * level * rotation
    }

    /// Standard deviation of the gyro's bias about the vertical, rad/s: so fast a heading that no field identifies may drift.
    pub fn heading_rate_sigma_rad_s(&self) -> f64 {
        self.inclination.bias_sigma_rad_s(&(self.q_level_sensor.inverse() * Vector3::z()))
    }

    /// Estimated gyro bias, rad/s, sensor axes; what is known of it at first: standard deviation
    /// [`InclinationParams::bias_initial_rad_s`].
    pub fn bias_rad_s(&self) -> Vector3<f64> {
        self.offset_rad_s + self.inclination.bias_rad_s()
    }

    /// The gyro bias of a unit that nobody has calibrated, as a rest has proven it, rad/s, sensor axes; zero where the bias never was
    /// more than a calibrated unit has.
    pub fn offset_rad_s(&self) -> Vector3<f64> {
        self.offset_rad_s
    }

    /// Whether the sensor lies still, by [`RestParams`]: true after 1.5 s of stillness by default, false from the first
    /// sample that moves.
    pub fn at_rest(&self) -> bool {
        self.rest.at_rest()
    }

    /// Whether a field has given the heading since the filter began, or since [`Self::resume`] or [`Self::restart`].
    pub fn has_field(&self) -> bool {
        self.heading.begun()
    }

    /// Whether the field differs from the earth's at present; the heading then holds by the gyro. A jump shows after some
    /// tenths of a second. False where no field was seen.
    pub fn magnetic_disturbance(&self) -> bool {
        self.heading.disturbed()
    }

    /// Estimated field of a magnet attached to the sensor, sensor axes, in the unit of the samples; zero before a field was
    /// seen.
    pub fn magnet(&self) -> Vector3<f64> {
        self.heading.magnet()
    }

    /// Samples refused so far because a number in them was not finite or their interval was not positive.
    pub fn rejected(&self) -> u64 {
        self.rejected
    }

    fn start(&mut self, accel: Vector3<f64>, mag: Option<Vector3<f64>>) {
        self.started = true;
        (self.levelled_s, self.levelled_rad) = (0.0, Vector2::zeros());
        // What was known of the heading before a silence stays.
        let up = self.q_level_sensor * accel;
        let leveling =
            UnitQuaternion::rotation_between(&up, &Vector3::z()).unwrap_or_else(UnitQuaternion::identity);
        self.q_level_sensor = leveling * self.q_level_sensor;
        if let Some(mag) = mag {
            self.heading.start(self.q_level_sensor * mag);
        }
    }

    /// Whether the sensor lies still for certain, and then the bias that a part of the rest has shown which is over by long enough.
    fn rests(&mut self) -> (bool, Option<Vector3<f64>>) {
        let gyro = self.rest.gyro_rad_s();
        let bias_rad_s = self.inclination.bias_rad_s();
        let steady = self.rest.at_rest() && self.rest.holds_steady(&self.params.rest, &bias_rad_s);
        let credible = steady && self.inclination.may_be_bias(&self.params.inclination, &gyro);
        if !credible && self.rest.proves_bias(&self.params.rest, !self.rested) {
            // A unit that nobody has calibrated. Bias and heading were estimated with a gyro that turned on the spot.
            self.rested = true;
            self.offset_rad_s += gyro;
            self.inclination.forget_bias(&self.params.inclination);
            self.heading.resume(&self.params.heading);
            self.rest = rest::Rest::default();
            return (false, None);
        }
        let rests = steady && (credible || self.rest.still_s() > self.params.rest.certain_s);
        self.rested |= rests;
        let shown = self.rest.shown_rad_s().filter(|_| rests);
        (rests, shown)
    }

    /// Runs the filters over the window; returns what the tilt receives, and the tilt that was applied.
    fn close_window(&mut self) -> (inclination::SpecificForceWindow, Vector2<f64>) {
        let w = std::mem::take(&mut self.window);
        let (at_rest, rest_gyro_rad_s) = self.rests();
        let up = w.rotation_s.row(2).transpose() / w.duration_s;
        let bias_sigma_rad_s = self.inclination.bias_sigma_rad_s(&up);
        let specific_force = inclination::SpecificForceWindow {
            duration_s: w.duration_s,
            rotation_s: w.rotation_s,
            velocity_m_s: w.velocity_m_s,
            shaking: w.shaking,
            turned_rad: w.turned_rad,
            bridged_rad2: w.bridged_rad2,
            has_field: self.heading.begun(),
            at_rest,
            rest_gyro_rad_s,
        };
        if w.mag_samples > 0 {
            if self.levelled_rad.norm() > LEVELLED_RAD {
                // What it knows of the field was seen with another tilt, and would be taken for a disturbance for good.
                self.levelled_rad = Vector2::zeros();
                self.heading.resume(&self.params.heading);
            }
            self.heading.update(
                &self.params.heading,
                &heading::FieldWindow {
                    duration_s: w.duration_s,
                    field: w.mag / f64::from(w.mag_samples),
                    lag: w.mag_lag / f64::from(w.mag_samples),
                    rotation: w.mag_rotation / f64::from(w.mag_samples),
                    turned_rad: w.turned_rad,
                    bridged_rad2: w.bridged_rad2,
                    bias_sigma_rad_s,
                    at_rest,
                },
            );
        } else {
            self.heading.hold(&self.params.heading, &specific_force, bias_sigma_rad_s);
        }
        let tilt = self.inclination.update(&self.params.inclination, &specific_force);
        self.levelled_s += w.duration_s;
        if self.levelled_s < LEVELS_S {
            self.levelled_rad += tilt;
        }
        let correction = UnitQuaternion::from_scaled_axis(Vector3::new(tilt[0], tilt[1], 0.0));
        self.q_level_sensor = UnitQuaternion::new_normalize((correction * self.q_level_sensor).into_inner());
        (specific_force, tilt)
    }
}

/// Turns `q` by `angular_velocity_rad_s` (body axes, rad/s) for `dt_s`; the half-angle series is exact to 1e-13 for the angles of
/// one sample, and large angles take the closed form.
fn integrate(q: UnitQuaternion<f64>, angular_velocity_rad_s: Vector3<f64>, dt_s: f64) -> UnitQuaternion<f64> {
    let half = angular_velocity_rad_s * (0.5 * dt_s);
    let h2 = half.norm_squared();
    if h2 > 0.01 {
        return q * UnitQuaternion::from_scaled_axis(angular_velocity_rad_s * dt_s);
    }
    let c = 1.0 - h2 * (0.5 - h2 * (1.0 / 24.0 - h2 * (1.0 / 720.0)));
    let s = 1.0 - h2 * (1.0 / 6.0 - h2 * (1.0 / 120.0 - h2 * (1.0 / 5040.0)));
    let step = Quaternion::new(c, s * half.x, s * half.y, s * half.z);
    UnitQuaternion::new_unchecked(q.into_inner() * step)
}
