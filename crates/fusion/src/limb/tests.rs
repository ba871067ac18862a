//! Closed forms first: the recursion against differentiated poses, every Jacobian against differences, ranks;
//! then the filter on matched simulations.

use nalgebra::{DMatrix, Matrix3, SMatrix, SVector, UnitQuaternion, Vector3};

use super::chain::Motion;
use super::joint::Joint;
use super::*;
use crate::testing::{Random, consistency};
use posed_geometry::GRAVITY_M_S2;
use posed_geometry::so3;

type V = Vector3<f64>;
type Q = UnitQuaternion<f64>;
type EulerArm = Limb<Axes<3>, 2, 15>;

fn geometry() -> LimbGeometry {
    LimbGeometry {
        base_to_joint_m: V::new(0.02, 0.4, 0.18),
        upper_imu_m: V::new(0.03, -0.15, 0.04),
        upper_to_lower_m: V::new(0.0, -0.3, 0.01),
        lower_imu_m: V::new(0.02, -0.2, 0.03),
        upper_mount: so3::exp(&V::new(0.3, -0.2, 0.5)),
        mount_sigma_rad: [V::zeros(); 2],
        lower_mount: so3::exp(&V::new(-0.4, 0.6, 0.1)),
    }
}

fn elbow_axes() -> [V; 2] {
    let carry = so3::exp(&V::new(0.2, 0.0, 0.0));
    [V::z(), carry * V::y()]
}

const FREE: [SVector<f64, 2>; 2] = [SVector::<f64, 2>::new(-1e3, -1e3), SVector::<f64, 2>::new(1e3, 1e3)];

/// A motion given by functions of time, and what it gives by numeric differentiation.
struct Scripted;

impl Scripted {
    const GRAVITY: V = V::new(0.0, 0.0, -GRAVITY_M_S2);

