//! One body-worn IMU: its records, and its orientation in the room.
//!
//! What comes in: measurements, some of which hold only a part (a magnetometer slower than the gyro, an
//! orientation in a message of its own). What goes out: one record per cycle with all that came since the last, how
//! far it can be trusted, and the orientation. A unit that sends its angular velocities is oriented here ([`Ahrs`]); one that
//! only sends the orientation which it computes itself is believed. It never gives a position.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use posed_drivers::{Measurement, Timestamp};
use posed_state::Plain;

use super::magnetic::{MOVING_RAD_S, upper_triangle};
use posed_fusion::ahrs::{Ahrs, CALIBRATED_HEADING_RAD, CALIBRATED_TILT_RAD, ImuSample, Params};
use posed_fusion::faults::{Cause, Evidence, Finding, ImuWords, Label, Repeats, Repetition, Verdict};
use posed_stage::output::{self, Measured, PoseEstimate};

/// How long an orientation goes on without a measurement, s.
const COAST_S: f64 = 0.5;
/// How long the last angular velocity goes on without a measurement, s.
const COAST_RATE_S: f64 = 0.1;
/// Time that the filter of a sensor that has just appeared needs for its inclination, s.
const SETTLING_S: f64 = 0.3;
/// Shortest interval from which an angular velocity is taken, s.
const LEAST_INTERVAL_S: f64 = 2e-3;
/// Standard deviation of the orientation about an axis of a unit that computes it itself and does not say how good it is, rad.
const SIGMA_OWN: f64 = 0.02;

#[derive(Clone, Debug, Plain)]
pub(super) struct Inertial {
    filter: Ahrs,
    magnetometer: bool,
    /// Whether records with angular velocities have come: what lacks them only adds to the next one that has them.
    has_angular_velocity: bool,
    /// What came since the latest record, for the next.
    more: output::Inertial,
    more_wxyz: Option<[f64; 4]>,
    began: Option<Timestamp>,
    last: Option<Oriented>,
    repetition: Repetition<ImuWords>,
}

/// Orientation after a record.
#[derive(Clone, Copy, Debug, Plain)]
struct Oriented {
    t: Timestamp,
    orientation: UnitQuaternion<f64>,
    /// Sensor axes.
    angular_velocity_rad_s: Vector3<f64>,
}

impl Inertial {
    pub(super) fn new(magnetometer: bool, gyro_delay_s: f64) -> Self {
        Self {
            filter: Ahrs::new(Params { gyro_delay_s, ..Params::default() }),
            magnetometer,
            has_angular_velocity: false,
            more: output::Inertial::default(),
            more_wxyz: None,
            began: None,
            last: None,
            repetition: Repetition::default(),
        }
    }

    /// Forgets what was learnt of the unit: its samples are corrected otherwise from now on.
    pub(super) fn restart(&mut self) {
        self.filter.forget();
        (self.began, self.last) = (None, None);
    }

    /// Whether a measurement is one of the cycle that times the device, rather than one beside it.
    pub(super) fn times(&self, measurement: &Measurement) -> bool {
        match measurement {
            Measurement::Imu { angular_velocity_rad_s, orientation_wxyz, .. } => {
                angular_velocity_rad_s.is_some() || (!self.has_angular_velocity && orientation_wxyz.is_some())
            }
            Measurement::Pose { .. } => true,
        }
    }

    /// The record that a measurement completes.
    pub(super) fn record(&mut self, t_valid: Timestamp, measurement: &Measurement) -> Option<Measured> {
        let Measurement::Imu {
            angular_velocity_rad_s,
            specific_force_m_s2,
            linear_acceleration_m_s2,
            magnetic_field,
            orientation_wxyz,
        } = *measurement
        else {
            return None;
        };
        let completes = self.times(measurement);
        self.has_angular_velocity |= angular_velocity_rad_s.is_some();
        let more = &mut self.more;
        more.angular_velocity_rad_s = angular_velocity_rad_s;
        more.specific_force_m_s2 = specific_force_m_s2.or(more.specific_force_m_s2);
        more.linear_acceleration_m_s2 = linear_acceleration_m_s2.or(more.linear_acceleration_m_s2);
        more.magnetic_field = magnetic_field.or(more.magnetic_field);
        self.more_wxyz = orientation_wxyz.or(self.more_wxyz);
        completes.then(|| Measured {
            t_valid,
            position_m: None,
            orientation_wxyz: self.more_wxyz.take(),
            button: None,
            inertial: Some(std::mem::take(&mut self.more)),
        })
    }

