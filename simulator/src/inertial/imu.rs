//! One inertial sensor on a body.

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use posed_drivers::Timestamp;
use posed_drivers::xbus::Sampling;

use super::GRAVITY_M_S2;
use super::earth::EarthSpec;
use super::errors::{Axes, FilterError, ImuErrors};
use crate::device::Sensor;
use crate::random::Random;
use crate::truth::{Class, TruthRow};

/// What a sensor measures at one time, in its own axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Inertial {
    /// rad/s.
    pub(crate) angular_velocity_rad_s: Vector3<f64>,
    /// What an accelerometer feels: +g upwards at rest, m/s².
    pub(crate) specific_force_m_s2: Vector3<f64>,
    /// In units of the field at the place of calibration.
    pub(crate) magnetic_field: Vector3<f64>,
    /// Sensor to room (z up), by the device's own filter.
    pub(crate) orientation: UnitQuaternion<f64>,
    /// Specific force with the gravity taken out that the device's own filter sees, m/s².
    pub(crate) linear_acceleration_m_s2: Vector3<f64>,
}

impl Inertial {
    /// The mean of several samples, as a device with a message every n samples sends it; the orientation is the last.
    pub(crate) fn mean(samples: &[Self]) -> Option<Self> {
        let last = samples.last()?;
        let mean = |part: fn(&Self) -> Vector3<f64>| {
            samples.iter().map(part).sum::<Vector3<f64>>() / samples.len() as f64
        };
        Some(Self {
            angular_velocity_rad_s: mean(|sample| sample.angular_velocity_rad_s),
            specific_force_m_s2: mean(|sample| sample.specific_force_m_s2),
            magnetic_field: mean(|sample| sample.magnetic_field),
            linear_acceleration_m_s2: mean(|sample| sample.linear_acceleration_m_s2),
            orientation: last.orientation,
        })
    }
}

/// What is true at one time, in sensor axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Kinematics {
    pub(crate) pose: Isometry3<f64>,
    pub(crate) angular_velocity_rad_s: Vector3<f64>,
    pub(crate) specific_force_m_s2: Vector3<f64>,
}

/// A sensor with its errors.
#[derive(Clone, Debug)]
pub(crate) struct Imu {
    sensor: Sensor,
    earth: EarthSpec,
    gyroscope: Axes,
    accelerometer: Axes,
    magnetometer: Axes,
    filter: FilterError,
    random: Random,
    sampling: Sampling,
    /// When it was tapped, s.
    taps_s: Vec<f64>,
    last: Option<Timestamp>,
}

impl Imu {
    pub(crate) fn new(sensor: Sensor, earth: EarthSpec, errors: &ImuErrors, mut random: Random) -> Self {
        Self {
            gyroscope: Axes::draw(errors.gyroscope, &mut random),
            accelerometer: Axes::draw(errors.accelerometer, &mut random),
            magnetometer: Axes::draw(errors.magnetometer, &mut random),
            filter: FilterError::draw(errors.filter, &mut random),
            sensor,
            earth,
            random,
            sampling: Sampling::Instantaneous,
            taps_s: Vec::new(),
            last: None,
        }
    }

    /// The same, of which each sample is of this kind.
    pub(crate) fn sampled(self, sampling: Sampling) -> Self {
        Self { sampling, ..self }
    }

    /// Somebody taps it at `t`, along its z axis.
    pub(crate) fn tap(&mut self, t: Timestamp) {
        self.taps_s.push(t.as_secs_f64());
    }

    /// What the taps add to the specific force at a time, s, along z, m/s²: each rings at 35 Hz and dies away in 15 ms, as a unit in its strap does.
    fn tapped_m_s2(&self, t_s: f64) -> f64 {
        let rings = |at_s: &f64| {
            let since_s = t_s - at_s;
            if since_s < 0.0 { 0.0 } else { 35.0 * libm::exp(-since_s / 0.015) * libm::cos(220.0 * since_s) }
        };
        self.taps_s.iter().map(rings).sum()
    }