    fn base(t: f64) -> (Q, V) {
        let q =
            so3::exp(&V::new(0.3 * libm::sin(1.1 * t), 0.5 * libm::cos(0.7 * t), 0.4 * libm::sin(1.3 * t)));
        (q, V::new(0.2 * libm::sin(1.9 * t), 0.3 * libm::cos(1.2 * t), 0.1 * libm::sin(2.3 * t)))
    }
    fn upper(t: f64) -> Q {
        so3::exp(&V::new(libm::sin(1.7 * t), 0.8 * libm::cos(1.1 * t + 0.3), 0.9 * libm::sin(0.9 * t)))
    }
    fn lower(t: f64) -> [f64; 2] {
        [0.8 + 0.6 * libm::sin(2.1 * t), 0.5 * libm::cos(1.4 * t)]
    }
    /// Pose of the base's IMU, the upper and the lower one; orientations of the segments.
    fn pose(which: usize, t: f64) -> (Q, V) {
        let g = geometry();
        let (q_base, p_base) = Self::base(t);
        if which == 0 {
            return (q_base, p_base);
        }
        let shoulder = p_base + q_base * g.base_to_joint_m;
        let q_upper = q_base * Self::upper(t);
        if which == 1 {
            return (q_upper, shoulder + q_upper * g.upper_imu_m);
        }
        let [a, b] = Self::lower(t);
        let [z, y] = elbow_axes();
        let q_lower = q_upper * so3::exp(&(z * a)) * so3::exp(&(y * b));
        (q_lower, shoulder + q_upper * g.upper_to_lower_m + q_lower * g.lower_imu_m)
    }
    /// Angular velocity and specific force in segment axes, by five points.
    fn measure(which: usize, t: f64) -> (V, V) {
        let h = 1e-3;
        let (q, _) = Self::pose(which, t);
        let rotation_vector_rad = |s: f64| so3::log(&(q.inverse() * Self::pose(which, t + s).0));
        let angular_velocity_rad_s = (rotation_vector_rad(-2.0 * h) - rotation_vector_rad(2.0 * h)
            + (rotation_vector_rad(h) - rotation_vector_rad(-h)) * 8.0)
            / (12.0 * h);
        let p = |s: f64| Self::pose(which, t + s).1;
        let accel = ((p(h) + p(-h)) * 16.0 - p(2.0 * h) - p(-2.0 * h) - p(0.0) * 30.0) / (12.0 * h * h);
        (angular_velocity_rad_s, q.inverse() * (accel - Self::GRAVITY))
    }
    fn derivative(f: impl Fn(f64) -> V, t: f64) -> V {
        let h = 1e-3;
        (f(t - 2.0 * h) - f(t + 2.0 * h) + (f(t + h) - f(t - h)) * 8.0) / (12.0 * h)
    }
    fn base_at(t: f64) -> Base {
        let (angular_velocity_rad_s, specific_force_m_s2) = Self::measure(0, t);
        Base {
            q_room_base: Self::base(t).0,
            angular_velocity_rad_s,
            accel_rad_s2: Self::derivative(|t| Self::measure(0, t).0, t),
            specific_force_m_s2,
            angular_velocity_sigma_rad_s: 0.0,
            specific_force_sigma_m_s2: 0.0,
        }
    }
    fn ball_at(t: f64) -> Ball {
        let angular_velocity_rad_s = |t: f64| {
            let q = Self::upper(t);
            Self::derivative(|s| so3::log(&(q.inverse() * Self::upper(s))), t)
        };
        Ball {
            q: Self::upper(t),
            angular_velocity_rad_s: angular_velocity_rad_s(t),
            accel_rad_s2: Self::derivative(angular_velocity_rad_s, t),
        }
    }
    fn elbow_at(t: f64) -> Axes<2> {
        let mut elbow = Axes::new(elbow_axes());
        let h = 1e-3;
        for i in 0..2 {
            let f = |s: f64| Self::lower(t + s)[i];
            elbow.angle_rad[i] = f(0.0);
            elbow.angular_velocity_rad_s[i] = (f(-2.0 * h) - f(2.0 * h) + (f(h) - f(-h)) * 8.0) / (12.0 * h);
            elbow.accel_rad_s2[i] =
                ((f(h) + f(-h)) * 16.0 - f(2.0 * h) - f(-2.0 * h) - f(0.0) * 30.0) / (12.0 * h * h);
        }
        elbow
    }
    fn arm_at(t: f64) -> Arm {
        Arm::new(geometry(), LimbNoise::default(), Self::ball_at(t), Self::elbow_at(t), FREE, 0.1)
    }
}

/// The same posture with three axes above.
fn euler_arm() -> EulerArm {
    let mut shoulder = Axes::new([V::y(), V::x(), V::y()]);
    shoulder.angle_rad = SVector::<f64, 3>::new(0.4, 0.9, -0.3);
    shoulder.angular_velocity_rad_s = SVector::<f64, 3>::new(1.1, -0.7, 0.5);
    shoulder.accel_rad_s2 = SVector::<f64, 3>::new(-3.0, 4.0, 2.0);
    EulerArm::new(geometry(), LimbNoise::default(), shoulder, Scripted::elbow_at(0.7), FREE, 0.1)
}

#[test]
fn the_recursion_agrees_with_differentiated_poses() {
    for t in [0.1, 0.9, 2.3, 4.4] {
        let (arm, base, g) = (Scripted::arm_at(t), Scripted::base_at(t), geometry());
        for (which, mount) in [(Which::Upper, g.upper_mount), (Which::Lower, g.lower_mount)] {
            let prediction = arm.predict_sample(which, &base, None);
            let (angular_velocity_rad_s, specific_force_m_s2) = Scripted::measure(which as usize + 1, t);
            let (angular_velocity_rad_s, specific_force_m_s2) =
                (mount.inverse() * angular_velocity_rad_s, mount.inverse() * specific_force_m_s2);
            assert!((prediction.gyro - angular_velocity_rad_s).norm() < 1e-6, "gyro {which:?} at {t}");
            assert!((prediction.accel - specific_force_m_s2).norm() < 1e-6, "accel {which:?} at {t}");
        }
    }
}

