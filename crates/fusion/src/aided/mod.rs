//! A sensor that has both a magnetic pose and an IMU, as one filter.
//!
//! In: IMU samples and magnetic poses, each with its capture time; poses may come up to 0.3 s late. Out: pose, velocity and
//! their uncertainty at the time of the latest IMU sample. It coasts through half a second without magnetic poses, and it
//! never decides on which side of the transmitter a pose is, nor whether a tracker is stuck: it takes what [`crate::faults`] lets
//! through, and gates.
//!
//! Error state, 15: position, velocity (room), rotation, gyro bias, accelerometer bias (IMU axes); the rotation is local,
//! `R = R_hat exp(rotation)`. A late pose is taken at its own time: the filter goes back to the states it has kept and runs
//! forward again over the samples since. Where the two clocks differ by a constant, `offset_s` of the pose's time stands for it.

#[cfg(test)]
mod tests;

use std::collections::VecDeque;

use nalgebra::{Isometry3, Matrix3, SMatrix, SVector, Translation3, UnitQuaternion, Vector3};
use posed_state::Plain;

use super::ahrs::ImuSample;
use super::faults::Verdict;
use posed_geometry::GRAVITY_M_S2;
use posed_geometry::so3::{exp, hat, log};

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
/// The last IMU sample stands for so long beyond its time, s.
const AHEAD_S: f64 = 0.05;

/// What the filter assumes; effect of each in `docs/methods/alignment.md`. The first three come from [`crate::align`].
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub struct AidedParams {
    /// From the IMU to the magnetic sensor, IMU axes, m.
    pub lever_m: Vector3<f64>,
    /// Turns the magnetic sensor's coordinates into the IMU's.
    pub q_imu_sensor: UnitQuaternion<f64>,
    /// Capture time of a magnetic pose on the IMU's clock minus the time it is given with, s.
    pub offset_s: f64,
    /// Density of the gyro's noise, rad/s per sqrt(Hz).
    pub gyro_density_rad_s_per_sqrt_hz: f64,
    /// Density of the accelerometer's noise, m/s² per sqrt(Hz).
    pub accel_density_m_s2_per_sqrt_hz: f64,
    /// Random walks of the gyro's and the accelerometer's bias, rad/s and m/s² per sqrt(s).
    pub bias_walks: [f64; 2],
    /// Initial standard deviations of the gyro's and the accelerometer's bias per axis, rad/s and m/s².
    pub bias_sigmas: [f64; 2],
    /// How long IMU samples are kept for late poses, s; 300 samples at most.
    pub history_s: f64,
    /// How long the pose stands without a magnetic one, s; after four times that the filter begins anew.
    pub coast_s: f64,
}

impl Default for AidedParams {
    fn default() -> Self {
        Self {
            lever_m: Vector3::zeros(),
            q_imu_sensor: UnitQuaternion::identity(),
            offset_s: 0.0,
            gyro_density_rad_s_per_sqrt_hz: 5e-4,
            accel_density_m_s2_per_sqrt_hz: 5e-3,
            bias_walks: [5e-5, 1e-3],
            bias_sigmas: [0.01, 0.1],
            history_s: 0.3,
            coast_s: 0.5,
        }
    }
}

/// A magnetic pose with its covariances, as [`crate::noise`] and the field map give them.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub struct MagneticPose {
    /// Capture time on the clock of the magnetic records, s; [`AidedParams::offset_s`] is added to it.
    pub t_s: f64,
    /// Sensor to room.
    pub room_from_sensor: Isometry3<f64>,
    /// Covariance of the position, room axes, m², 3 x 3, positive definite.
    pub position_cov_m2: Matrix3<f64>,
    /// Variance of the rotation about each axis, rad².
    pub rotation_var_rad2: f64,
}

/// The magnetic sensor at one time, room frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AidedPose {
    /// Position, m.
    pub position_m: Vector3<f64>,
    /// Velocity, m/s.
    pub velocity_m_s: Vector3<f64>,
    /// Sensor to room.
    pub orientation: UnitQuaternion<f64>,
    /// Angular velocity without its bias, the magnetic sensor's axes, rad/s.
    pub angular_velocity_rad_s: Vector3<f64>,
    /// Covariance of the position's error, room axes, m², 3 x 3.
    pub position_m2: Matrix3<f64>,
    /// Covariance of the rotation's error, the magnetic sensor's axes, rad², 3 x 3: true is `orientation * exp(error)`.
    pub rotation_rad2: Matrix3<f64>,
}

#[derive(Clone, Debug, PartialEq, Plain)]
struct State {
    t_s: f64,
    position_m: Vector3<f64>,
    velocity_m_s: Vector3<f64>,
    q: UnitQuaternion<f64>,
    gyro_bias: Vector3<f64>,
    accel_bias: Vector3<f64>,
    covariance: SMatrix<f64, N, N>,
}

