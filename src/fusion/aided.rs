//! A sensor that has both a magnetic pose and an IMU, as one filter.
//!
//! In: IMU samples and magnetic poses, each with its capture time; poses may come up to 0.3 s late. Out: pose, velocity and
//! their uncertainty at the time of the latest IMU sample. It coasts through half a second without magnetic poses, and it
//! never decides on which side of the transmitter a pose is: it only gates.
//!
//! Error state, 15: position, velocity (room), turn, gyro bias, accelerometer bias (IMU axes); the turn is local,
//! `R = R_hat exp(turn)`. A late pose is taken at its own time: the filter goes back to the states it has kept and runs
//! forward again over the samples since. Where the two clocks differ by a constant, `offset_s` of the pose's time stands for it.

use std::collections::VecDeque;

use nalgebra::{Isometry3, Matrix3, SMatrix, SVector, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use super::ahrs::ImuSample;
use super::limb::GRAVITY_M_S2;
use crate::geometry::so3::{exp, hat, log};

const N: usize = 15;
const P: usize = 0;
const V: usize = 3;
const R: usize = 6;
const BG: usize = 9;
const BA: usize = 12;
/// 99.9 % of chi squared with 6 degrees of freedom.
const GATE_6: f64 = 22.5;
/// So many poses in a row outside the gate begin anew: then it is the prediction that is wrong.
const RESTART: u32 = 10;
/// Most samples that are kept: 0.3 s at 1 kHz.
const MOST_KEPT: usize = 300;

/// What the filter assumes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct AidedParams {
    /// From the IMU to the magnetic sensor, IMU axes, m.
    pub lever_m: Vector3<f64>,
    /// Turns the magnetic sensor's coordinates into the IMU's.
    pub q_imu_sensor: UnitQuaternion<f64>,
    /// Capture time of a magnetic pose on the IMU's clock minus the time it is given with, s.
    pub offset_s: f64,
    /// Density of the gyro's noise, rad/s per sqrt(Hz).
    pub gyro_density: f64,
    /// Density of the accelerometer's noise, m/s² per sqrt(Hz).
    pub accel_density: f64,
    /// Random walks of the biases, rad/s and m/s² per sqrt(s).
    pub bias_walks: [f64; 2],
    /// Initial standard deviations of the biases, rad/s and m/s².
    pub bias_sigmas: [f64; 2],
    /// How long IMU samples are kept for late poses, s.
    pub history_s: f64,
    /// How long the pose stands without a magnetic one, s.
    pub coast_s: f64,
}

impl Default for AidedParams {
    fn default() -> Self {
        Self {
            lever_m: Vector3::zeros(),
            q_imu_sensor: UnitQuaternion::identity(),
            offset_s: 0.0,
            gyro_density: 5e-4,
            accel_density: 5e-3,
            bias_walks: [5e-5, 1e-3],
            bias_sigmas: [0.01, 0.1],
            history_s: 0.3,
            coast_s: 0.5,
        }
    }
}

/// A magnetic pose with its covariances.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MagneticPose {
    /// Capture time, s.
    pub t_s: f64,
    /// Sensor to room.
    pub room_from_sensor: Isometry3<f64>,
    /// Of the position, room axes, m².
    pub position_cov_m2: Matrix3<f64>,
    /// Of the turn about each axis, rad².
    pub rotation_var_rad2: f64,
}

/// What became of a magnetic pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Taken {
    /// Used, or begun with.
    Used,
    /// Too far from the prediction.
    Gated,
    /// The same numbers again.
    Stuck,
    /// Older than what is kept, or not a number.
    Refused,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct State {
    t_s: f64,
    position_m: Vector3<f64>,
    velocity_m_s: Vector3<f64>,
    q: UnitQuaternion<f64>,
    gyro_bias: Vector3<f64>,
    accel_bias: Vector3<f64>,
    covariance: SMatrix<f64, N, N>,
}

/// The filter of one sensor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Aided {
    params: AidedParams,
    state: Option<State>,
    /// States before each sample, and the sample; oldest first.
    history: VecDeque<(State, ImuSample, f64)>,
    last_sample: Option<(f64, ImuSample)>,
    last_pose: Option<Isometry3<f64>>,
    last_used_s: f64,
    gated: u32,
}

impl Aided {
    /// Nothing seen yet.
    pub fn new(params: AidedParams) -> Self {
        Self {
            params,
            state: None,
            history: VecDeque::with_capacity(MOST_KEPT),
            last_sample: None,
            last_pose: None,
            last_used_s: f64::NEG_INFINITY,
            gated: 0,
        }
    }