/// Largest difference between analytic and central-difference derivatives, relative to the largest entry.
fn jacobian_error<J: Joint<N> + Clone, const D: usize, const N: usize>(
    limb: &Limb<J, D, N>,
    base: &Base,
) -> f64 {
    let mut limb = limb.clone();
    limb.p.depends = true;
    let limb = &limb;
    let reference = FieldReference { azimuth_rad: 1.2, norm: 45.0, dip_rad: 1.0 };
    let mut worst = 0.0_f64;
    for which in [Which::Upper, Which::Lower] {
        // A field that passes for the reference's in this posture.
        let mount = if which == Which::Upper { geometry().upper_mount } else { geometry().lower_mount };
        let q = base.q_room_base * limb.orientations()[which as usize] * mount;
        let mag = q.inverse()
            * V::new(45.0 * libm::cos(1_f64) * 0.6, 45.0 * libm::cos(1_f64) * 0.8, -45.0 * libm::sin(1_f64));
        let sample = |limb: &Limb<J, D, N>| {
            let p = limb.predict_sample(which, base, Some((&reference, mag)));
            (p.gyro, p.accel, p.azimuth.unwrap())
        };
        let analytic = limb.predict_sample(which, base, Some((&reference, mag)));
        let scale = analytic.d_accel.amax();
        for column in 0..N {
            let step = 1e-5;
            let at = |sign: f64| {
                let mut limb = limb.clone();
                let mut dx = SVector::<f64, N>::zeros();
                dx[column] = sign * step;
                limb.correct(&dx);
                sample(&limb)
            };
            let (plus, minus) = (at(1.0), at(-1.0));
            let gyro = (plus.0 - minus.0) / (2.0 * step) - analytic.d_gyro.column(column);
            let accel = (plus.1 - minus.1) / (2.0 * step) - analytic.d_accel.column(column);
            worst = worst.max(gyro.amax() / scale.max(1.0)).max(accel.amax() / scale.max(1.0));
        }
        let known = &analytic.dependence;
        for parameter in 0..PARAMETERS {
            let step = 1e-5;
            let at = |sign: f64| {
                let mut limb = limb.clone();
                let mut moved = SVector::<f64, PARAMETERS>::zeros();
                moved[parameter] = sign * step;
                limb.geometry.correct(&moved);
                sample(&limb)
            };
            let (plus, minus) = (at(1.0), at(-1.0));
            let gyro = (plus.0 - minus.0) / (2.0 * step) - known.gyro.row(parameter).transpose();
            let accel = (plus.1 - minus.1) / (2.0 * step) - known.accel.row(parameter).transpose();
            let azimuth =
                (plus.2 - minus.2) / (2.0 * step) - (known.azimuth[0] + known.azimuth[1])[parameter];
            worst = worst.max(gyro.amax() / scale.max(1.0)).max(accel.amax() / scale.max(1.0));
            worst = worst.max(azimuth.abs());
        }
        // The azimuth's row is the rotation about the vertical alone.
        let q_frame = base.q_room_base * limb.orientations()[which as usize];
        for column in 0..N {
            let step = 1e-6;
            let at = |sign: f64| {
                let mut limb = limb.clone();
                let mut dx = SVector::<f64, N>::zeros();
                dx[column] = sign * step;
                limb.correct(&dx);
                so3::log(&(base.q_room_base * limb.orientations()[which as usize] * q_frame.inverse())).z
            };
            let difference = (at(1.0) - at(-1.0)) / (2.0 * step);
            worst = worst.max((difference - analytic.d_azimuth[column]).abs());
        }
    }
    worst
}

