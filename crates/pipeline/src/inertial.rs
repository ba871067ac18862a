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
use super::spike::Spikes;
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

/// Steps in which browsers give angular velocities, degrees/s, and accelerations, m/s² (W3C Device Orientation and Motion); and how far from
/// a step a value may be that has travelled as text in radians.
const BROWSER_STEP: f64 = 0.1;
const STEP_TOLERANCE: f64 = 1e-4;
/// What turns and is pushed by less may lie still, rad/s and m/s²: then its noise may be below those steps.
const STILL_RAD_S: f64 = 0.035;
const STILL_M_S2: f64 = 0.5;

/// So long a part of a record waits for the rest, in intervals of the records, and s before those are known: what waited longer
/// is of another time.
const WAITS_INTERVALS: f64 = 1.5;
const WAITS_AT_FIRST_S: f64 = 0.1;

#[derive(Clone, Debug, Plain)]
pub(super) struct Inertial {
    filter: Ahrs,
    magnetometer: bool,
    /// Whether records with angular velocities have come: what lacks them only adds to the next one that has them.
    has_angular_velocity: bool,
    /// What came since the latest record, for the next.
    specific_force_m_s2: Waiting<[f64; 3]>,
    linear_acceleration_m_s2: Waiting<[f64; 3]>,
    magnetic_field: Waiting<[f64; 3]>,
    orientation_wxyz: Waiting<[f64; 4]>,
    /// When the latest record came, and how long after the one before it, s.
    recorded: Option<Timestamp>,
    interval_s: Option<f64>,
    began: Option<Timestamp>,
    last: Option<Oriented>,
    spikes: Spikes,
    /// Whether all values so far were in a browser's steps.
    in_steps: bool,
    repetition: Repetition<ImuWords>,
}

/// A part of a record that came in a message of its own.
#[derive(Clone, Copy, Debug, Plain)]
struct Waiting<T>(Option<(Timestamp, T)>);

impl<T: Copy> Waiting<T> {
    const NONE: Self = Self(None);

    fn put(&mut self, t: Timestamp, part: Option<T>) {
        self.0 = part.map(|part| (t, part)).or(self.0);
    }

    /// The part, unless it has waited for longer than `longest_s` at `t`.
    fn take(&mut self, t: Timestamp, longest_s: f64) -> Option<T> {
        self.0.take().filter(|(came, _)| t.seconds_since(*came) <= longest_s).map(|(_, part)| part)
    }
}

/// Orientation after a record.
#[derive(Clone, Copy, Debug, Plain)]
struct Oriented {
    t: Timestamp,
    /// As [`Stamp::is_late`](super::clock::Stamp::is_late), or it came after its frame: nothing is derived from its time.
    late: bool,
    orientation: UnitQuaternion<f64>,
    /// Sensor axes.
    angular_velocity_rad_s: Vector3<f64>,
}

impl Inertial {
    pub(super) fn new(magnetometer: bool, gyro_delay_s: f64) -> Self {
        Self {
            filter: Ahrs::new(Params { gyro_delay_s, ..Params::instantaneous() }),
            magnetometer,
            has_angular_velocity: false,
            specific_force_m_s2: Waiting::NONE,
            linear_acceleration_m_s2: Waiting::NONE,
            magnetic_field: Waiting::NONE,
            orientation_wxyz: Waiting::NONE,
            recorded: None,
            interval_s: None,
            began: None,
            last: None,
            spikes: Spikes::default(),
            in_steps: true,
            repetition: Repetition::default(),
        }
    }

    /// Forgets what was learnt of the unit: its samples are corrected otherwise from now on.
    pub(super) fn restart(&mut self) {
        self.filter.forget();
        self.settle_anew();
    }

