//! How a transmitter stands in the room, and how an IMU sits on a magnetic sensor: the mathematics of `stage.align`.
//!
//! In: a recording of one sensor that has both, waved about: magnetic poses in the transmitter's axes, and the IMU's orientation and
//! specific force at the same times; optionally anchors, places whose position in the room is known. Out: room from transmitter,
//! rotation and lever arm between the two, each with its residual. It never returns what the movement did not show.
//!
//! Rotations: `X M(t) Y = A(t)` for all t, with M the sensor's and A the IMU's orientation, X room from transmitter and Y
//! sensor from IMU: linear in the matrices X and Y', then refined on the group. Lever: the second difference of the
//! position over some tenths of a second is the specific force weighed by a triangle, so that no noise is differentiated twice.

pub mod guide;
mod recording;
#[cfg(test)]
mod tests;

use nalgebra::{
    Isometry3, Matrix3, Matrix6, SMatrix, SVector, Translation3, UnitQuaternion, Vector3, Vector6,
};
use serde::{Deserialize, Serialize};
use thiserror::Error;

pub use recording::{Found, Recording, align_recording};

use super::limb::GRAVITY_M_S2;
use crate::geometry::so3::{exp, log};

/// Half width of the second differences, s.
const HALF_S: f64 = 0.2;
/// Fewest samples, and least turn in each of two directions, rad.
const MIN_SAMPLES: usize = 200;
const MIN_TURN_RAD: f64 = 0.3;

/// One time of a sensor that has both.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct BothSample {
    /// Time, s; equally spaced.
    pub t_s: f64,
    /// Magnetic pose: sensor to transmitter.
    pub transmitter_from_sensor: Isometry3<f64>,
    /// IMU to a level frame of constant heading, or to the room.
    pub level_from_imu: UnitQuaternion<f64>,
    /// Specific force, IMU axes, m/s².
    pub force_m_s2: Vector3<f64>,
}

/// A place of the sensor that was surveyed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct AnchorPoint {
    /// As the tracker has it, m.
    pub transmitter_m: Vector3<f64>,
    /// As it was surveyed, m.
    pub room_m: Vector3<f64>,
}

/// What was found.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Alignment {
    /// The transmitter in the room; without anchors its origin is the room's. With neither heading nor two anchors its x axis, seen
    /// from above, is the room's.
    pub room_from_transmitter: Isometry3<f64>,
    /// Turns the IMU's coordinates into the magnetic sensor's.
    pub q_sensor_imu: UnitQuaternion<f64>,
    /// From the magnetic sensor to the IMU, magnetic sensor's axes, m.
    pub lever_m: Vector3<f64>,
    /// Bias of the accelerometer, IMU axes, m/s².
    pub accel_bias_m_s2: Vector3<f64>,
    /// Root mean square of what is left of the rotations, rad.
    pub residual_rad: f64,
    /// The same of the second differences, m.
    pub residual_m: f64,
    /// The same of the anchors, m; 0 without.
    pub anchors_m: f64,
}

/// Why there is no alignment.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum AlignError {
    /// Too short.
    #[error("only {found} samples; wave the sensor for at least {needed}")]
    TooShort {
        /// Samples there were.
        found: usize,
        /// Samples it takes.
        needed: usize,
    },
    /// It turned about one axis only.
    #[error("the sensor turned about one axis only: turn it about all of them, by 45 degrees and more")]
    OneAxis,
    /// It did not move.
    #[error("the sensor's turning does not show its lever: shake it, with fast turns")]
    Still,
    /// Fewer than three anchors, or all on a line.
    #[error("without an IMU it takes three anchors or more that are not on one line")]
    Anchors,
}