#[test]
fn jacobians_agree_with_central_differences() {
    for t in [0.1, 0.9, 2.3] {
        let base = Scripted::base_at(t);
        let error = jacobian_error(&Scripted::arm_at(t), &base);
        assert!(error < 1e-6, "arm at {t}: {error}");
        let error = jacobian_error(&euler_arm(), &base);
        assert!(error < 1e-6, "Euler arm at {t}: {error}");
        let mut knee = Axes::new([V::z()]);
        knee.angle_rad[0] = -0.7;
        knee.angular_velocity_rad_s[0] = 2.0;
        let limits = [SVector::<f64, 1>::repeat(-9.0), SVector::<f64, 1>::repeat(9.0)];
        let leg = Leg::new(geometry(), LimbNoise::default(), Scripted::ball_at(t), knee, limits, 0.1);
        let error = jacobian_error(&leg, &base);
        assert!(error < 1e-6, "leg at {t}: {error}");
    }
}

/// A rotation of the room by a small `phi` moves a measured azimuth by (-m_z m_x, -m_z m_y, h2) phi / h2.
#[test]
fn the_azimuth_turns_as_the_sheet_says() {
    let m = V::new(12.0, -9.0, -41.0);
    let h2 = m.x * m.x + m.y * m.y;
    let row = V::new(-m.z * m.x / h2, -m.z * m.y / h2, 1.0);
    for i in 0..3 {
        let mut phi = V::zeros();
        phi[i] = 1e-6;
        let (plus, minus) = (so3::exp(&phi) * m, so3::exp(&-phi) * m);
        let difference = (libm::atan2(plus.y, plus.x) - libm::atan2(minus.y, minus.x)) / 2e-6;
        assert!((difference - row[i]).abs() < 1e-6);
    }
}

/// Derivative of a prediction by `tau`, by central differences.
fn transition<J: Joint<N> + Clone, const D: usize, const N: usize>(
    limb: &Limb<J, D, N>,
    tau: f64,
    difference: impl Fn(&Limb<J, D, N>, &Limb<J, D, N>) -> SVector<f64, N>,
) -> SMatrix<f64, N, N> {
    let mut f = SMatrix::<f64, N, N>::zeros();
    let mut nominal = limb.clone();
    nominal.predict(tau);
    for column in 0..N {
        let at = |sign: f64| {
            let mut limb = limb.clone();
            let mut dx = SVector::<f64, N>::zeros();
            dx[column] = sign * 1e-6;
            limb.correct(&dx);
            limb.predict(tau);
            difference(&nominal, &limb)
        };
        f.set_column(column, &((at(1.0) - at(-1.0)) / 2e-6));
    }
    f
}

/// Error state of `other` relative to `limb`.
fn difference<J: Upper<N>, const D: usize, const N: usize>(
    limb: &Limb<J, D, N>,
    other: &Limb<J, D, N>,
) -> SVector<f64, N> {
    let begin = Limb::<J, D, N>::LOWER;
    let mut dx = SVector::<f64, N>::zeros();
    let mut put = |at: usize, part: V| dx.fixed_rows_mut::<3>(at).copy_from(&part);
    for (k, part) in limb.upper.off(&other.upper).into_iter().enumerate() {
        put(3 * k, part);
    }
    let mut put = |at: usize, part: SVector<f64, D>| dx.fixed_rows_mut::<D>(at).copy_from(&part);
    put(begin, other.lower.angle_rad - limb.lower.angle_rad);
    put(begin + D, other.lower.angular_velocity_rad_s - limb.lower.angular_velocity_rad_s);
    put(begin + 2 * D, other.lower.accel_rad_s2 - limb.lower.accel_rad_s2);
    dx
}

fn arm_difference(arm: &Arm, other: &Arm) -> SVector<f64, 15> {
    difference(arm, other)
}