    /// Takes an IMU sample at its capture time, s. Times that do not rise and numbers that are none change nothing.
    pub fn imu(&mut self, t_s: f64, sample: &ImuSample) {
        let finite = sample.gyro_rad_s.iter().chain(sample.accel_m_s2.iter()).all(|value| value.is_finite());
        let rises = self.last_sample.is_none_or(|(last, _)| t_s > last);
        if !finite || !rises || !t_s.is_finite() {
            return;
        }
        self.last_sample = Some((t_s, *sample));
        let Some(state) = &mut self.state else { return };
        while self.history.front().is_some_and(|(old, _, _)| t_s - old.t_s > self.params.history_s)
            || self.history.len() == MOST_KEPT
        {
            self.history.pop_front();
        }
        self.history.push_back((state.clone(), *sample, t_s));
        state.advance(&self.params, sample, t_s);
    }

    /// Takes a magnetic pose at its own time.
    pub fn magnetic(&mut self, pose: &MagneticPose) -> Taken {
        let t_s = pose.t_s + self.params.offset_s;
        let finite = pose.room_from_sensor.translation.vector.iter().all(|value| value.is_finite())
            && pose.room_from_sensor.rotation.coords.iter().all(|value| value.is_finite());
        if !finite || !t_s.is_finite() {
            return Taken::Refused;
        }
        if self.last_pose == Some(pose.room_from_sensor) {
            return Taken::Stuck;
        }
        self.last_pose = Some(pose.room_from_sensor);
        if self.state.is_none() || t_s - self.last_used_s > 4.0 * self.params.coast_s || self.gated >= RESTART
        {
            return self.begin(pose, t_s);
        }
        // Back to the state before the pose, forward to it, and on over the samples since.
        let at = self.history.partition_point(|(state, _, _)| state.t_s <= t_s);
        let Some(at) = at.checked_sub(1) else { return Taken::Refused };
        let (mut state, sample, end_s) = self.history[at].clone();
        let until = t_s.min(end_s);
        if until > state.t_s {
            state.advance(&self.params, &sample, until);
        }
        if !state.update(&self.params, pose) {
            self.gated += 1;
            return Taken::Gated;
        }
        self.gated = 0;
        self.last_used_s = t_s;
        for k in at..self.history.len() {
            let (_, sample, end_s) = self.history[k];
            if k > at {
                self.history[k].0 = state.clone();
            }
            if end_s > state.t_s {
                state.advance(&self.params, &sample, end_s);
            }
        }
        self.state = Some(state);
        Taken::Used
    }

    /// IMU to room at the latest sample; `None` before the first pose and after coasting too long.
    pub fn pose(&self) -> Option<Isometry3<f64>> {
        let state = self.state.as_ref()?;
        let fresh = state.t_s - self.last_used_s <= self.params.coast_s;
        fresh.then(|| Isometry3::from_parts(Translation3::from(state.position_m), state.q))
    }

    /// The magnetic sensor's pose in the room.
    pub fn sensor_pose(&self) -> Option<Isometry3<f64>> {
        let lever = Isometry3::from_parts(Translation3::from(self.params.lever_m), self.params.q_imu_sensor);
        Some(self.pose()? * lever)
    }

    /// Standard deviations: position about an axis, m, and turn about an axis, rad; root mean square.
    pub fn sigmas(&self) -> Option<(f64, f64)> {
        let p = &self.state.as_ref()?.covariance;
        let mean = |at: usize| ((0..3).map(|i| p[(at + i, at + i)]).sum::<f64>() / 3.0).max(0.0).sqrt();
        Some((mean(P), mean(R)))
    }

    fn begin(&mut self, pose: &MagneticPose, t_s: f64) -> Taken {
        let p = &self.params;
        let q = pose.room_from_sensor.rotation * p.q_imu_sensor.inverse();
        let mut covariance = SMatrix::<f64, N, N>::zeros();
        let [gyro, accel] = p.bias_sigmas;
        for i in 0..3 {
            covariance[(V + i, V + i)] = 1.0;
            covariance[(R + i, R + i)] = pose.rotation_var_rad2;
            covariance[(BG + i, BG + i)] = gyro * gyro;
            covariance[(BA + i, BA + i)] = accel * accel;
        }
        covariance.fixed_view_mut::<3, 3>(P, P).copy_from(&pose.position_cov_m2);
        let (gyro_bias, accel_bias) =
            self.state.as_ref().map_or((Vector3::zeros(), Vector3::zeros()), |s| (s.gyro_bias, s.accel_bias));
        let mut state = State {
            t_s,
            position_m: pose.room_from_sensor.translation.vector - q * p.lever_m,
            velocity_m_s: Vector3::zeros(),
            q,
            gyro_bias,
            accel_bias,
            covariance,
        };
        self.history.clear();
        // The pose is as old as it is: its unknown velocity counts from its own time.
        if let Some((latest_s, sample)) = self.last_sample.filter(|(latest_s, _)| *latest_s > t_s) {
            self.history.push_back((state.clone(), sample, latest_s));
            state.advance(p, &sample, latest_s);
        }
        self.state = Some(state);
        self.last_used_s = t_s;
        self.gated = 0;
        Taken::Used
    }
}

