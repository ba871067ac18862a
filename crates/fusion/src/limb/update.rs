//! What one IMU tells a limb: gyro, accelerometer and azimuth, gated and adapted.
//!
//! In: one sample and the predicted limb. Out: a correction, and a report on what was believed.

use nalgebra::{SMatrix, SVector, UnitQuaternion, Vector3};
use posed_state::Plain;
use serde::{Deserialize, Serialize};

use super::chain::{Motion, Rows};
use super::covariance::Covariance;
use super::joint::Joint;
use super::parameters::{ByParameters, Dependence, GYRO_SHARE, Learning, PARAMETERS, SLOW_RAD_S};
use super::{Base, Limb, Which};
use crate::ahrs::ImuSample;
use posed_geometry::so3::lever;
use posed_geometry::wrapped_rad;

/// 99.9 % of chi squared with 3 degrees of freedom: beyond it a sample is not believed.
const GATE_3: f64 = 16.3;
/// 95 %: between this and the gate a sample counts for less.
const DOUBT_3: f64 = 7.8;
/// 99 % with 1 degree of freedom, for the azimuth.
const GATE_1: f64 = 6.6;
/// Normalised innovation (3 sigma) above which the measurement is linearised anew.
const RELINEARISE: f64 = 9.0;
/// After so long without an accepted azimuth, one is used with ten times its noise, s.
const FIELD_PATIENCE_S: f64 = 60.0;
/// Without a sample for so long, a joint is stale, s.
const STALE_S: f64 = 0.5;
/// Window of the adaptation of the accelerometer's noise, s.
const ADAPT_S: f64 = 1.0;

/// The field that the azimuth is compared with. A sample is used only within 10 % of its norm and 10 degrees of its dip.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FieldReference {
    /// Azimuth of the field, `atan2(y, x)` in the room, rad.
    pub azimuth_rad: f64,
    /// Norm, in the unit of the samples, above 0.
    pub norm: f64,
    /// Dip below the horizontal, rad, positive downwards.
    pub dip_rad: f64,
}

/// What became of one sensor's sample. Of a filter that is right, the normalised innovation squared is on average 3 (azimuth:
/// 1).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SensorReport {
    /// No sample for half a second.
    pub stale: bool,
    /// The sample had a number that is not finite in gyro or accelerometer, and was not used.
    pub broken: bool,
    /// Normalised innovation squared of the gyro (3 degrees of freedom); absent without a sample.
    pub gyro_nis: Option<f64>,
    /// The standard deviation of the gyro per axis that it was held against, rad/s.
    pub gyro_sigma_rad_s: f64,
    /// The same of the accelerometer; above 16.3 it is not believed, above 7.8 its noise is raised.
    pub accel_nis: Option<f64>,
    /// The same of the azimuth (1 degree of freedom); absent without a trusted field. Above 6.6 it is not believed, for a
    /// minute.
    pub heading_nis: Option<f64>,
    /// The accelerometer was not believed.
    pub accel_gated: bool,
    /// The azimuth was not believed, or the field's norm or dip is not the reference's.
    pub heading_gated: bool,
}

/// What is remembered of a sensor between samples.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub(super) struct Sensor {
    silent_s: f64,
    without_field_s: f64,
    /// The accelerometer's variance as the innovations show it, over its nominal one.
    seen: f64,
    /// Normalised innovation squared of the accelerometer per axis, low-passed: 1 where the noise is right.
    nis_per_axis: f64,
}

impl Sensor {
    /// Factor on the accelerometer's variance. As long as the innovations are as large as predicted it is 1: what
    /// they show of the noise is itself noisy where the limb's own accelerations make most of them.
    fn adapted(&self) -> f64 {
        if (0.8..1.2).contains(&self.nis_per_axis) { 1.0 } else { self.seen.clamp(0.3, 30.0) }
    }
}

impl Default for Sensor {
    fn default() -> Self {
        Self { silent_s: 0.0, without_field_s: 0.0, seen: 1.0, nis_per_axis: 1.0 }
    }
}

/// Prediction of one IMU's sample and its derivatives.
pub(super) struct Prediction<const N: usize> {
    pub(super) gyro: Vector3<f64>,
    pub(super) accel: Vector3<f64>,
    pub(super) d_gyro: Rows<N>,
    pub(super) d_accel: Rows<N>,
    /// Azimuth of the measured field minus the reference's, rad.
    pub(super) azimuth: Option<f64>,
    /// Rotation about the room's vertical per error state.
    pub(super) d_azimuth: SMatrix<f64, 1, N>,
    /// What a tilt does to the azimuth per error state: counted as noise, never corrected.
    d_azimuth_by_tilt: SMatrix<f64, 1, N>,
    /// How it depends on the limb's parameters.
    pub(super) dependence: Dependence,
}