#[test]
fn the_covariance_is_predicted_with_the_transitions_derivative() {
    let mut arm = Scripted::arm_at(0.9);
    arm.noise.joint.jerk_rad_s3 = 0.0;
    // A covariance without structure, so that every entry of F counts.
    let a = SMatrix::<f64, 15, 15>::from_fn(|i, j| libm::sin((7 * i + 3 * j) as f64));
    arm.p = Covariance::of(a * a.transpose());
    let tau = 0.01;
    let f = transition(&arm, tau, arm_difference);
    let expected = f * arm.p.own * f.transpose();
    arm.predict(tau);
    assert!((arm.p.own - expected).amax() < 1e-6 * expected.amax());
    assert_eq!(arm.p.own, arm.p.own.transpose());
}

#[test]
fn josephs_form_equals_the_textbook_update() {
    let a = SMatrix::<f64, 15, 15>::from_fn(|i, j| libm::sin((5 * i + 11 * j) as f64));
    let before = a * a.transpose() + SMatrix::identity();
    let mut p = Covariance::of(before);
    let h = SMatrix::<f64, 3, 15>::from_fn(|i, j| if j < 9 { libm::cos((i + 4 * j) as f64) } else { 0.0 });
    let noise = V::new(0.5, 1.0, 2.0);
    let innovation = p.innovation(&h, 9, &SMatrix::zeros());
    let residual = V::new(1.0, -2.0, 0.5);
    let inverse = innovation.inverse(&noise).unwrap();
    let dx = p.update(&innovation, &inverse, &residual, &noise);
    let s = h * before * h.transpose() + Matrix3::from_diagonal(&noise);
    let gain = before * h.transpose() * s.try_inverse().unwrap();
    assert!((dx - gain * residual).amax() < 1e-9);
    assert!((p.own - (before - gain * h * before)).amax() < 1e-9);
    assert_eq!(p.own, p.own.transpose());
}

/// Number of directions that the two IMUs can see over two seconds, with or without a field, moving or not.
fn rank(moving: bool, field: bool, rest: bool) -> usize {
    let tau = 0.02;
    let mut rows: Vec<SMatrix<f64, 1, 15>> = Vec::new();
    let mut f = SMatrix::<f64, 15, 15>::identity();
    for k in 0..100 {
        let t = if moving { 0.3 + tau * f64::from(k) } else { 0.3 };
        let mut arm = Scripted::arm_at(t);
        arm.noise.joint.accel_tau_s = f64::INFINITY;
        let mut base = Scripted::base_at(t);
        if !moving {
            arm.upper.angular_velocity_rad_s.fill(0.0);
            arm.upper.accel_rad_s2.fill(0.0);
            arm.lower.angular_velocity_rad_s.fill(0.0);
            arm.lower.accel_rad_s2.fill(0.0);
            base.angular_velocity_rad_s.fill(0.0);
            base.accel_rad_s2.fill(0.0);
            base.specific_force_m_s2 = base.q_room_base.inverse() * (V::z() * GRAVITY_M_S2);
        }
        let reference = FieldReference { azimuth_rad: 0.0, norm: 1.0, dip_rad: 0.0 };
        for which in [Which::Upper, Which::Lower] {
            let prediction = arm.predict_sample(which, &base, Some((&reference, V::x())));
            for i in 0..3 {
                rows.push(prediction.d_gyro.fixed_view::<1, 15>(i, 0) * f);
                rows.push(prediction.d_accel.fixed_view::<1, 15>(i, 0) * f * 0.1);
            }
            if rest {
                for column in (3..6).chain(11..13) {
                    rows.push(f.fixed_view::<1, 15>(column, 0).into_owned());
                }
            }
            if field {
                rows.push(prediction.d_azimuth * f);
            }
        }
        f = transition(&arm, tau, arm_difference) * f;
    }
    // Accelerations of some rad/s² move little: scale them to the size of the angles.
    let scale = |j: usize| if (6..9).contains(&j) || (13..15).contains(&j) { 5.0 } else { 1.0 };
    let matrix = DMatrix::from_fn(rows.len(), 15, |i, j| rows[i][j] * scale(j));
    let singular = matrix.svd(false, false).singular_values;
    singular.iter().filter(|s| **s > 1e-5 * singular.max()).count()
}