    /// The next records begin an orientation.
    fn settle_anew(&mut self) {
        self.spikes = Spikes::default();
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
        let of_gyro = angular_velocity_rad_s.into_iter().flatten().map(f64::to_degrees);
        self.in_steps &= of_gyro.chain(specific_force_m_s2.into_iter().flatten()).all(is_in_steps);
        self.specific_force_m_s2.put(t_valid, specific_force_m_s2);
        self.linear_acceleration_m_s2.put(t_valid, linear_acceleration_m_s2);
        self.magnetic_field.put(t_valid, magnetic_field);
        self.orientation_wxyz.put(t_valid, orientation_wxyz);
        if !completes {
            return None;
        }
        // The interval before a break is that of the records after it.
        let since_s = self.recorded.replace(t_valid).map(|before| t_valid.seconds_since(before));
        self.interval_s = since_s.filter(|since_s| *since_s <= COAST_S).or(self.interval_s);
        let longest_s = self.interval_s.map_or(WAITS_AT_FIRST_S, |interval_s| WAITS_INTERVALS * interval_s);
        Some(Measured {
            t_valid,
            position_m: None,
            clipped: false,
            orientation_wxyz: self.orientation_wxyz.take(t_valid, longest_s),
            button: None,
            inertial: Some(output::Inertial {
                angular_velocity_rad_s,
                specific_force_m_s2: self.specific_force_m_s2.take(t_valid, longest_s),
                linear_acceleration_m_s2: self.linear_acceleration_m_s2.take(t_valid, longest_s),
                magnetic_field: self.magnetic_field.take(t_valid, longest_s),
                ..output::Inertial::default()
            }),
        })
    }

    pub(super) fn measure(&mut self, measured: &Measured, late: bool) -> Finding {
        const SUSPECT: Finding = Finding::new(Verdict::Suspect, Label::anomalous(Cause::Gate));
        let Some(inertial) = measured.inertial else { return SUSPECT };
        let oriented = match inertial.sample() {
            Some(sample) => self.filtered(measured.t_valid, sample, late),
            None => self.reported(measured, late),
        };
        let Some(oriented) = oriented else { return SUSPECT };
        self.last = Some(oriented);
        // Units without angular velocities may rest.
        let repeats = inertial.words().map(|words| {
            let evidence = if self.in_steps && is_still(&words) { Evidence::None } else { Evidence::Certain };
            self.repetition.take(words, evidence)
        });
        if repeats == Some(Repeats::Stuck) {
            return Finding::new(Verdict::Dropped, Label::anomalous(Cause::Stuck));
        }
        let began = *self.began.get_or_insert(measured.t_valid);
        if inertial.angular_velocity_rad_s.is_some() && measured.t_valid.seconds_since(began) < SETTLING_S {
            return Finding::SETTLING;
        }
        Finding::new(Verdict::Used, Label::CLEAN)
    }

    /// The filter's orientation after a sample; `None` where the numbers make no sense, or may not.
    fn filtered(&mut self, t: Timestamp, sample: ImuSample, late: bool) -> Option<Oriented> {
        let since_s = self.last.map(|last| t.seconds_since(last.t));
        let dt_s = match since_s {
            Some(dt_s) if dt_s <= 0.0 => return None,
            Some(dt_s) if dt_s <= COAST_S => dt_s,
            // The sensor may have been turned meanwhile: a return is settled like a start.
            Some(_) => {
                self.filter.resume();
                self.settle_anew();
                LEAST_INTERVAL_S
            }
            None => LEAST_INTERVAL_S,
        };
        if self.spikes.leave_out(&sample, dt_s) {
            return None;
        }
        let rejected = self.filter.rejected();
        let mag = sample.mag.filter(|_| self.magnetometer).and_then(|field| self.spikes.field(field));
        let sample = ImuSample { mag, ..sample };
        let orientation = self.filter.push(&sample, dt_s);
        let angular_velocity_rad_s = self.filter.angular_velocity_rad_s();
        (self.filter.rejected() == rejected).then_some(Oriented {
            t,
            late,
            orientation,
            angular_velocity_rad_s,
        })
    }