    /// Pose, angular velocity and specific force at `t`.
    ///
    /// Differences of the pose over 1 ms steps, five points: exact to about 1e-6 of the motions here.
    pub(crate) fn kinematics(&self, t: Timestamp) -> Kinematics {
        const H_S: f64 = 1e-3;
        let t_s = t.as_secs_f64();
        let at = |n: f64| self.sensor.pose_in_room_s(t_s + n * H_S);
        let (a, b, pose, c, d) = (at(-2.0), at(-1.0), at(0.0), at(1.0), at(2.0));
        let rotation_vector_rad =
            |other: &Isometry3<f64>| (pose.rotation.inverse() * other.rotation).scaled_axis();
        let angular_velocity_rad_s = (rotation_vector_rad(&a) - 8.0 * rotation_vector_rad(&b)
            + 8.0 * rotation_vector_rad(&c)
            - rotation_vector_rad(&d))
            / (12.0 * H_S);
        let offset_m = |other: &Isometry3<f64>| other.translation.vector - pose.translation.vector;
        let acceleration =
            (16.0 * (offset_m(&b) + offset_m(&c)) - offset_m(&a) - offset_m(&d)) / (12.0 * H_S * H_S);
        let specific_force_m_s2 = acceleration + Vector3::new(0.0, 0.0, GRAVITY_M_S2);
        Kinematics {
            pose,
            angular_velocity_rad_s,
            specific_force_m_s2: pose.rotation.inverse() * specific_force_m_s2,
        }
    }

    /// True angular velocity, rad/s, and specific force, m/s², of a sample that ends at `t` and stands for `dt_s`, sensor axes.
    fn sampled_at(&self, t: Timestamp, dt_s: f64) -> [Vector3<f64>; 2] {
        /// Points of the mid-point rule.
        const POINTS: u32 = 8;
        let at = |back_s: f64| {
            let t = Timestamp::from_secs_f64((t.as_secs_f64() - back_s).max(0.0));
            let truth = self.kinematics(t);
            let tapped_m_s2 = Vector3::z() * self.tapped_m_s2(t.as_secs_f64());
            [truth.angular_velocity_rad_s, truth.specific_force_m_s2 + tapped_m_s2]
        };
        match self.sampling {
            Sampling::Instantaneous => at(0.0),
            Sampling::Mean => (0..POINTS).fold([Vector3::zeros(); 2], |[turns, forces], point| {
                let [turn, force] = at(dt_s * (f64::from(point) + 0.5) / f64::from(POINTS));
                [turns + turn / f64::from(POINTS), forces + force / f64::from(POINTS)]
            }),
        }
    }

    /// Measures at `t`; a sample stands for `dt_s`. Times must not go backwards.
    pub(crate) fn measure(&mut self, t: Timestamp, dt_s: f64) -> Inertial {
        let rotation = self.sensor.pose_in_room(t).rotation;
        let [angular_velocity_rad_s, specific_force_m_s2] = self.sampled_at(t, dt_s);
        let (field, _) = self.earth.field(t.as_secs_f64());
        let Self { gyroscope, accelerometer, magnetometer, filter, random, .. } = self;
        let field = rotation.inverse() * field;
        let since_s = self.last.replace(t).map_or(dt_s, |last| t.seconds_since(last).max(0.0));
        let angular_velocity_rad_s = gyroscope.measure(&angular_velocity_rad_s, dt_s, random);
        let specific_force_m_s2 = accelerometer.measure(&specific_force_m_s2, dt_s, random);
        let magnetic_field = magnetometer.measure(&field, dt_s, random);
        let orientation = filter.apply(&rotation, since_s, random);
        let gravity = orientation.inverse() * Vector3::new(0.0, 0.0, GRAVITY_M_S2);
        Inertial {
            angular_velocity_rad_s,
            specific_force_m_s2,
            magnetic_field,
            orientation,
            linear_acceleration_m_s2: specific_force_m_s2 - gravity,
        }
    }