#[test]
fn only_the_heading_of_a_limb_at_rest_without_a_field_is_lost() {
    assert_eq!(rank(true, true, false), 15);
    assert_eq!(rank(true, false, false), 15);
    assert_eq!(rank(false, true, false), 15);
    assert_eq!(rank(false, false, true), 14);
    assert_eq!(rank(false, false, false), 14);
}

#[test]
fn three_axes_lose_directions_where_two_of_them_meet() {
    let determinant = |middle: f64| {
        let mut arm = euler_arm();
        arm.upper.angle_rad[1] = middle;
        let mut motion = Motion::<15>::of_base(V::zeros(), V::zeros(), V::zeros());
        arm.upper.rotate(&mut motion, 0);
        motion.d_rotation.fixed_view::<3, 3>(0, 0).determinant().abs()
    };
    assert!(determinant(0.9) > 0.5);
    assert!(determinant(0.0) < 1e-12);
}

/// An upper joint of either form.
trait Upper<const N: usize>: Joint<N> + Clone {
    fn still() -> Self;
    /// Rotation, angular velocity and acceleration of `other` as errors of this one.
    fn off(&self, other: &Self) -> [V; 3];
}

impl<const N: usize> Upper<N> for Ball {
    fn still() -> Self {
        Self { q: Q::identity(), angular_velocity_rad_s: V::zeros(), accel_rad_s2: V::zeros() }
    }

    fn off(&self, other: &Self) -> [V; 3] {
        [
            so3::log(&(self.q.inverse() * other.q)),
            other.angular_velocity_rad_s - self.angular_velocity_rad_s,
            other.accel_rad_s2 - self.accel_rad_s2,
        ]
    }
}

impl<const N: usize> Upper<N> for Axes<3> {
    fn still() -> Self {
        let mut axes = Axes::new([V::z(), V::x(), V::y()]);
        axes.angle_rad = V::new(0.3, 0.2, -0.1);
        axes
    }

    fn off(&self, other: &Self) -> [V; 3] {
        [
            other.angle_rad - self.angle_rad,
            other.angular_velocity_rad_s - self.angular_velocity_rad_s,
            other.accel_rad_s2 - self.accel_rad_s2,
        ]
    }
}

/// A limb that moves as the filter assumes, what its sensors say, and a filter begun beside it.
struct Matched<J, const D: usize, const N: usize> {
    truth: Limb<J, D, N>,
    filter: Limb<J, D, N>,
    random: Random,
    t: f64,
}

impl Matched<Ball, 2, 15> {
    fn new(seed: u64) -> Self {
        let mut elbow = Axes::new(elbow_axes());
        elbow.angle_rad[0] = 1.0;
        Self::with(Random::new(seed), elbow)
    }
}

impl<J: Upper<N>, const D: usize, const N: usize> Matched<J, D, N> {
    const DT: f64 = 0.01;

    fn with(mut random: Random, lower: Axes<D>) -> Self {
        let noise = LimbNoise {
            joint: JointNoise { jerk_rad_s3: 20.0, accel_tau_s: 0.3 },
            gyro_rad_s: 0.01,
            accel_m_s2: 0.1,
            ..LimbNoise::default()
        };
        let free = [SVector::<f64, D>::repeat(-1e3), SVector::<f64, D>::repeat(1e3)];
        let mut filter = Limb::<J, D, N>::new(geometry(), noise, J::still(), lower, free, 0.1);
        // Known start but for the stated uncertainty.
        for i in 0..N {
            let begin = Limb::<J, D, N>::LOWER;
            let after = |at: usize| (begin + at * D..begin + (at + 1) * D).contains(&i);
            let small = match i {
                _ if i < 3 || after(0) => 0.03,
                _ if (3..6).contains(&i) || after(1) => 0.1,
                _ => 1.0,
            };
            filter.p.own[(i, i)] = small * small;
        }
        let mut truth = filter.clone();
        let dx = SVector::<f64, N>::from_fn(|i, _| filter.p.own[(i, i)].sqrt() * random.normal());
        truth.correct(&dx);
        Self { truth, filter, random, t: 0.0 }
    }