    /// The orientation that the unit computes; its angular velocity comes from two of them.
    fn reported(&self, measured: &Measured, late: bool) -> Option<Oriented> {
        let t = measured.t_valid;
        let orientation = posed_geometry::orientation_from_wxyz(measured.orientation_wxyz?)?;
        let is_before =
            |last: &Oriented| (LEAST_INTERVAL_S..=COAST_RATE_S).contains(&t.seconds_since(last.t));
        let before = self.last.filter(|last| !last.late && is_before(last));
        let angular_velocity_rad_s = before.map_or_else(Vector3::zeros, |last| {
            (last.orientation.inverse() * orientation).scaled_axis() / t.seconds_since(last.t)
        });
        Some(Oriented { t, late, orientation, angular_velocity_rad_s })
    }

    /// The orientation in the room at `t`, and whether the sensor turns.
    pub(super) fn at(&self, t: Timestamp) -> (Option<PoseEstimate>, bool) {
        let fresh = |last: &Oriented| t.seconds_since(last.t) <= COAST_S;
        let Some(last) = self.last.filter(fresh) else { return (None, false) };
        // A record may follow the frame's tick by a little.
        let ahead_s = t.seconds_since(last.t).clamp(-COAST_RATE_S, COAST_RATE_S);
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

/// Whether a value is one of those that browsers round to.
fn is_in_steps(value: f64) -> bool {
    let steps = value / BROWSER_STEP;
    (steps - steps.round()).abs() * BROWSER_STEP <= STEP_TOLERANCE
}

/// Whether a sensor may lie still: it hardly turns, and feels gravity alone.
fn is_still(words: &ImuWords) -> bool {
    let gravity_m_s2 = posed_geometry::GRAVITY_M_S2;
    words.angular_velocity_rad_s.norm() < STILL_RAD_S
        && words.acceleration_m_s2.is_some_and(|force| (force.norm() - gravity_m_s2).abs() < STILL_M_S2)
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEP_S: f64 = 0.01;
    /// Earth's field in the room: north and down.
    const FIELD: Vector3<f64> = Vector3::new(0.0, 0.4, -0.9);

    struct Unit {
        inertial: Inertial,
        /// Sensor to room, truly.
        truth: UnitQuaternion<f64>,
        t: Timestamp,
    }

    impl Unit {
        fn new() -> Self {
            Self {
                inertial: Inertial::new(true, 0.0),
                truth: UnitQuaternion::identity(),
                t: Timestamp::from_secs_f64(1.0),
            }
        }

        fn message(&mut self, measurement: Measurement) -> Option<Measured> {
            self.inertial.record(self.t, &measurement)
        }

        /// The unit's magnetometer and its own orientation, each a message that waits for the next rates.
        fn parts(&mut self) {
            let mag = (self.truth.inverse() * FIELD).into();
            let wxyz = posed_geometry::orientation_to_wxyz(&self.truth);
            for (magnetic_field, orientation_wxyz) in [(Some(mag), None), (None, Some(wxyz))] {
                let part = self.message(Measurement::Imu {
                    angular_velocity_rad_s: None,
                    specific_force_m_s2: None,
                    linear_acceleration_m_s2: None,
                    magnetic_field,
                    orientation_wxyz,
                });
                assert!(part.is_none() || !self.inertial.has_angular_velocity);
            }
        }

        /// Rates and specific force: the record, what was found of it, and the error of the orientation, rad; NaN before there is one.
        fn rates(&mut self, k: u32) -> (Measured, Finding, f64) {
            // Noise, so that no words repeat.
            self.turning(1e-4 * f64::from(k % 7))
        }

        /// The same with an angular velocity, rad/s, that the truth does not follow.
        fn turning(&mut self, about_x_rad_s: f64) -> (Measured, Finding, f64) {
            let gravity = self.truth.inverse() * Vector3::new(0.0, 0.0, posed_geometry::GRAVITY_M_S2);
            let record = self.message(Measurement::Imu {
                angular_velocity_rad_s: Some([about_x_rad_s, 0.0, 0.0]),
                specific_force_m_s2: Some(gravity.into()),
                linear_acceleration_m_s2: None,
                magnetic_field: None,
                orientation_wxyz: None,
            });
            let record = record.expect("rates complete a record");
            let finding = self.inertial.measure(&record, false);
            let pose = self.inertial.at(self.t).0;
            let orientation =
                pose.and_then(|pose| posed_geometry::orientation_from_wxyz(pose.orientation_wxyz));
            let error_rad = orientation.map_or(f64::NAN, |orientation| orientation.angle_to(&self.truth));
            self.t = self.t + std::time::Duration::from_secs_f64(STEP_S);
            (record, finding, error_rad)
        }

        fn run(&mut self, records: u32) {
            for k in 0..records {
                if k % 5 == 0 {
                    self.parts();
                }
                self.rates(k);
            }
        }
    }

    /// One that lies still repeats itself where values are rounded as by a browser; one that turns, or feels nothing, is stuck all the same.
    #[test]
    fn a_phone_that_lies_still_is_not_stuck() {
        let verdict = |turning_deg_s: f64, force_m_s2: [f64; 3], reading_deg_s: f64| {
            let mut inertial = Inertial::new(false, 0.0);
            let mut found = Verdict::Used;
            for k in 0..100 {
                let rate = if k < 30 { reading_deg_s } else { turning_deg_s };
                let t = Timestamp::from_secs_f64(1.0 + 0.016 * f64::from(k));
                let message = Measurement::Imu {
                    angular_velocity_rad_s: Some([rate.to_radians(), 0.0, -0.2_f64.to_radians()]),
                    specific_force_m_s2: Some(force_m_s2),
                    linear_acceleration_m_s2: None,
                    magnetic_field: None,
                    orientation_wxyz: None,
                };
                let record = inertial.record(t, &message).expect("a record");
                found = inertial.measure(&record, false).verdict;
            }
            found
        };
        let flat = [0.1, 0.0, 9.8];
        assert_eq!(verdict(0.1, flat, 0.1), Verdict::Used);
        assert_eq!(verdict(30.0, flat, 0.1), Verdict::Dropped, "it turns, and repeats itself");
        assert_eq!(verdict(0.0, [0.0; 3], 0.0), Verdict::Dropped, "it feels no gravity");
        assert_eq!(
            verdict(0.1, flat, 0.123),
            Verdict::Dropped,
            "its values are finer than those of a browser"
        );
    }

    #[test]
    fn after_a_break_nothing_old_is_used_and_a_return_is_settled_like_a_start() {
        for (break_s, turned_rad) in [(0.6, 1.0), (3.0, 1.6), (60.0, -2.5)] {
            let mut unit = Unit::new();
            unit.run(1000);
            // These wait for rates that do not come any more.
            unit.parts();
            unit.t = unit.t + std::time::Duration::from_secs_f64(break_s);
            unit.truth = UnitQuaternion::from_scaled_axis(Vector3::new(0.2, 0.0, turned_rad));
            for k in 0..200 {
                let (record, finding, error_rad) = unit.rates(k);
                let inertial = record.inertial.expect("of an IMU");
                assert!(k > 0 || (record.orientation_wxyz.is_none() && inertial.magnetic_field.is_none()));
                assert!(
                    finding.verdict == Verdict::Suspect || error_rad < 0.1,
                    "{break_s} s: record {k} is {:?} and {error_rad} rad off",
                    finding.verdict
                );
                if k % 5 == 4 {
                    unit.parts();
                }
            }
        }
    }

    #[test]
    fn what_has_waited_turns_nothing_that_comes_after_it() {
        let mut unit = Unit::new();
        let mut orientation = |turned_rad: f64, late: bool| {
            unit.truth = UnitQuaternion::from_scaled_axis(Vector3::new(turned_rad, 0.0, 0.0));
            let orientation_wxyz = Some(posed_geometry::orientation_to_wxyz(&unit.truth));
            let record = Measured {
                t_valid: unit.t,
                position_m: None,
                clipped: false,
                orientation_wxyz,
                button: None,
                inertial: Some(output::Inertial::default()),
            };
            unit.inertial.measure(&record, late);
            unit.t = unit.t + std::time::Duration::from_secs_f64(STEP_S);
            let pose = unit.inertial.at(unit.t).0.expect("a sample has just come");
            posed_geometry::orientation_from_wxyz(pose.orientation_wxyz).unwrap().angle_to(&unit.truth)
        };
        assert!((0..9).all(|k| orientation(0.01 * f64::from(k), false) < 0.011));
        // Two seconds old, said to be of now; and the first that is.
        orientation(0.1, true);
        assert!(orientation(1.1, false) < 1e-6);
        assert!((orientation(1.12, false) - 0.02).abs() < 1e-6);
    }

    #[test]
    fn a_slow_unit_keeps_its_parts() {
        let mut unit = Unit::new();
        for k in 0..50 {
            unit.parts();
            // The rates of a unit at 2 Hz come late.
            unit.t = unit.t + std::time::Duration::from_secs_f64(if k == 0 { 0.05 } else { 0.4 });
            let (record, ..) = unit.rates(k);
            assert!(k < 2 || record.orientation_wxyz.is_some(), "record {k}");
        }
    }

    #[test]
    fn a_damaged_angular_velocity_does_not_turn_a_body() {
        for (gap_s, damaged_rad_s) in [(0.0, 35.0), (0.04, 35.0), (0.1, -60.0), (0.0, 1e4), (0.0, 1e30)] {
            let mut unit = Unit::new();
            unit.run(1000);
            unit.t = unit.t + std::time::Duration::from_secs_f64(gap_s);
            let (_, finding, error_rad) = unit.turning(damaged_rad_s);
            assert_eq!(finding.verdict, Verdict::Suspect);
            let (_, next, later_rad) = unit.rates(1);
            assert!(next.verdict == Verdict::Used && error_rad.max(later_rad) < 0.02, "{later_rad} rad");
        }
    }

    #[test]
    fn a_damaged_specific_force_levels_nothing() {
        for away_s in [None, Some(0.6), Some(60.0)] {
            let mut unit = Unit::new();
            if let Some(away_s) = away_s {
                unit.run(1000);
                unit.t = unit.t + std::time::Duration::from_secs_f64(away_s);
            }
            let truth = std::mem::replace(&mut unit.truth, UnitQuaternion::from_euler_angles(1.2, 0.3, 0.1));
            unit.parts();
            unit.rates(0);
            unit.truth = truth;
            for k in 1..200 {
                let (_, finding, error_rad) = unit.rates(k);
                let is_good = finding.verdict == Verdict::Suspect || error_rad < 0.02;
                assert!(is_good, "{away_s:?}: record {k} is {error_rad} rad off");
                assert!(k < 50 || finding.verdict == Verdict::Used);
                if k % 5 == 0 {
                    unit.parts();
                }
            }
        }
    }

    #[test]
    fn a_damaged_field_gives_no_heading() {
        const DAMAGED: [[f64; 3]; 4] =
            [[1e20, 0.0, 1.0], [1e-20, 1e-20, 0.0], [0.0, -0.4, 0.9], [f64::NAN; 3]];
        for magnetic_field in DAMAGED.map(Some) {
            for records in [0, 1000] {
                let mut unit = Unit::new();
                unit.run(records);
                unit.message(Measurement::Imu {
                    angular_velocity_rad_s: None,
                    specific_force_m_s2: None,
                    linear_acceleration_m_s2: None,
                    magnetic_field,
                    orientation_wxyz: None,
                });
                for k in 1..100 {
                    let (_, finding, error_rad) = unit.rates(k);
                    let is_good = finding.verdict == Verdict::Suspect || error_rad < 0.02;
                    assert!(is_good, "{magnetic_field:?} after {records}: record {k} is {error_rad} rad off");
                    if k % 5 == 0 {
                        unit.parts();
                    }
                }
            }
        }
    }

    #[test]
    fn a_blow_is_followed_one_record_late() {
        let mut unit = Unit::new();
        unit.run(1000);
        assert_eq!(unit.turning(20.0).1.verdict, Verdict::Suspect);
        let (_, finding, turned_rad) = unit.turning(22.0);
        assert_eq!(finding.verdict, Verdict::Used);
        // Of 0.31 by the trapezoid of all three; the record that was left out is missing.
        assert!((0.2..0.4).contains(&turned_rad), "{turned_rad} rad of 0.31");
    }
}