/// Aligns; `heading` says whether the IMU's level frame is the room's in heading too.
///
/// # Errors
/// What the movement does not show.
pub fn align(
    samples: &[BothSample],
    anchors: &[AnchorPoint],
    heading: bool,
) -> Result<Alignment, AlignError> {
    if samples.len() < MIN_SAMPLES {
        return Err(AlignError::TooShort { found: samples.len(), needed: MIN_SAMPLES });
    }
    let (x, y) = rotations(samples)?;
    let (x, y, drift_rad_s, residual_rad) = refine(samples, x, y);
    let middle_s = middle_s(samples);
    let still: Vec<BothSample> = samples
        .iter()
        .map(|sample| BothSample {
            level_from_imu: about_z(-drift_rad_s * (sample.t_s - middle_s)) * sample.level_from_imu,
            ..*sample
        })
        .collect();
    let (lever_m, accel_bias_m_s2, residual_m) = lever(&still, &x)?;
    let x = if heading { x } else { facing(&x) * x };
    let mut room = Isometry3::from_parts(Translation3::identity(), x);
    let mut anchors_m = 0.0;
    if !anchors.is_empty() {
        room = anchor(anchors, &x, heading);
        anchors_m = left_m(anchors, &room);
    }
    Ok(Alignment {
        room_from_transmitter: room,
        q_sensor_imu: y,
        lever_m,
        accel_bias_m_s2,
        residual_rad,
        residual_m,
        anchors_m,
    })
}

/// X and Y of `X M Y = A` from the null space of `X M - A Y'`, linear in 18 numbers.
fn rotations(samples: &[BothSample]) -> Result<(UnitQuaternion<f64>, UnitQuaternion<f64>), AlignError> {
    let first = &samples[0];
    let mut spread = Matrix3::zeros();
    let mut normal = SMatrix::<f64, 18, 18>::zeros();
    for sample in samples {
        let turn = log(&(first.level_from_imu.inverse() * sample.level_from_imu));
        spread += turn * turn.transpose() / samples.len() as f64;
        let m = sample.transmitter_from_sensor.rotation.to_rotation_matrix().into_inner();
        let a = sample.level_from_imu.to_rotation_matrix().into_inner();
        for i in 0..3 {
            for j in 0..3 {
                // (X M)_ij - (A Y')_ij, with X and Y' row by row.
                let mut row = SMatrix::<f64, 18, 1>::zeros();
                for k in 0..3 {
                    row[3 * i + k] += m[(k, j)];
                    row[9 + 3 * k + j] -= a[(i, k)];
                }
                normal += row * row.transpose();
            }
        }
    }
    let mut turns: Vec<f64> = spread.symmetric_eigenvalues().iter().copied().collect();
    turns.sort_by(f64::total_cmp);
    if turns[1].is_nan() || turns[1] < MIN_TURN_RAD.powi(2) / 4.0 {
        return Err(AlignError::OneAxis);
    }
    let eigen = normal.symmetric_eigen();
    let least = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned();
    let block = |at: usize| Matrix3::from_fn(|i, j| least[at + 3 * i + j]);
    let (x, y_t) = (block(0), block(9));
    // The null vector has any sign and length; both rotations have determinant 1.
    let sign = x.determinant().signum();
    let project = |m: Matrix3<f64>| {
        let svd = (m * sign).svd(true, true);
        let (u, v_t) = (svd.u.unwrap_or_else(Matrix3::identity), svd.v_t.unwrap_or_else(Matrix3::identity));
        UnitQuaternion::from_matrix(&(u * v_t))
    };
    // X M = A Y' with Y' = Y^-1.
    Ok((project(x), project(y_t).inverse()))
}