    fn step(&mut self) -> [SensorReport; 2] {
        self.t += Self::DT;
        // The process noise of one step, from the filter's own Q.
        let mut q = self.truth.clone();
        q.p = Covariance::of(SMatrix::zeros());
        q.predict(Self::DT);
        let root = (q.p.own + SMatrix::identity() * 1e-18).cholesky().unwrap().l();
        let w = root * SVector::<f64, N>::from_fn(|_, _| self.random.normal());
        self.truth.predict(Self::DT);
        self.truth.correct(&w);
        let base = Scripted::base_at(self.t);
        let field = V::new(0.0, 17.0, -42.0);
        let reference = FieldReference {
            azimuth_rad: std::f64::consts::FRAC_PI_2,
            norm: field.norm(),
            dip_rad: libm::atan(42.0_f64 / 17.0),
        };
        let g = geometry();
        let mut samples = [None, None];
        for (which, mount) in [(Which::Upper, g.upper_mount), (Which::Lower, g.lower_mount)] {
            let p = self.truth.predict_sample(which, &base, None);
            let q = base.q_room_base * self.truth.orientations()[which as usize] * mount;
            // The azimuth alone is noisy, as the filter assumes.
            let turned = so3::exp(&(V::z() * (self.truth.noise.heading_rad * self.random.normal()))) * field;
            samples[which as usize] = Some(ImuSample {
                gyro_rad_s: p.gyro + self.random.vector() * 0.01,
                accel_m_s2: p.accel + self.random.vector() * 0.1,
                mag: Some(q.inverse() * turned),
            });
        }
        let samples = LimbSamples { upper: samples[0], lower: samples[1] };
        self.filter.push(&base, Some(&reference), &samples, Self::DT)
    }

    fn nees(&self) -> f64 {
        let e = difference(&self.filter, &self.truth);
        e.dot(&self.filter.p.own.cholesky().unwrap().solve(&e))
    }
}

/// Share of the steps that are consistent in a matched model.
fn matched<J: Upper<N>, const D: usize, const N: usize>(lower: &Axes<D>, (low, high): (f64, f64)) -> f64 {
    consistency(200, &(low..high), |random| {
        let mut matched = Matched::<J, D, N>::with(random, lower.clone());
        let step = |_| {
            matched.step();
            matched.nees()
        };
        (0..150).map(step).collect()
    })
}

#[test]
fn arm_and_leg_are_consistent_in_a_matched_model() {
    // 95 % of chi squared with 200 times 15 and 12 degrees of freedom, over 200.
    let mut elbow = Axes::new(elbow_axes());
    elbow.angle_rad[0] = 1.0;
    let inside = matched::<Ball, 2, 15>(&elbow, (14.25, 15.77));
    assert!(inside >= 0.9, "arm: {inside}");
    let inside = matched::<Axes<3>, 2, 15>(&elbow, (14.25, 15.77));
    assert!(inside >= 0.9, "Euler arm: {inside}");
    let mut knee = Axes::new([-V::z()]);
    knee.angle_rad[0] = 0.6;
    let inside = matched::<Ball, 1, 12>(&knee, (11.33, 12.69));
    assert!(inside >= 0.9, "leg: {inside}");
    let inside = matched::<Axes<3>, 1, 12>(&knee, (11.33, 12.69));
    assert!(inside >= 0.9, "Euler leg: {inside}");
}

