//! How a transmitter stands in the room, and how an IMU sits on a magnetic sensor: the mathematics of `stage.align`.
//!
//! In: a recording of one sensor that has both, moved about: magnetic poses in the transmitter's axes, and the IMU's orientation and
//! specific force at the same times; optionally anchors, places whose position in the room is known. Out: room from transmitter,
//! rotation and lever arm between the two, each with its residual. It never returns what the movement did not show.
//!
//! With M the sensor's orientation in the transmitter's axes, A the IMU's in a level frame, X room from transmitter and Y sensor from IMU:
//! - Y: over some tenths of a second both turn alike, `log(M1' M2) = Y log(A1' A2)`, A by the gyro alone: a level frame turns, too,
//!   where a filter finds back to gravity.
//! - Gravity, lever and the accelerometer's bias: the second difference of the position over some tenths of a second is the
//!   specific force weighed by a triangle, so that no noise is differentiated twice. With the force turned by M Y all nine unknowns
//!   are linear, and the bias, which turns with the sensor, is distinguished from gravity, which does not.
//! - X: its tilt by that gravity, its heading by A (where that has one) or by anchors.

mod guide;
mod recording;
#[cfg(test)]
mod tests;

use nalgebra::{Isometry3, Matrix3, SMatrix, SVector, Translation3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

pub use guide::{Ask, Guide};
pub use recording::{Found, Recording, align_recording};

use posed_geometry::so3::log;

/// Half width of the second differences, s.
const HALF_S: f64 = 0.2;
/// A rotation that fits worse than this counts for less, rad.
const HUBER_RAD: f64 = 0.05;
/// Fewest samples, and least rotation within half a second difference in each of two directions, root mean square, rad.
const MIN_SAMPLES: usize = 200;
const MIN_ROTATION_RAD: f64 = 0.05;

/// One time of a sensor that has both a magnetic pose and an IMU.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PairedSample {
    /// Time, s; equally spaced.
    pub t_s: f64,
    /// Magnetic pose: sensor to transmitter.
    pub transmitter_from_sensor: Isometry3<f64>,
    /// IMU to the room, for the heading; to any level frame (z up) where it has none.
    pub level_from_imu: UnitQuaternion<f64>,
    /// IMU to the frame that its gyro alone keeps: right over some tenths of a second.
    pub gyro_from_imu: UnitQuaternion<f64>,
    /// Specific force, IMU axes, m/s², at the same time.
    pub specific_force_m_s2: Vector3<f64>,
}

/// A place of the magnetic sensor that was surveyed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct AnchorPoint {
    /// As the tracker has it, transmitter frame, m.
    pub transmitter_m: Vector3<f64>,
    /// As it was surveyed, room frame, m.
    pub room_m: Vector3<f64>,
}

/// How a transmitter stands in the room and an IMU sits on a magnetic sensor. Accuracy: `docs/body.md`; there is no
/// covariance, the residuals below are what it is judged by.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Alignment {
    /// The transmitter in the room; without anchors its origin is the room's. With neither heading nor two anchors its x axis, seen
    /// from above, is the room's.
    pub room_from_transmitter: Isometry3<f64>,
    /// Turns the IMU's coordinates into the magnetic sensor's.
    pub q_sensor_imu: UnitQuaternion<f64>,
    /// From the magnetic sensor to the IMU, magnetic sensor's axes, m; [`crate::aided::AidedParams`] has the
    /// opposite vector, in IMU axes.
    pub lever_m: Vector3<f64>,
    /// Bias of the accelerometer, IMU axes, m/s².
    pub accel_bias_m_s2: Vector3<f64>,
    /// Root mean square of what is left of the rotations over 0.2 s, rad.
    pub residual_rad: f64,
    /// The same of the second differences of the position, m.
    pub residual_m: f64,
    /// The same of the anchors, m; 0 without. One anchor always fits.
    pub anchors_m: f64,
}

/// Why there is no alignment.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum AlignError {
    /// Too short.
    #[error("only {found} samples; move the sensor for at least {needed}")]
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

/// Aligns from stretches of equally spaced samples without a gap (at least 200 in all, the same spacing in each); `heading`
/// states whether the IMU's level frame is the room's in heading too. Else two anchors or more give the heading; anchors give
/// the place. Offline; equations in `docs/methods/alignment.md`.
///
/// # Errors
/// [`AlignError::TooShort`], [`AlignError::OneAxis`] below 0.05 rad about a second axis, [`AlignError::Still`] where the
/// lever does not show.
pub fn align(
    stretches: &[Vec<PairedSample>],
    anchors: &[AnchorPoint],
    heading: bool,
) -> Result<Alignment, AlignError> {
    let (y, residual_rad) = attached(stretches, 1)?;
    let SpecificForceFit { gravity_m_s2, lever_m, accel_bias_m_s2, residual_m } =
        fit_specific_force(stretches, &y)?;
    let tilt = UnitQuaternion::rotation_between(&gravity_m_s2, &Vector3::z())
        .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI));
    let x = if heading { north(stretches, &tilt, &y) * tilt } else { facing(&tilt) * tilt };
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