#[expect(private_bounds, reason = "the two kinds of joint are a closed set")]
impl<J: Joint<N>, const D: usize, const N: usize> Limb<J, D, N> {
    /// What the IMU should measure.
    pub(super) fn predict_sample(
        &self,
        which: Which,
        base: &Base,
        field: Option<(&FieldReference, Vector3<f64>)>,
    ) -> Prediction<N> {
        let g = &self.geometry;
        let mut motion =
            Motion::<N>::of_base(base.angular_velocity_rad_s, base.accel_rad_s2, base.specific_force_m_s2);
        motion.shift(&g.base_to_joint_m);
        self.upper.rotate(&mut motion, 0);
        let upper = self.p.depends.then(|| motion.frame());
        let q_segment_sensor = match which {
            Which::Upper => {
                motion.shift(&g.upper_imu_m);
                &g.upper_mount
            }
            Which::Lower => {
                motion.shift(&g.upper_to_lower_m);
                self.lower.rotate(&mut motion, Self::LOWER);
                motion.shift(&g.lower_imu_m);
                &g.lower_mount
            }
        };
        let back = q_segment_sensor.to_rotation_matrix().into_inner().transpose();
        let mut dependence = Dependence::none();
        if let Some(upper) = upper {
            let frame = motion.frame();
            let from =
                |q: &UnitQuaternion<f64>| back * (frame.q.inverse() * q).to_rotation_matrix().into_inner();
            dependence.mount(which, &back, &motion.omega, &motion.specific_force_m_s2);
            dependence.place(which, &back, &frame.lever);
            let base_lever = lever(&base.angular_velocity_rad_s, &base.accel_rad_s2);
            dependence.joint(&from(&UnitQuaternion::identity()), &base_lever);
            if which == Which::Lower {
                dependence.length(g, &from(&upper.q), &upper.lever);
            }
        }
        let mut azimuth = None;
        let mut d_azimuth = SMatrix::<f64, 1, N>::zeros();
        let mut d_azimuth_by_tilt = d_azimuth;
        if let Some((reference, mag)) = field {
            let q_room_frame = base.q_room_base * motion.q_base_frame;
            let m = q_room_frame * (q_segment_sensor * mag);
            azimuth =
                trusted(&m, reference).then(|| wrapped_rad(libm::atan2(m.y, m.x) - reference.azimuth_rad));
            // Only the rotation about the vertical: the azimuth never corrects the tilt.
            let back = q_room_frame.inverse();
            d_azimuth = (back * Vector3::z()).transpose() * motion.d_rotation;
            let tilt = Vector3::new(m.x, m.y, 0.0) * (-m.z / (m.x * m.x + m.y * m.y));
            d_azimuth_by_tilt = (back * tilt).transpose() * motion.d_rotation;
            dependence.azimuth(which, [back * Vector3::z(), back * tilt]);
        }
        Prediction {
            gyro: back * motion.omega,
            accel: back * motion.specific_force_m_s2,
            d_gyro: back * motion.d_omega,
            d_accel: back * motion.d_specific_force,
            azimuth,
            d_azimuth,
            d_azimuth_by_tilt,
            dependence,
        }
    }

    /// Takes the sample of one IMU, or its absence.
    pub(super) fn observe(
        &mut self,
        which: Which,
        base: &Base,
        field: Option<&FieldReference>,
        sample: Option<&ImuSample>,
        learns: bool,
        dt_s: f64,
    ) -> SensorReport {
        let mut sensor = self.sensors[which as usize];
        sensor.silent_s += dt_s;
        sensor.without_field_s += dt_s;
        let mut report = SensorReport::default();
        if let Some(sample) = sample {
            report.broken = !sample.gyro_rad_s.iter().chain(sample.accel_m_s2.iter()).all(|v| v.is_finite());
            if !report.broken {
                sensor.silent_s = 0.0;
                self.use_sample(which, base, field, sample, learns, dt_s, &mut sensor, &mut report);
            }
        }
        report.stale = sensor.silent_s >= STALE_S;
        self.sensors[which as usize] = sensor;
        report
    }