/// The filter of one sensor with a magnetic pose and an IMU: error state of 15, without delay. Method:
/// `docs/methods/alignment.md`; how much better than either alone: `docs/body.md`. Its covariances hold noise, not what an
/// alignment or the field map leaves for good.
#[derive(Clone, Debug, PartialEq, Plain)]
pub struct Aided {
    params: AidedParams,
    state: Option<State>,
    /// States before each sample, and the sample; oldest first.
    history: VecDeque<(State, ImuSample, f64)>,
    last_sample: Option<(f64, ImuSample)>,
    last_used_s: f64,
    gated: u32,
}

impl Aided {
    /// A filter that has seen nothing; the first magnetic pose begins it.
    pub fn new(params: AidedParams) -> Self {
        Self {
            params,
            state: None,
            history: VecDeque::with_capacity(MOST_KEPT),
            last_sample: None,
            last_used_s: f64::NEG_INFINITY,
            gated: 0,
        }
    }

    /// Forgets all that was seen, the biases too; the parameters stay.
    pub fn restart(&mut self) {
        *self = Self::new(self.params);
    }

    /// Takes an IMU sample at its capture time, s, on the IMU's clock. Times that do not rise and numbers that are not finite
    /// change nothing; the magnetic field is not looked at.
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

    /// Takes a magnetic pose at its own time, late or not.
    ///
    /// [`Verdict::Used`] where it went into the filter or began it; [`Verdict::Suspect`] outside the gate (99.9 % of chi
    /// squared, 6 degrees of freedom; ten in a row begin anew with the eleventh); [`Verdict::Dropped`] where it is not
    /// finite, or older than the IMU samples that are kept.
    pub fn magnetic(&mut self, pose: &MagneticPose) -> Verdict {
        let t_s = pose.t_s + self.params.offset_s;
        let finite = pose.room_from_sensor.translation.vector.iter().all(|value| value.is_finite())
            && pose.room_from_sensor.rotation.coords.iter().all(|value| value.is_finite());
        if !finite || !t_s.is_finite() {
            return Verdict::Dropped;
        }
        if self.state.is_none() || t_s - self.last_used_s > 4.0 * self.params.coast_s || self.gated >= RESTART
        {
            return self.begin(pose, t_s);
        }
        // Back to the state before the pose, forward to it, and on over the samples since.
        let at = self.history.partition_point(|(state, _, _)| state.t_s <= t_s);
        let Some(at) = at.checked_sub(1) else { return Verdict::Dropped };
        let (mut state, sample, end_s) = self.history[at].clone();
        let until = t_s.min(end_s);
        if until > state.t_s {
            state.advance(&self.params, &sample, until);
        }
        if !state.update(&self.params, pose) {
            self.gated += 1;
            return Verdict::Suspect;
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
        Verdict::Used
    }

    /// IMU to room at the latest sample. `None` before the first pose, and where the latest sample is more than
    /// [`AidedParams::coast_s`] later than the latest magnetic pose that was used.
    pub fn pose(&self) -> Option<Isometry3<f64>> {
        let state = self.state.as_ref()?;
        let fresh = state.t_s - self.last_used_s <= self.params.coast_s;
        fresh.then(|| Isometry3::from_parts(Translation3::from(state.position_m), state.q))
    }

    /// Magnetic sensor to room, at the time of [`Self::pose`]; `None` where that is.
    pub fn sensor_pose(&self) -> Option<Isometry3<f64>> {
        let lever = Isometry3::from_parts(Translation3::from(self.params.lever_m), self.params.q_imu_sensor);
        Some(self.pose()? * lever)
    }

    /// The magnetic sensor at `t_s` on the clock of the magnetic poses, s: forward from the latest IMU sample, or back
    /// by the velocities, by at most 0.05 s, where `t_s` is earlier. `None` where [`Self::pose`] is, and more than 0.05 s after the latest sample.
    pub fn at(&self, t_s: f64) -> Option<AidedPose> {
        let p = &self.params;
        let t_s = t_s + p.offset_s;
        self.pose()?;
        let (_, sample) = self.last_sample?;
        let mut state = self.state.clone().filter(|state| t_s - state.t_s <= AHEAD_S)?;
        state.advance(p, &sample, t_s);
        let axes = state.q.to_rotation_matrix().into_inner();
        let angular_velocity_rad_s = sample.gyro_rad_s - state.gyro_bias;
        let mut h = SMatrix::<f64, 3, N>::zeros();
        h.fixed_view_mut::<3, 3>(0, P).copy_from(&Matrix3::identity());
        h.fixed_view_mut::<3, 3>(0, R).copy_from(&(-axes * hat(&p.lever_m)));
        let imu_from_sensor = p.q_imu_sensor.to_rotation_matrix().into_inner();
        let rotation = state.covariance.fixed_view::<3, 3>(R, R).into_owned();
        // A sample may follow the time that is asked for by a few milliseconds.
        let back_s = (t_s - state.t_s).clamp(-AHEAD_S, 0.0);
        let velocity_m_s = state.velocity_m_s + axes * angular_velocity_rad_s.cross(&p.lever_m);
        Some(AidedPose {
            position_m: state.position_m + axes * p.lever_m + velocity_m_s * back_s,
            velocity_m_s,
            orientation: state.q * exp(&(angular_velocity_rad_s * back_s)) * p.q_imu_sensor,
            angular_velocity_rad_s: p.q_imu_sensor.inverse() * angular_velocity_rad_s,
            position_m2: h * state.covariance * h.transpose(),
            rotation_rad2: imu_from_sensor.transpose() * rotation * imu_from_sensor,
        })
    }

    /// Time of the latest IMU sample on the clock of the magnetic poses, s; `None` before the first.
    pub fn imu_s(&self) -> Option<f64> {
        Some(self.last_sample?.0 - self.params.offset_s)
    }

    /// The transmitter has been moved: begins anew with the next pose, and keeps what is known of the biases.
    pub fn moved(&mut self) {
        self.last_used_s = f64::NEG_INFINITY;
    }

    /// Standard deviations at the latest sample, root mean square over the axes: position of the IMU, m, and rotation, rad.
    /// `None` before the first pose; they go on growing while it coasts.
    pub fn sigmas(&self) -> Option<(f64, f64)> {
        let p = &self.state.as_ref()?.covariance;
        let mean = |at: usize| ((0..3).map(|i| p[(at + i, at + i)]).sum::<f64>() / 3.0).max(0.0).sqrt();
        Some((mean(P), mean(R)))
    }

    fn begin(&mut self, pose: &MagneticPose, t_s: f64) -> Verdict {
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
        Verdict::Used
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
        let rotation_vector_rad = (sample.gyro_rad_s - self.gyro_bias) * dt;
        let specific_force_m_s2 = sample.accel_m_s2 - self.accel_bias;
        // The specific force in the middle of the step.
        let middle = (self.q * exp(&(rotation_vector_rad * 0.5))).to_rotation_matrix().into_inner();
        let accel = middle * specific_force_m_s2 - Vector3::z() * GRAVITY_M_S2;
        self.position_m += self.velocity_m_s * dt + accel * (0.5 * dt * dt);
        self.velocity_m_s += accel * dt;
        let step = exp(&rotation_vector_rad);
        self.q = UnitQuaternion::new_normalize((self.q * step).into_inner());

        let mut f = SMatrix::<f64, N, N>::identity();
        let set = |f: &mut SMatrix<f64, N, N>, at: (usize, usize), block: Matrix3<f64>| {
            f.fixed_view_mut::<3, 3>(at.0, at.1).copy_from(&block);
        };
        let by_rotation = -middle * hat(&specific_force_m_s2) * dt;
        set(&mut f, (P, V), Matrix3::identity() * dt);
        set(&mut f, (P, R), by_rotation * (0.5 * dt));
        set(&mut f, (P, BA), -middle * (0.5 * dt * dt));
        set(&mut f, (V, R), by_rotation);
        set(&mut f, (V, BA), -middle * dt);
        set(&mut f, (R, R), step.to_rotation_matrix().into_inner().transpose());
        set(&mut f, (R, BG), -Matrix3::identity() * dt);
        let mut p = f * self.covariance * f.transpose();
        let densities = [
            (V, params.accel_density_m_s2_per_sqrt_hz),
            (R, params.gyro_density_rad_s_per_sqrt_hz),
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
        let error_m = pose.room_from_sensor.translation.vector - self.position_m - axes * params.lever_m;
        let measured = pose.room_from_sensor.rotation * params.q_imu_sensor.inverse();
        residual.fixed_rows_mut::<3>(0).copy_from(&error_m);
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
        self.add(&dx);
        true
    }

    /// Adds an error state.
    fn add(&mut self, dx: &SVector<f64, N>) {
        let part = |at: usize| Vector3::new(dx[at], dx[at + 1], dx[at + 2]);
        self.position_m += part(P);
        self.velocity_m_s += part(V);
        self.q = UnitQuaternion::new_normalize((self.q * exp(&part(R))).into_inner());
        self.gyro_bias += part(BG);
        self.accel_bias += part(BA);
    }
}