/// Y, and the root mean square of what it leaves of the rotations, rad; from every `step`-th of them.
fn attached(stretches: &[Vec<PairedSample>], step: usize) -> Result<(UnitQuaternion<f64>, f64), AlignError> {
    let found = stretches.iter().map(Vec::len).sum();
    if found < MIN_SAMPLES {
        return Err(AlignError::TooShort { found, needed: MIN_SAMPLES });
    }
    let half = half(stretches);
    let rotations: Vec<[Vector3<f64>; 2]> = stretches
        .iter()
        .flat_map(|samples| samples.windows(half + 1).step_by(step))
        .map(|part| {
            let (a, b) = (&part[0], &part[half]);
            let sensor = a.transmitter_from_sensor.rotation.inverse() * b.transmitter_from_sensor.rotation;
            [log(&sensor), log(&(a.gyro_from_imu.inverse() * b.gyro_from_imu))]
        })
        .collect();
    let n = rotations.len() as f64;
    let spread: Matrix3<f64> = rotations.iter().map(|[_, imu]| imu * imu.transpose() / n).sum();
    let mut values: Vec<f64> = spread.symmetric_eigenvalues().iter().copied().collect();
    values.sort_by(f64::total_cmp);
    if values[1].is_nan() || values[1] < MIN_ROTATION_RAD.powi(2) {
        return Err(AlignError::OneAxis);
    }
    let mut y = UnitQuaternion::identity();
    let mut squares = 0.0;
    // Once over all, and once with those for less that fit badly: a record that was not, a knock.
    for pass in 0..2 {
        let sum: Matrix3<f64> = rotations
            .iter()
            .map(|[sensor, imu]| {
                let off = (sensor - y * imu).norm();
                sensor * imu.transpose() * if pass == 0 { 1.0 } else { (HUBER_RAD / off).min(1.0) }
            })
            .sum();
        y = rotation_of(&sum).unwrap_or(y);
        squares = rotations.iter().map(|[sensor, imu]| (sensor - y * imu).norm_squared()).sum();
    }
    Ok((y, (squares / n).sqrt()))
}

/// So many samples are half of a second difference.
fn half(stretches: &[Vec<PairedSample>]) -> usize {
    let steps = stretches.iter().flat_map(|samples| samples.windows(2)).map(|pair| pair[1].t_s - pair[0].t_s);
    let (count, sum_s) = steps.fold((0.0, 0.0), |(count, sum_s), step_s| (count + 1.0, sum_s + step_s));
    ((HALF_S * count / sum_s).round() as usize).max(2)
}

/// The rotation that is nearest to `sum` (of `to from'`); `None` where there is none.
fn rotation_of(sum: &Matrix3<f64>) -> Option<UnitQuaternion<f64>> {
    let svd = sum.svd(true, true);
    let (u, v_t) = (svd.u?, svd.v_t?);
    // A mirror image is undone in the direction that says least.
    let least = svd.singular_values.imin();
    let mirrored = (u * v_t).determinant().signum();
    let sign = Vector3::from_fn(|i, _| if i == least { mirrored } else { 1.0 });
    Some(UnitQuaternion::from_matrix(&(u * Matrix3::from_diagonal(&sign) * v_t)))
}

fn about_z(angle_rad: f64) -> UnitQuaternion<f64> {
    UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle_rad)
}

/// The rotation about the vertical that makes the tilted transmitter's heading the IMU's, on average.
fn north(
    stretches: &[Vec<PairedSample>],
    tilt: &UnitQuaternion<f64>,
    y: &UnitQuaternion<f64>,
) -> UnitQuaternion<f64> {
    let direction = |sample: &PairedSample| {
        let q = sample.level_from_imu * (tilt * sample.transmitter_from_sensor.rotation * y).inverse();
        let angle = 2.0 * libm::atan2(q.k, q.w);
        Vector3::new(libm::cos(angle), libm::sin(angle), 0.0)
    };
    let sum: Vector3<f64> = stretches.iter().flatten().map(direction).sum();
    about_z(libm::atan2(sum.y, sum.x))
}

/// The rotation about the vertical that brings the transmitter's x axis, or its y axis where that one stands upright, to where
/// the room's is.
fn facing(x: &UnitQuaternion<f64>) -> UnitQuaternion<f64> {
    let (a, b) = (x * Vector3::x(), x * Vector3::y());
    about_z(if libm::hypot(a.x, a.y) > 0.3 { -libm::atan2(a.y, a.x) } else { libm::atan2(b.x, b.y) })
}