    /// Truth of a measurement at `t`.
    pub(crate) fn truth(&self, t: Timestamp) -> TruthRow {
        let (_, is_disturbed) = self.earth.field(t.as_secs_f64());
        TruthRow {
            sensor: self.sensor.index,
            pose: self.sensor.pose_in_room(t),
            class: if is_disturbed { Class::Disturbed } else { Class::Clean },
            distortion_m: Vector3::zeros(),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::body::Activity;
    use crate::inertial::{AxisErrors, ImuClass};
    use crate::motion::{Body, Motion, Person, Screw, Still, Walk};
    use crate::random::Purpose;

    fn imu(motion: Motion, mount: Isometry3<f64>, errors: &ImuErrors) -> Imu {
        let body = Body::new(motion, Path::new(".")).unwrap();
        let sensor = Sensor { index: 3, body, segment: 0, mount };
        Imu::new(sensor, EarthSpec::default(), errors, Random::new(1, Purpose::Signals(0)))
    }

    /// Skin turns the sensor of somebody who walks as far as is set, not of one who stands, and what it measures is how it then is.
    #[test]
    fn skin_turns_a_sensor_with_its_acceleration_and_the_sensor_feels_it() {
        const SKIN_DEG_PER_M_S2: f64 = 0.06;
        let segment = Person::SEGMENTS.iter().position(|name| *name == "thigh_r").unwrap();
        let mount = Isometry3::new(Vector3::new(0.06, -0.2, 0.01), Vector3::new(0.4, -1.1, 0.3));
        let worn = |skin_deg_per_m_s2: f64| {
            let person = Person { activity: Activity::Walking, skin_deg_per_m_s2, ..Person::default() };
            let body = Body::new(Motion::Person(person), Path::new(".")).unwrap();
            let sensor = Sensor { index: 0, body, segment, mount };
            let errors = ImuErrors::of(ImuClass::Ideal);
            Imu::new(sensor, EarthSpec::default(), &errors, Random::new(1, Purpose::Signals(0)))
        };
        let (rigid_imu, soft_imu) = (worn(0.0), worn(SKIN_DEG_PER_M_S2));
        assert_eq!(
            rigid_imu.kinematics(seconds(0.0)).pose,
            soft_imu.kinematics(seconds(-1.0)).pose,
            "who stands"
        );
        let (mut turned_rad2, mut expected_rad2) = (0.0, 0.0);
        let mut integrated = soft_imu.kinematics(seconds(4.0)).pose.rotation;
        for step in 0..4000 {
            let t = seconds(4.0 + 1e-3 * f64::from(step));
            let (rigid, soft) = (rigid_imu.kinematics(t), soft_imu.kinematics(t));
            assert!((rigid.pose.translation.vector - soft.pose.translation.vector).norm() < 1e-12);
            let acceleration_m_s2 =
                rigid.pose.rotation * rigid.specific_force_m_s2 - Vector3::z() * GRAVITY_M_S2;
            turned_rad2 += rigid.pose.rotation.angle_to(&soft.pose.rotation).powi(2);
            // About three axes, for each of three directions.
            expected_rad2 += 3.0 * (SKIN_DEG_PER_M_S2.to_radians() * acceleration_m_s2.norm()).powi(2);
            // The same force at the same place, seen by a sensor that has turned.
            let felt = [rigid, soft].map(|of| of.pose.rotation * of.specific_force_m_s2);
            assert!((felt[0] - felt[1]).norm() < 1e-6);
            let off_rad = integrated.angle_to(&soft.pose.rotation);
            assert!(off_rad < 1e-3, "{off_rad} rad after {step} ms");
            let half_way = Timestamp::from_nanos(t.as_nanos() + 500_000);
            let angular_velocity_rad_s = soft_imu.kinematics(half_way).angular_velocity_rad_s;
            integrated *= UnitQuaternion::from_scaled_axis(angular_velocity_rad_s * 1e-3);
        }
        let ratio = (turned_rad2 / expected_rad2).sqrt();
        assert!((0.4..2.0).contains(&ratio), "one draw of nine: {ratio}");
    }

    fn seconds(s: f64) -> Timestamp {
        Timestamp::from_secs_f64(s)
    }

    #[test]
    fn at_rest_it_feels_gravity_upwards_and_the_field_in_its_own_axes() {
        // Turned so that its z points east: x stays up (room z), y north.
        let mount = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), std::f64::consts::FRAC_PI_2);
        let mount = Isometry3::from_parts(Vector3::new(0.1, 0.2, 0.3).into(), mount);
        let mut imu = imu(Motion::Still(Still::default()), mount, &ImuErrors::default());
        let y = imu.measure(seconds(1.0), 0.01);
        assert!((y.specific_force_m_s2 - Vector3::new(-GRAVITY_M_S2, 0.0, 0.0)).norm() < 1e-9, "{y:?}");
        assert!(y.angular_velocity_rad_s.norm() < 1e-9 && y.linear_acceleration_m_s2.norm() < 1e-9);
        let (north, down) = (0.5, 0.75f64.sqrt());
        assert!((y.magnetic_field - Vector3::new(down, north, 0.0)).norm() < 1e-9, "{y:?}");
        assert!(y.orientation.angle_to(&mount.rotation) < 1e-9);
    }