    pub(super) fn measure(&mut self, measured: &Measured) -> Finding {
        const SUSPECT: Finding = Finding::new(Verdict::Suspect, Label::anomalous(Cause::Gate));
        let Some(inertial) = measured.inertial else { return SUSPECT };
        let oriented = match inertial.sample() {
            Some(sample) => self.filtered(measured.t_valid, sample),
            None => self.reported(measured),
        };
        let Some(oriented) = oriented else { return SUSPECT };
        self.last = Some(oriented);
        // Units without angular velocities may rest.
        let words = inertial.words();
        if words.is_some_and(|words| self.repetition.take(words, Evidence::Certain) == Repeats::Stuck) {
            return Finding::new(Verdict::Dropped, Label::anomalous(Cause::Stuck));
        }
        let began = *self.began.get_or_insert(measured.t_valid);
        if inertial.angular_velocity_rad_s.is_some() && measured.t_valid.seconds_since(began) < SETTLING_S {
            return SUSPECT;
        }
        Finding::new(Verdict::Used, Label::CLEAN)
    }

    /// The filter's orientation after a sample; `None` where the numbers make no sense.
    fn filtered(&mut self, t: Timestamp, sample: ImuSample) -> Option<Oriented> {
        let since_s = self.last.map(|last| t.seconds_since(last.t));
        let dt_s = match since_s {
            Some(dt_s) if dt_s <= 0.0 => return None,
            Some(dt_s) if dt_s <= COAST_S => dt_s,
            // The sensor may have been turned meanwhile.
            Some(_) => {
                self.filter.resume();
                LEAST_INTERVAL_S
            }
            None => LEAST_INTERVAL_S,
        };
        let rejected = self.filter.rejected();
        let sample = ImuSample { mag: sample.mag.filter(|_| self.magnetometer), ..sample };
        let orientation = self.filter.push(&sample, dt_s);
        let angular_velocity_rad_s = self.filter.angular_velocity_rad_s();
        (self.filter.rejected() == rejected).then_some(Oriented { t, orientation, angular_velocity_rad_s })
    }

    /// The orientation that the unit computes; its angular velocity comes from two of them.
    fn reported(&self, measured: &Measured) -> Option<Oriented> {
        let t = measured.t_valid;
        let orientation = posed_geometry::orientation_from_wxyz(measured.orientation_wxyz?)?;
        let before =
            self.last.filter(|last| (LEAST_INTERVAL_S..=COAST_RATE_S).contains(&t.seconds_since(last.t)));
        let angular_velocity_rad_s = before.map_or_else(Vector3::zeros, |last| {
            (last.orientation.inverse() * orientation).scaled_axis() / t.seconds_since(last.t)
        });
        Some(Oriented { t, orientation, angular_velocity_rad_s })
    }

    /// The orientation in the room at `t`, and whether the sensor turns.
    pub(super) fn at(&self, t: Timestamp) -> (Option<PoseEstimate>, bool) {
        let fresh = |last: &Oriented| t.seconds_since(last.t) <= COAST_S;
        let Some(last) = self.last.filter(fresh) else { return (None, false) };
        let ahead_s = t.seconds_since(last.t).clamp(0.0, COAST_RATE_S);
        let orientation =
            last.orientation * UnitQuaternion::from_scaled_axis(last.angular_velocity_rad_s * ahead_s);
        let pose = PoseEstimate {
            position_m: None,
            orientation_wxyz: posed_geometry::orientation_to_wxyz(&orientation),
            velocity_m_s: None,
            angular_velocity_rad_s: last.angular_velocity_rad_s.into(),
            covariance: upper_triangle(&Matrix3::zeros(), &self.rotation_rad2(&orientation)),
            sigma_m: None,
        };
        (Some(pose), last.angular_velocity_rad_s.norm() > MOVING_RAD_S)
    }

    /// Covariance of the orientation's error in sensor axes, rad²: the filter's own, and what the unit's calibration has left.
    fn rotation_rad2(&self, orientation: &UnitQuaternion<f64>) -> Matrix3<f64> {
        if !self.has_angular_velocity {
            return Matrix3::identity() * SIGMA_OWN.powi(2);
        }
        let level = Vector3::new(CALIBRATED_TILT_RAD, CALIBRATED_TILT_RAD, CALIBRATED_HEADING_RAD);
        let rotation = orientation.to_rotation_matrix().into_inner();
        self.filter.rotation_rad2()
            + rotation.transpose() * Matrix3::from_diagonal(&level.component_mul(&level)) * rotation
    }
}