    #[expect(clippy::too_many_arguments, reason = "one step, cut in two for the eye")]
    fn use_sample(
        &mut self,
        which: Which,
        base: &Base,
        field: Option<&FieldReference>,
        sample: &ImuSample,
        learns: bool,
        dt_s: f64,
        sensor: &mut Sensor,
        report: &mut SensorReport,
    ) {
        let columns = match which {
            Which::Upper => Self::LOWER,
            Which::Lower => N,
        };
        let mag = sample.mag.filter(|m| m.iter().all(|v| v.is_finite()));
        let field = field.zip(mag);
        let n = &self.noise;
        // A mounting that is wrong turns what the gyro shows, two of three parts of it across.
        let rate_rad_s = sample.gyro_rad_s.norm();
        let mount_rad2 = self.geometry.mount_sigma_rad[which as usize].norm_squared() / 3.0;
        let turned_rad2_s2 = mount_rad2 * rate_rad_s.powi(2) * (2.0 / 3.0);
        let own_rad2_s2 = n.gyro_rad_s.powi(2) + turned_rad2_s2;
        let gyro_noise = Vector3::repeat(own_rad2_s2 + base.angular_velocity_sigma_rad_s.powi(2));
        // The parameters themselves know how far a mounting turns what the gyro shows; skin and straps do it, too.
        let gyro_excess = (GYRO_SHARE * rate_rad_s).powi(2) - turned_rad2_s2;
        let mut accel_noise =
            Vector3::repeat(n.accel_m_s2.powi(2) * sensor.adapted() + base.specific_force_sigma_m_s2.powi(2));
        for i in 0..3 {
            if sample.accel_m_s2[i].abs() > 0.98 * n.accel_range_m_s2 {
                accel_noise[i] = 1e12;
            }
        }
        let (heading, accel_variance) = (n.heading_rad, n.accel_m_s2.powi(2));
        let prior = self.p.clone();
        let learning = self.learning.as_ref().filter(|_| learns && rate_rad_s > SLOW_RAD_S).cloned();
        let mut moved = SVector::<f64, PARAMETERS>::zeros();
        let mut dx = SVector::<f64, N>::zeros();
        for pass in 0..3 {
            let prediction = self.predict_sample(which, base, field);
            // Residuals relative to the prior: the state has already moved by `from`.
            let from = dx;
            if pass > 0 {
                self.correct(&-from);
                self.p.clone_from(&prior);
            }
            dx.fill(0.0);
            moved.fill(0.0);
            let mut learning = learning.clone();
            *report = SensorReport { ..SensorReport::default() };
            let gyro = sample.gyro_rad_s - prediction.gyro + prediction.d_gyro * from;
            let accel = sample.accel_m_s2 - prediction.accel + prediction.d_accel * from;

            report.gyro_sigma_rad_s = own_rad2_s2.sqrt();
            let mut errors =
                Errors { p: &mut self.p, learning: learning.as_mut(), dx: &mut dx, moved: &mut moved };
            let h = (&prediction.d_gyro, &prediction.dependence.gyro);
            report.gyro_nis = errors.step(h, columns, &gyro, &gyro_noise, gyro_excess, |_| Some(1.0)).0;
            // How a joint moves that hangs on something unknown is no noise: it goes with the limb.
            if !base.is_measured() {
                errors.learning = None;
            }
            let (nis, excess) = errors.step(
                (&prediction.d_accel, &prediction.dependence.accel),
                columns,
                &accel,
                &accel_noise,
                0.0,
                |nis| match nis {
                    n if n > GATE_3 => None,
                    n if n > DOUBT_3 => Some(n / 3.0),
                    _ => Some(1.0),
                },
            );
            report.accel_nis = nis;
            report.accel_gated = nis.is_none_or(|n| n > GATE_3);
            let relinearise = report.gyro_nis.is_some_and(|n| n > RELINEARISE)
                || nis.is_some_and(|n| n > RELINEARISE && n <= GATE_3);

            if let Some(azimuth) = prediction.azimuth {
                let residual = wrapped_rad(-azimuth + (prediction.d_azimuth * from)[0]);
                let patient = sensor.without_field_s < FIELD_PATIENCE_S;
                let own = heading.powi(2) * if patient { 1.0 } else { 10.0 };
                let nis = rotation_only(&mut self.p, &mut dx, &prediction, columns, residual, own, |nis| {
                    nis <= GATE_1 || !patient
                });
                report.heading_nis = nis;
                report.heading_gated = patient && nis.is_none_or(|n| n > GATE_1);
            } else {
                report.heading_gated = field.is_some();
            }
            self.correct(&dx);
            if !relinearise || pass == 2 {
                if let Some(learning) = learning {
                    self.geometry.correct(&moved);
                    self.geometry.mount_sigma_rad = learning.mount_sigmas_rad();
                    self.learning = Some(learning);
                }
                // The innovation's excess over what was predicted, slowly, as a factor on the noise.
                let gain = dt_s / (ADAPT_S + dt_s);
                let seen = (excess / (3.0 * accel_variance)).min(100.0);
                sensor.seen += gain * (seen - sensor.seen);
                let per_axis = nis.unwrap_or(3.0).min(300.0) / 3.0;
                sensor.nis_per_axis += gain * (per_axis - sensor.nis_per_axis);
                break;
            }
        }
        if report.heading_nis.is_some() && !report.heading_gated {
            sensor.without_field_s = 0.0;
        }
    }