/// Transmitter to room by anchors alone, the rigid fit of points (Wahba's problem), and what is left of them, m, root mean
/// square. Three anchors without error leave nothing: that figure says little before the fourth.
///
/// # Errors
/// [`AlignError::Anchors`] for fewer than three of them, or all within about a centimetre of a line.
pub fn stand(anchors: &[AnchorPoint]) -> Result<(Isometry3<f64>, f64), AlignError> {
    let n = anchors.len() as f64;
    let from = anchors.iter().map(|a| a.transmitter_m).sum::<Vector3<f64>>() / n;
    let to = anchors.iter().map(|a| a.room_m).sum::<Vector3<f64>>() / n;
    let sum: Matrix3<f64> =
        anchors.iter().map(|a| (a.room_m - to) * (a.transmitter_m - from).transpose()).sum();
    let mut values: Vec<f64> = sum.singular_values().iter().copied().collect();
    values.sort_by(f64::total_cmp);
    // The second direction: a centimetre at least.
    if anchors.len() < 3 || values[1].is_nan() || values[1] < 1e-4 * n {
        return Err(AlignError::Anchors);
    }
    let rotation = rotation_of(&sum).ok_or(AlignError::Anchors)?;
    let room = Isometry3::from_parts(Translation3::from(to - rotation * from), rotation);
    Ok((room, left_m(anchors, &room)))
}

/// Root mean square of what a pose leaves of the anchors, m.
fn left_m(anchors: &[AnchorPoint], room: &Isometry3<f64>) -> f64 {
    let off =
        |a: &AnchorPoint| (room.transform_point(&a.transmitter_m.into()).coords - a.room_m).norm_squared();
    (anchors.iter().map(off).sum::<f64>() / anchors.len() as f64).sqrt()
}

/// What the specific forces show, transmitter's axes.
struct SpecificForceFit {
    gravity_m_s2: Vector3<f64>,
    /// From the magnetic sensor to the IMU, magnetic sensor's axes.
    lever_m: Vector3<f64>,
    /// IMU axes.
    accel_bias_m_s2: Vector3<f64>,
    residual_m: f64,
}

/// Gravity, lever and accelerometer bias, linear in the second differences of the IMU's position.
fn fit_specific_force(
    stretches: &[Vec<PairedSample>],
    y: &UnitQuaternion<f64>,
) -> Result<SpecificForceFit, AlignError> {
    type Normal = SMatrix<f64, 9, 9>;
    let half = half(stretches);
    let y = y.to_rotation_matrix().into_inner();
    let (mut normal, mut right) = (Normal::zeros(), SVector::<f64, 9>::zeros());
    let mut rows_of = Vec::new();
    for part in stretches.iter().flat_map(|samples| samples.windows(2 * half + 1).step_by((half / 4).max(1)))
    {
        let (rows, value) = second_difference(part, &y);
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
    let part = |at: usize| Vector3::new(found[at], found[at + 1], found[at + 2]);
    Ok(SpecificForceFit {
        lever_m: part(0),
        accel_bias_m_s2: part(3),
        gravity_m_s2: part(6),
        residual_m: (squares / rows_of.len() as f64).sqrt(),
    })
}

/// One of them, from twice `HALF_S` of samples: bend + (second difference of M) lever = specific force - turned bias - time
/// gravity.
fn second_difference(part: &[PairedSample], y: &Matrix3<f64>) -> (SMatrix<f64, 3, 9>, Vector3<f64>) {
    let half = part.len() / 2;
    let dt_s = HALF_S / half as f64;
    let rotation =
        |sample: &PairedSample| sample.transmitter_from_sensor.rotation.to_rotation_matrix().into_inner();
    let position_m = |sample: &PairedSample| sample.transmitter_from_sensor.translation.vector;
    let (mut specific_force_m, mut turned, mut time_s2) = (Vector3::zeros(), Matrix3::zeros(), 0.0);
    for (j, sample) in part.iter().enumerate() {
        let weight = (half - j.abs_diff(half)) as f64 * dt_s * dt_s;
        let axes = rotation(sample) * y;
        specific_force_m += axes * sample.specific_force_m_s2 * weight;
        turned += axes * weight;
        time_s2 += weight;
    }
    let (before, at, after) = (&part[0], &part[half], &part[2 * half]);
    let bend = position_m(after) - position_m(at) * 2.0 + position_m(before);
    let by_lever = rotation(after) - rotation(at) * 2.0 + rotation(before);
    let mut rows = SMatrix::<f64, 3, 9>::zeros();
    rows.fixed_view_mut::<3, 3>(0, 0).copy_from(&by_lever);
    rows.fixed_view_mut::<3, 3>(0, 3).copy_from(&turned);
    rows.fixed_view_mut::<3, 3>(0, 6).copy_from(&(Matrix3::identity() * time_s2));
    (rows, specific_force_m - bend)
}

/// Rotation about the vertical (where the heading is not known) and place from anchors; the tilt stays gravity's.
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
    let yaw = if known { 0.0 } else { libm::atan2(sine, cosine) };
    let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
    Isometry3::from_parts(Translation3::from(to - yaw * from), yaw * x)
}