/// Gauss-Newton on both rotations and the rate at which the level frame drifts about the vertical, with Huber's weights: X, Y,
/// drift in rad/s, and what is left in rad.
fn refine(
    samples: &[BothSample],
    mut x: UnitQuaternion<f64>,
    mut y: UnitQuaternion<f64>,
) -> (UnitQuaternion<f64>, UnitQuaternion<f64>, f64, f64) {
    const HUBER_RAD: f64 = 0.05;
    let middle_s = middle_s(samples);
    let (mut drift_rad_s, mut residual) = (0.0, 0.0);
    for _ in 0..10 {
        let (mut gradient, mut normal) = (SVector::<f64, 7>::zeros(), SMatrix::<f64, 7, 7>::zeros());
        residual = 0.0;
        for sample in samples {
            // A = Z(t) X M Y exp(r); X grows from the left, Y from the right, Z turns about the vertical.
            let since_s = sample.t_s - middle_s;
            let drift = about_z(drift_rad_s * since_s);
            let predicted = drift * x * sample.transmitter_from_sensor.rotation * y;
            let r = log(&(predicted.inverse() * sample.level_from_imu));
            residual += r.norm_squared();
            let weight = (HUBER_RAD / r.norm()).min(1.0);
            let back = predicted.inverse();
            let by_x = (back * drift).to_rotation_matrix().into_inner();
            let mut rows = SMatrix::<f64, 3, 7>::zeros();
            rows.fixed_view_mut::<3, 3>(0, 0).copy_from(&by_x);
            rows.fixed_view_mut::<3, 3>(0, 3).copy_from(&Matrix3::identity());
            rows.fixed_view_mut::<3, 1>(0, 6).copy_from(&(back * Vector3::z() * since_s));
            gradient += rows.transpose() * r * weight;
            normal += rows.transpose() * rows * weight;
        }
        let Some(step) = normal.cholesky().map(|c| c.solve(&gradient)) else { break };
        x = exp(&step.fixed_rows::<3>(0).into_owned()) * x;
        y *= exp(&step.fixed_rows::<3>(3).into_owned());
        drift_rad_s += step[6];
        if step.norm() < 1e-10 {
            break;
        }
    }
    (x, y, drift_rad_s, (residual / samples.len() as f64).sqrt())
}

fn about_z(angle_rad: f64) -> UnitQuaternion<f64> {
    UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle_rad)
}

fn middle_s(samples: &[BothSample]) -> f64 {
    samples.first().zip(samples.last()).map_or(0.0, |(first, last)| 0.5 * (first.t_s + last.t_s))
}

/// The turn about the vertical that brings the transmitter's x axis, or its y axis where that one stands upright, to where the
/// room's is.
fn facing(x: &UnitQuaternion<f64>) -> UnitQuaternion<f64> {
    let (a, b) = (x * Vector3::x(), x * Vector3::y());
    about_z(if a.x.hypot(a.y) > 0.3 { -a.y.atan2(a.x) } else { b.x.atan2(b.y) })
}

/// How a transmitter stands by anchors alone, and what is left of them, m, root mean square.
///
/// # Errors
/// Fewer than three of them, or all on a line.
pub fn stand(anchors: &[AnchorPoint]) -> Result<(Isometry3<f64>, f64), AlignError> {
    let n = anchors.len() as f64;
    let from = anchors.iter().map(|a| a.transmitter_m).sum::<Vector3<f64>>() / n;
    let to = anchors.iter().map(|a| a.room_m).sum::<Vector3<f64>>() / n;
    let sum: Matrix3<f64> =
        anchors.iter().map(|a| (a.room_m - to) * (a.transmitter_m - from).transpose()).sum();
    let svd = sum.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else { return Err(AlignError::Anchors) };
    let mut values: Vec<f64> = svd.singular_values.iter().copied().collect();
    values.sort_by(f64::total_cmp);
    // The second direction: a centimetre at least.
    if anchors.len() < 3 || values[1].is_nan() || values[1] < 1e-4 * n {
        return Err(AlignError::Anchors);
    }
    // A mirror image is undone in the direction that says least.
    let least = svd.singular_values.imin();
    let mirrored = (u * v_t).determinant().signum();
    let sign = Vector3::from_fn(|i, _| if i == least { mirrored } else { 1.0 });
    let rotation = UnitQuaternion::from_matrix(&(u * Matrix3::from_diagonal(&sign) * v_t));
    let room = Isometry3::from_parts(Translation3::from(to - rotation * from), rotation);
    Ok((room, left_m(anchors, &room)))
}