impl State {
    /// Strapdown from this state to `until_s` with one sample, and the covariance with it.
    fn advance(&mut self, params: &AidedParams, sample: &ImuSample, until_s: f64) {
        let dt = until_s - self.t_s;
        if dt.is_nan() || dt <= 0.0 {
            return;
        }
        self.t_s = until_s;
        let turn = (sample.gyro_rad_s - self.gyro_bias) * dt;
        let force = sample.accel_m_s2 - self.accel_bias;
        // The force in the middle of the step.
        let middle = (self.q * exp(&(turn * 0.5))).to_rotation_matrix().into_inner();
        let accel = middle * force - Vector3::z() * GRAVITY_M_S2;
        self.position_m += self.velocity_m_s * dt + accel * (0.5 * dt * dt);
        self.velocity_m_s += accel * dt;
        let step = exp(&turn);
        self.q = UnitQuaternion::new_normalize((self.q * step).into_inner());

        let mut f = SMatrix::<f64, N, N>::identity();
        let set = |f: &mut SMatrix<f64, N, N>, at: (usize, usize), block: Matrix3<f64>| {
            f.fixed_view_mut::<3, 3>(at.0, at.1).copy_from(&block);
        };
        let by_turn = -middle * hat(&force) * dt;
        set(&mut f, (P, V), Matrix3::identity() * dt);
        set(&mut f, (P, R), by_turn * (0.5 * dt));
        set(&mut f, (P, BA), -middle * (0.5 * dt * dt));
        set(&mut f, (V, R), by_turn);
        set(&mut f, (V, BA), -middle * dt);
        set(&mut f, (R, R), step.to_rotation_matrix().into_inner().transpose());
        set(&mut f, (R, BG), -Matrix3::identity() * dt);
        let mut p = f * self.covariance * f.transpose();
        let densities = [
            (V, params.accel_density),
            (R, params.gyro_density),
            (BG, params.bias_walks[0]),
            (BA, params.bias_walks[1]),
        ];
        for (at, density) in densities {
            for i in 0..3 {
                p[(at + i, at + i)] += density * density * dt;
            }
        }
        self.covariance = (p + p.transpose()) * 0.5;
    }