    #[test]
    fn on_a_screw_both_measurements_are_their_closed_forms() {
        let screw = Screw {
            angle_deg: 90.0,
            period_s: 2.0,
            radius_m: 0.0,
            pitch_m_per_turn: 0.0,
            ..Screw::default()
        };
        let lever = Vector3::new(0.0, 0.25, 0.0);
        let imu = imu(
            Motion::Screw(screw),
            Isometry3::from_parts(lever.into(), UnitQuaternion::identity()),
            &ImuErrors::default(),
        );
        // angle = A (1 - cos(w t)) / 2
        let (a, w) = (90f64.to_radians(), std::f64::consts::PI);
        for t_s in [0.0, 0.3, 0.5, 1.0, 1.7] {
            let angular_velocity_rad_s = 0.5 * a * w * libm::sin(w * t_s);
            let angular_acceleration_rad_s2 = 0.5 * a * w * w * libm::cos(w * t_s);
            let k = imu.kinematics(seconds(t_s));
            assert!(
                (k.angular_velocity_rad_s - Vector3::new(0.0, 0.0, angular_velocity_rad_s)).norm() < 1e-6,
                "{k:?}"
            );
            // Sensor axes: w' x lever + w x (w x lever), w the angular velocity, and gravity.
            let specific_force_m_s2 = Vector3::new(
                -angular_acceleration_rad_s2 * 0.25,
                -angular_velocity_rad_s * angular_velocity_rad_s * 0.25,
                GRAVITY_M_S2,
            );
            assert!(
                (k.specific_force_m_s2 - specific_force_m_s2).norm() < 1e-5,
                "{k:?} {specific_force_m_s2:?}"
            );
        }
    }

    #[test]
    fn integrated_measurements_are_the_motion() {
        // Strapdown over two seconds of walking, with a lever arm: 1 ms steps of the mid-point rule.
        let mount = Isometry3::new(Vector3::new(0.1, -0.05, 0.2), Vector3::new(0.4, -0.3, 0.9));
        let imu = imu(Motion::Walk(Walk::default()), mount, &ImuErrors::default());
        let pose = |t_s: f64| imu.kinematics(seconds(t_s)).pose;
        let (start_s, dt_s) = (1.0, 1e-3);
        let mut q = pose(start_s).rotation;
        let mut p = pose(start_s).translation.vector;
        let mut v =
            (pose(start_s + 1e-5).translation.vector - pose(start_s - 1e-5).translation.vector) / 2e-5;
        for i in 0..2000 {
            let k = imu.kinematics(seconds(start_s + (f64::from(i) + 0.5) * dt_s));
            let half = UnitQuaternion::from_scaled_axis(0.5 * dt_s * k.angular_velocity_rad_s);
            let a = (q * half) * k.specific_force_m_s2 - Vector3::new(0.0, 0.0, GRAVITY_M_S2);
            q = q * half * half;
            p += dt_s * v + 0.5 * dt_s * dt_s * a;
            v += dt_s * a;
        }
        let end = pose(start_s + 2.0);
        assert!(q.angle_to(&end.rotation) < 1e-5, "{}", q.angle_to(&end.rotation));
        assert!((p - end.translation.vector).norm() < 1e-4, "{p:?} {:?}", end.translation);
    }

    #[test]
    fn same_seed_same_noise_and_the_mean_of_samples_is_quieter() {
        let errors = ImuErrors {
            gyroscope: AxisErrors { noise_density: 0.1, ..AxisErrors::default() },
            ..ImuErrors::of(ImuClass::Mtx)
        };
        let new = || imu(Motion::Still(Still::default()), Isometry3::identity(), &errors);
        let (mut a, mut b) = (new(), new());
        let mut mean_of_four = 0.0;
        for i in 0..1000 {
            let samples: Vec<Inertial> =
                (0..4).map(|k| a.measure(seconds(f64::from(4 * i + k) * 2.5e-3), 2.5e-3)).collect();
            for sample in &samples {
                let k = samples.iter().position(|other| other == sample).unwrap() as i32;
                assert_eq!(*sample, b.measure(seconds(f64::from(4 * i + k) * 2.5e-3), 2.5e-3));
            }
            let mean = Inertial::mean(&samples).unwrap();
            mean_of_four += mean.angular_velocity_rad_s.norm_squared() / 3000.0;
        }
        // 0.1^2 / (2 x 10 ms)
        assert!((mean_of_four / 0.5 - 1.0).abs() < 0.1, "{mean_of_four}");
        assert_eq!(a.truth(seconds(1.0)).sensor, 3);
    }
}