/// Root mean square of what a pose leaves of the anchors, m.
fn left_m(anchors: &[AnchorPoint], room: &Isometry3<f64>) -> f64 {
    let off =
        |a: &AnchorPoint| (room.transform_point(&a.transmitter_m.into()).coords - a.room_m).norm_squared();
    (anchors.iter().map(off).sum::<f64>() / anchors.len() as f64).sqrt()
}

/// Lever and accelerometer bias, linear in the second differences of the IMU's position.
fn lever(
    samples: &[BothSample],
    x: &UnitQuaternion<f64>,
) -> Result<(Vector3<f64>, Vector3<f64>, f64), AlignError> {
    let dt_s = (samples[samples.len() - 1].t_s - samples[0].t_s) / (samples.len() - 1) as f64;
    let half = ((HALF_S / dt_s).round() as usize).max(2);
    let rotation =
        |k: usize| (x * samples[k].transmitter_from_sensor.rotation).to_rotation_matrix().into_inner();
    let place = |k: usize| x * samples[k].transmitter_from_sensor.translation.vector;
    let (mut normal, mut right) = (Matrix6::zeros(), Vector6::zeros());
    let mut rows_of = Vec::new();
    for k in (half..samples.len() - half).step_by((half / 4).max(1)) {
        let mut force = Vector3::zeros();
        let mut turned = Matrix3::zeros();
        for (j, sample) in samples.iter().enumerate().take(k + half).skip(k - half + 1) {
            let weight = (half - j.abs_diff(k)) as f64 * dt_s * dt_s;
            let a = sample.level_from_imu;
            force += (a * sample.force_m_s2 - Vector3::z() * GRAVITY_M_S2) * weight;
            turned += a.to_rotation_matrix().into_inner() * weight;
        }
        let bend = place(k + half) - place(k) * 2.0 + place(k - half);
        let by_lever = rotation(k + half) - rotation(k) * 2.0 + rotation(k - half);
        let mut rows = SMatrix::<f64, 3, 6>::zeros();
        rows.fixed_view_mut::<3, 3>(0, 0).copy_from(&by_lever);
        rows.fixed_view_mut::<3, 3>(0, 3).copy_from(&turned);
        let value = force - bend;
        normal += rows.transpose() * rows;
        right += rows.transpose() * value;
        rows_of.push((rows, value));
    }
    // The weakest direction of the lever, per row: a second difference of a turning arm of one metre.
    let weakest = normal.fixed_view::<3, 3>(0, 0).symmetric_eigenvalues().min() / rows_of.len() as f64;
    if weakest.is_nan() || weakest < 1e-3 {
        return Err(AlignError::Still);
    }
    let found = normal.cholesky().map(|c| c.solve(&right)).ok_or(AlignError::Still)?;
    let squares: f64 = rows_of.iter().map(|(rows, value)| (rows * found - value).norm_squared()).sum();
    let residual_m = (squares / rows_of.len() as f64).sqrt();
    Ok((found.fixed_rows::<3>(0).into(), found.fixed_rows::<3>(3).into(), residual_m))
}

/// Turn about the vertical (where the heading is not known) and place from anchors; the tilt stays gravity's.
fn anchor(anchors: &[AnchorPoint], x: &UnitQuaternion<f64>, heading: bool) -> Isometry3<f64> {
    let n = anchors.len() as f64;
    let turned: Vec<Vector3<f64>> = anchors.iter().map(|a| x * a.transmitter_m).collect();
    let from = turned.iter().sum::<Vector3<f64>>() / n;
    let to = anchors.iter().map(|a| a.room_m).sum::<Vector3<f64>>() / n;
    let (mut sine, mut cosine) = (0.0, 0.0);
    for (point, anchor) in turned.iter().zip(anchors) {
        let (a, b) = (point - from, anchor.room_m - to);
        sine += a.x * b.y - a.y * b.x;
        cosine += a.x * b.x + a.y * b.y;
    }
    let known = heading || (sine == 0.0 && cosine == 0.0);
    let yaw = if known { 0.0 } else { sine.atan2(cosine) };
    let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
    Isometry3::from_parts(Translation3::from(to - yaw * from), yaw * x)
}