    /// Six rows of a magnetic pose; false where the gate says no.
    fn update(&mut self, params: &AidedParams, pose: &MagneticPose) -> bool {
        let axes = self.q.to_rotation_matrix().into_inner();
        let mut h = SMatrix::<f64, 6, N>::zeros();
        h.fixed_view_mut::<3, 3>(0, P).copy_from(&Matrix3::identity());
        h.fixed_view_mut::<3, 3>(0, R).copy_from(&(-axes * hat(&params.lever_m)));
        h.fixed_view_mut::<3, 3>(3, R).copy_from(&Matrix3::identity());
        let mut residual = SVector::<f64, 6>::zeros();
        let place = pose.room_from_sensor.translation.vector - self.position_m - axes * params.lever_m;
        let measured = pose.room_from_sensor.rotation * params.q_imu_sensor.inverse();
        residual.fixed_rows_mut::<3>(0).copy_from(&place);
        residual.fixed_rows_mut::<3>(3).copy_from(&log(&(self.q.inverse() * measured)));
        let mut noise = SMatrix::<f64, 6, 6>::identity() * pose.rotation_var_rad2;
        noise.fixed_view_mut::<3, 3>(0, 0).copy_from(&pose.position_cov_m2);
        let cross = self.covariance * h.transpose();
        let Some(factor) = (h * cross + noise).cholesky() else { return false };
        if residual.dot(&factor.solve(&residual)) > GATE_6 {
            return false;
        }
        let gain = factor.solve(&cross.transpose()).transpose();
        let dx = gain * residual;
        let keep = SMatrix::<f64, N, N>::identity() - gain * h;
        let p = keep * self.covariance * keep.transpose() + gain * noise * gain.transpose();
        self.covariance = (p + p.transpose()) * 0.5;
        let part = |at: usize| Vector3::new(dx[at], dx[at + 1], dx[at + 2]);
        self.position_m += part(P);
        self.velocity_m_s += part(V);
        self.q = UnitQuaternion::new_normalize((self.q * exp(&part(R))).into_inner());
        self.gyro_bias += part(BG);
        self.accel_bias += part(BA);
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    type V3 = Vector3<f64>;

    struct Normal(u64);

    impl Normal {
        fn uniform(&mut self) -> f64 {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            ((self.0 >> 11) as f64 + 0.5) / (1_u64 << 53) as f64
        }
        fn vector(&mut self, sigma: f64) -> V3 {
            V3::from_fn(|_, _| {
                let (a, b) = (self.uniform(), self.uniform());
                sigma * (-2.0 * a.ln()).sqrt() * (std::f64::consts::TAU * b).cos()
            })
        }
    }

    fn truth(t: f64) -> Isometry3<f64> {
        let turn = V3::new(0.9 * (1.9 * t).sin(), 0.7 * (1.3 * t + 0.4).cos(), 0.9 * (2.7 * t).sin());
        let place = V3::new(0.3 * (1.1 * t).sin(), 0.2 * (1.7 * t).cos(), 1.0 + 0.15 * (2.3 * t).sin());
        Isometry3::from_parts(place.into(), exp(&turn))
    }

    /// Runs a filter over seconds of simulated truth; magnetic poses at 50 Hz come 40 ms late.
    struct Scene {
        filter: Aided,
        normal: Normal,
        gyro_bias: V3,
        accel_bias: V3,
        step: u32,
    }

    const SIGMA_M: f64 = 0.002;
    const SIGMA_RAD: f64 = 0.01;

    impl Scene {
        fn new(seed: u64) -> Self {
            let params = AidedParams {
                lever_m: V3::new(0.02, -0.01, 0.03),
                q_imu_sensor: exp(&V3::new(0.4, -0.9, 0.2)),
                ..AidedParams::default()
            };
            let mut normal = Normal(seed);
            for _ in 0..10 {
                normal.uniform();
            }
            let (gyro_bias, accel_bias) = (normal.vector(0.01), normal.vector(0.1));
            Self { filter: Aided::new(params), normal, gyro_bias, accel_bias, step: 0 }
        }

        fn imu(&mut self, t: f64) -> ImuSample {
            let h = 1e-3;
            let (a, b, c) = (truth(t - h), truth(t), truth(t + h));
            let rate = log(&(a.rotation.inverse() * c.rotation)) / (2.0 * h);
            let accel = (a.translation.vector + c.translation.vector - b.translation.vector * 2.0) / (h * h);
            let n = self.filter.params;
            // A density at 100 Hz.
            ImuSample {
                gyro_rad_s: rate + self.gyro_bias + self.normal.vector(n.gyro_density * 10.0),
                accel_m_s2: b.rotation.inverse() * (accel + V3::z() * GRAVITY_M_S2)
                    + self.accel_bias
                    + self.normal.vector(n.accel_density * 10.0),
                mag: None,
            }
        }

        fn pose(&mut self, t: f64) -> MagneticPose {
            let n = self.filter.params;
            let lever = Isometry3::from_parts(n.lever_m.into(), n.q_imu_sensor);
            let mut room_from_sensor = truth(t) * lever;
            room_from_sensor.translation.vector += self.normal.vector(SIGMA_M);
            room_from_sensor.rotation *= exp(&self.normal.vector(SIGMA_RAD));
            MagneticPose {
                t_s: t,
                room_from_sensor,
                position_cov_m2: Matrix3::identity() * SIGMA_M * SIGMA_M,
                rotation_var_rad2: SIGMA_RAD * SIGMA_RAD,
            }
        }

        /// One step of 10 ms: a sample of the middle of the step, and every second step a late pose if `magnetic`.
        fn next(&mut self, magnetic: bool) -> (f64, Option<Taken>) {
            self.step += 1;
            let t = 0.01 * f64::from(self.step);
            let sample = self.imu(t - 0.005);
            self.filter.imu(t, &sample);
            if magnetic && self.step.is_multiple_of(2) && self.step > 6 {
                let pose = self.pose(t - 0.04);
                return (t, Some(self.filter.magnetic(&pose)));
            }
            (t, None)
        }

        fn error(&self, t: f64) -> (V3, V3) {
            let state = self.filter.state.as_ref().unwrap();
            let expected = truth(t);
            (expected.translation.vector - state.position_m, log(&(state.q.inverse() * expected.rotation)))
        }
    }

    #[test]
    fn it_is_better_than_the_tracker_alone_and_knows_how_good() {
        const RUNS: u64 = 50;
        let (mut nees, mut position, mut turn, mut count) = (0.0, 0.0, 0.0, 0.0);
        for run in 0..RUNS {
            let mut scene = Scene::new(100 + run);
            for k in 0..500 {
                let (t, _) = scene.next(true);
                if k < 300 || k % 20 != 0 {
                    continue;
                }
                let (p, r) = scene.error(t);
                let covariance = scene.filter.state.as_ref().unwrap().covariance;
                let mut e = SVector::<f64, 9>::zeros();
                e.fixed_rows_mut::<3>(0).copy_from(&p);
                e.fixed_rows_mut::<3>(3).copy_from(&r);
                let pick = |i: usize| if i < 3 { i } else { R + i - 3 };
                let block = SMatrix::<f64, 6, 6>::from_fn(|i, j| covariance[(pick(i), pick(j))]);
                let e = e.fixed_rows::<6>(0).into_owned();
                nees += e.dot(&block.cholesky().unwrap().solve(&e)) / 6.0;
                position += p.norm_squared() / 3.0;
                turn += r.norm_squared() / 3.0;
                count += 1.0;
            }
        }
        let (nees, position, turn) = (nees / count, f64::sqrt(position / count), f64::sqrt(turn / count));
        assert!((0.7..1.4).contains(&nees), "{nees}");
        assert!(position < 0.6 * SIGMA_M, "{position} m");
        assert!(turn < 0.4 * SIGMA_RAD, "{turn} rad");
    }

    #[test]
    fn it_coasts_through_a_dropout_and_then_says_that_it_does_not_know() {
        let mut scene = Scene::new(3);
        for _ in 0..500 {
            scene.next(true);
        }
        let mut last_known = 0;
        for k in 1..=80 {
            let (t, _) = scene.next(false);
            if scene.filter.pose().is_some() {
                last_known = k;
                let (p, r) = scene.error(t);
                assert!(p.norm() < 0.02 && r.norm() < 0.02, "{} m, {} rad after {k}", p.norm(), r.norm());
            }
        }
        assert!((44..=50).contains(&last_known), "{last_known}");
        for _ in 0..6 {
            scene.next(true);
        }
        assert!(scene.filter.pose().is_some());
    }

    #[test]
    fn what_cannot_be_is_gated_and_what_repeats_is_dropped() {
        let mut scene = Scene::new(8);
        for _ in 0..300 {
            scene.next(true);
        }
        let before = scene.filter.clone();
        let mut mirrored = scene.pose(2.96);
        mirrored.room_from_sensor.translation.vector *= -1.0;
        assert_eq!(scene.filter.magnetic(&mirrored), Taken::Gated);
        assert_eq!(scene.filter.magnetic(&mirrored), Taken::Stuck);
        assert_eq!(scene.filter.state, before.state);
        let mut none = scene.pose(2.96);
        none.room_from_sensor.translation.vector.x = f64::NAN;
        assert_eq!(scene.filter.magnetic(&none), Taken::Refused);
        let old = scene.pose(2.0);
        assert_eq!(scene.filter.magnetic(&old), Taken::Refused);
        let good = scene.pose(2.97);
        assert_eq!(scene.filter.magnetic(&good), Taken::Used);
    }

    #[test]
    fn clocks_that_differ_are_tolerated_where_the_offset_is_known() {
        let mut scene = Scene::new(21);
        scene.filter.params.offset_s = 0.02;
        let (mut used, mut gated) = (0, 0);
        for k in 0..600 {
            scene.step += 1;
            let t = 0.01 * f64::from(scene.step);
            let sample = scene.imu(t - 0.005);
            scene.filter.imu(t, &sample);
            if k % 2 == 0 && k > 10 {
                let mut pose = scene.pose(t - 0.03);
                pose.t_s -= 0.02;
                match scene.filter.magnetic(&pose) {
                    Taken::Used => used += 1,
                    Taken::Gated => gated += 1,
                    // Those older than the first one.
                    taken => assert!(t < 0.2, "{taken:?} at {t} s"),
                }
            }
        }
        // A gate turns a few good poses away.
        assert!(used > 280 && gated <= 3, "{used} used, {gated} turned away");
        let (p, r) = scene.error(6.0);
        assert!(p.norm() < 2.0 * SIGMA_M && r.norm() < SIGMA_RAD, "{} m, {} rad", p.norm(), r.norm());
    }
}