    /// An error state was measured: `residual` away, with variance `noise`.
    pub(super) fn observe_state(&mut self, column: usize, residual: f64, noise: f64) {
        let mut h = SMatrix::<f64, 1, N>::zeros();
        h[column] = 1.0;
        let innovation = self.p.innovation(&h, N, &ByParameters::zeros());
        let (residual, noise) = (SVector::<f64, 1>::new(residual), SVector::<f64, 1>::new(noise));
        if let Some(inverse) = innovation.inverse(&noise) {
            let dx = self.p.update(&innovation, &inverse, &residual, &noise);
            self.correct(&dx);
        }
    }
}

/// What a sample corrects: the error states and the parameters.
struct Errors<'a, const N: usize> {
    p: &'a mut Covariance<N>,
    learning: Option<&'a mut Learning>,
    dx: &'a mut SVector<f64, N>,
    moved: &'a mut SVector<f64, PARAMETERS>,
}

impl<const N: usize> Errors<'_, N> {
    /// One block of rows, of the states and of the parameters. `trust` states by what the noise is multiplied, given the normalised innovation, or `None` to leave
    /// it out; `excess_noise` is what the noise is larger by for the parameters. Returns the normalised innovation squared, and the innovation's square beyond what the states explain.
    fn step<const M: usize>(
        &mut self,
        (h, direct): (&SMatrix<f64, M, N>, &ByParameters<M>),
        columns: usize,
        residual: &SVector<f64, M>,
        noise: &SVector<f64, M>,
        excess_noise: f64,
        trust: impl Fn(f64) -> Option<f64>,
    ) -> (Option<f64>, f64) {
        let innovation = self.p.innovation(h, columns, direct);
        let residual = residual - h * *self.dx - direct.transpose() * *self.moved;
        let excess = residual.norm_squared() - innovation.predicted.trace();
        let Some(inverse) = innovation.inverse(noise) else { return (None, excess) };
        let nis = residual.dot(&(inverse * residual));
        let Some(factor) = trust(nis) else { return (Some(nis), excess) };
        let noise = noise * factor;
        let inverse = if factor == 1.0 { Some(inverse) } else { innovation.inverse(&noise) };
        let Some(inverse) = inverse else { return (Some(nis), excess) };
        *self.dx += self.p.update(&innovation, &inverse, &residual, &noise);
        if let Some(learning) = &mut self.learning {
            let moved = learning.update(&innovation, &residual, &noise.add_scalar(excess_noise));
            *self.dx += self.p.by_parameters.transpose() * moved;
            *self.moved += moved;
        }
        (Some(nis), excess)
    }
}

/// The azimuth: its gain is that of a rotation about the vertical alone, but the covariance knows that a tilt moves
/// it too (Schmidt's consider update). Returns the normalised innovation squared.
fn rotation_only<const N: usize>(
    p: &mut Covariance<N>,
    dx: &mut SVector<f64, N>,
    prediction: &Prediction<N>,
    columns: usize,
    residual: f64,
    noise: f64,
    trust: impl Fn(f64) -> bool,
) -> Option<f64> {
    let [by_rotation, by_tilt] = &prediction.dependence.azimuth;
    let rotate = p.innovation(&prediction.d_azimuth, columns, by_rotation);
    let d_full = prediction.d_azimuth + prediction.d_azimuth_by_tilt;
    let full = p.innovation(&d_full, columns, &(by_rotation + by_tilt));
    let residual = residual - (prediction.d_azimuth * *dx)[0];
    let s = full.predicted[0] + noise;
    let nis = residual * residual / s;
    // Not larger than the rotation alone deserves, nor than the whole uncertainty of the azimuth allows.
    let gain = rotate.cross / s.max(rotate.predicted[0] + noise);
    if !nis.is_finite() {
        return None;
    }
    if trust(nis) {
        p.apply(&full, &gain, &SVector::<f64, 1>::new(noise));
        *dx += gain * residual;
    }
    Some(nis)
}

/// Norm within 10 % and dip within 10 degrees of the reference.
fn trusted(m: &Vector3<f64>, reference: &FieldReference) -> bool {
    let dip = libm::atan2(-m.z, libm::hypot(m.x, m.y));
    (m.norm() / reference.norm - 1.0).abs() < 0.1 && (dip - reference.dip_rad).abs() < 10_f64.to_radians()
}