#[test]
fn a_missing_sensor_goes_stale_and_the_other_goes_on() {
    let mut matched = Matched::new(5);
    for _ in 0..50 {
        matched.step();
    }
    let base = Scripted::base_at(matched.t);
    let mut filter = matched.filter.clone();
    let upper = ImuSample { gyro_rad_s: V::zeros(), accel_m_s2: base.specific_force_m_s2, mag: None };
    let mut stale_after = None;
    for k in 0..80 {
        let samples = LimbSamples { upper: Some(upper), lower: None };
        let reports = filter.push(&base, None, &samples, 0.01);
        assert!(!reports[0].stale);
        if reports[1].stale && stale_after.is_none() {
            stale_after = Some(k);
        }
    }
    assert!(matches!(stale_after, Some(48..=50)), "{stale_after:?}");
    assert!(filter.p.own.cholesky().is_some());
}

#[test]
fn a_broken_sample_is_reported_and_not_used() {
    let mut matched = Matched::new(6);
    matched.step();
    let base = Scripted::base_at(matched.t);
    let broken = ImuSample { gyro_rad_s: V::repeat(f64::NAN), accel_m_s2: V::zeros(), mag: None };
    let samples = LimbSamples { upper: Some(broken), lower: None };
    let reports = matched.filter.push(&base, None, &samples, 0.01);
    assert!(reports[0].broken && reports[0].gyro_nis.is_none());
    assert!(matched.filter.orientations()[1].coords.iter().all(|v| v.is_finite()));
}

#[test]
fn a_blow_is_gated_and_a_saturated_axis_dropped() {
    let mut matched = Matched::new(9);
    for _ in 0..100 {
        matched.step();
    }
    let base = Scripted::base_at(matched.t);
    let g = geometry();
    let mut filter = matched.filter.clone();
    let p = filter.predict_sample(Which::Upper, &base, None);
    let blow = ImuSample { gyro_rad_s: p.gyro, accel_m_s2: p.accel + V::repeat(30.0), mag: None };
    let reports = filter.push(&base, None, &LimbSamples { upper: Some(blow), lower: None }, 1e-4);
    assert!(reports[0].accel_gated);
    // What it shows beside is the gyro's, as if it had measured no acceleration: each of its axes was beyond the range.
    let mut without = matched.filter.clone();
    let none = ImuSample { accel_m_s2: V::repeat(filter.noise.accel_range_m_s2), ..blow };
    without.push(&base, None, &LimbSamples { upper: Some(none), lower: None }, 1e-4);
    assert!(filter.upper.q.angle_to(&without.upper.q) < 1e-6);

    let mut filter = matched.filter.clone();
    let saturated = V::new(p.accel.x, p.accel.y, filter.noise.accel_range_m_s2);
    let sample = ImuSample { gyro_rad_s: p.gyro, accel_m_s2: saturated, mag: None };
    let reports = filter.push(&base, None, &LimbSamples { upper: Some(sample), lower: None }, 1e-4);
    assert!(!reports[0].accel_gated, "the two other axes are fine");
    let _ = g;
}

#[test]
fn a_limit_pulls_back_without_clamping() {
    let mut matched = Matched::new(3);
    matched.filter.limits = [SVector::<f64, 2>::repeat(0.0), SVector::<f64, 2>::repeat(2.5)];
    matched.filter.lower.angle_rad[0] = -0.3;
    let before = matched.filter.lower.angle_rad[0];
    matched.filter.keep_limits();
    let after = matched.filter.lower.angle_rad[0];
    assert!(before < after && after < 0.0, "{before} to {after}");
}

#[test]
fn rest_holds_the_angular_velocities_at_zero() {
    let mut matched = Matched::new(4);
    matched.filter.upper.angular_velocity_rad_s = V::new(0.3, -0.2, 0.1);
    matched.filter.observe_rest();
    assert!(matched.filter.upper.angular_velocity_rad_s.norm() < 0.01);
}
