//! How a transmitter stands in the room, and how an IMU sits on a magnetic sensor: the mathematics of `stage.align`.
//!
//! In: a recording of one sensor that has both, waved about: magnetic poses in the transmitter's axes, and the IMU's orientation and
//! specific force at the same times; optionally anchors, places whose position in the room is known. Out: room from transmitter,
//! rotation and lever arm between the two, each with its residual. It never returns what the movement did not show.
//!
//! Rotations: `X M(t) Y = A(t)` for all t, with M the sensor's and A the IMU's orientation, X room from transmitter and Y
//! sensor from IMU: linear in the matrices X and Y', then refined on the group. Lever: the second difference of the
//! position over some tenths of a second is the specific force weighed by a triangle, so that no noise is differentiated twice.

use nalgebra::{Isometry3, Matrix3, Matrix6, SMatrix, Translation3, UnitQuaternion, Vector3, Vector6};
use serde::{Deserialize, Serialize};
use thiserror::Error;

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
    /// The transmitter in the room; without anchors its origin is the room's, and with a level frame of unknown heading yaw
    /// is that frame's.
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
    let (x, y, residual_rad) = refine(samples, x, y);
    let (lever_m, accel_bias_m_s2, residual_m) = lever(samples, &x)?;
    let mut room = Isometry3::from_parts(Translation3::identity(), x);
    let mut anchors_m = 0.0;
    if !anchors.is_empty() {
        room = anchor(anchors, &x, heading);
        let squares: f64 = anchors
            .iter()
            .map(|a| (room.transform_point(&a.transmitter_m.into()).coords - a.room_m).norm_squared())
            .sum();
        anchors_m = (squares / anchors.len() as f64).sqrt();
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

/// Gauss-Newton on both rotations, with Huber's weights.
fn refine(
    samples: &[BothSample],
    mut x: UnitQuaternion<f64>,
    mut y: UnitQuaternion<f64>,
) -> (UnitQuaternion<f64>, UnitQuaternion<f64>, f64) {
    const HUBER_RAD: f64 = 0.05;
    let mut residual = 0.0;
    for _ in 0..10 {
        let (mut gradient, mut normal) = (Vector6::zeros(), Matrix6::zeros());
        residual = 0.0;
        for sample in samples {
            // A = X M Y exp(r); X grows from the left, Y from the right.
            let predicted = x * sample.transmitter_from_sensor.rotation * y;
            let r = log(&(predicted.inverse() * sample.level_from_imu));
            residual += r.norm_squared();
            let weight = (HUBER_RAD / r.norm()).min(1.0);
            let mut rows = SMatrix::<f64, 3, 6>::zeros();
            let by_x = predicted.inverse().to_rotation_matrix().into_inner();
            rows.fixed_view_mut::<3, 3>(0, 0).copy_from(&by_x);
            rows.fixed_view_mut::<3, 3>(0, 3).copy_from(&Matrix3::identity());
            gradient += rows.transpose() * r * weight;
            normal += rows.transpose() * rows * weight;
        }
        let Some(step) = normal.cholesky().map(|c| c.solve(&gradient)) else { break };
        x = exp(&step.fixed_rows::<3>(0).into_owned()) * x;
        y *= exp(&step.fixed_rows::<3>(3).into_owned());
        if step.norm() < 1e-10 {
            break;
        }
    }
    (x, y, (residual / samples.len() as f64).sqrt())
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

#[cfg(test)]
mod tests {
    use super::*;

    type V = Vector3<f64>;

    struct Waved {
        room_from_transmitter: Isometry3<f64>,
        q_sensor_imu: UnitQuaternion<f64>,
        lever_m: V,
    }

    impl Waved {
        /// A transmitter tilted by ten degrees.
        fn new() -> Self {
            let tilt = exp(&V::new(10_f64.to_radians(), 0.0, 0.0));
            Self {
                room_from_transmitter: Isometry3::from_parts(
                    Translation3::new(0.4, -0.2, 0.9),
                    exp(&V::new(0.0, 0.0, 0.7)) * tilt,
                ),
                q_sensor_imu: exp(&V::new(0.9, -1.4, 0.3)),
                lever_m: V::new(0.021, -0.013, 0.034),
            }
        }

        /// Sensor in the room.
        fn pose(t: f64, turning: f64) -> Isometry3<f64> {
            let turn = V::new((1.9 * t).sin(), (1.3 * t + 0.4).cos(), 0.9 * (2.7 * t).sin()) * turning;
            let place = V::new(0.3 * (1.1 * t).sin(), 0.2 * (1.7 * t).cos(), 1.0 + 0.15 * (2.3 * t).sin());
            Isometry3::from_parts(place.into(), exp(&turn))
        }

        /// Forty seconds at 100 Hz with 0.5 mm, 0.3 degrees and a bias.
        fn samples(&self, turning: f64, noise: f64) -> Vec<BothSample> {
            let mut state = 7_u64;
            let mut random = || {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                // Uniform of variance 1.
                ((state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5) * 12_f64.sqrt() * noise
            };
            let imu = |t: f64| {
                let sensor = Self::pose(t, turning);
                sensor.transform_point(&self.lever_m.into()).coords
            };
            (0..4000)
                .map(|k| {
                    let t_s = 0.01 * f64::from(k);
                    let h = 1e-3;
                    let accel = (imu(t_s + h) + imu(t_s - h) - imu(t_s) * 2.0) / (h * h);
                    let room_from_sensor = Self::pose(t_s, turning);
                    let mut pose = self.room_from_transmitter.inverse() * room_from_sensor;
                    pose.translation.vector += V::from_fn(|_, _| 5e-4 * random());
                    pose.rotation *= exp(&V::from_fn(|_, _| 0.005 * random()));
                    let level_from_imu = room_from_sensor.rotation * self.q_sensor_imu;
                    let force = level_from_imu.inverse() * (accel + V::z() * GRAVITY_M_S2);
                    BothSample {
                        t_s,
                        transmitter_from_sensor: pose,
                        level_from_imu: level_from_imu * exp(&V::from_fn(|_, _| 0.01 * random())),
                        force_m_s2: force
                            + V::new(0.03, -0.02, 0.04) * noise
                            + V::from_fn(|_, _| 0.03 * random()),
                    }
                })
                .collect()
        }
    }

    #[test]
    fn a_tilted_transmitter_is_found_within_half_a_degree_and_five_millimetres() {
        let waved = Waved::new();
        let anchors =
            [V::new(0.3, 0.1, 0.2), V::new(-0.4, 0.5, 0.1), V::new(0.1, -0.6, 0.5)].map(|transmitter_m| {
                let room_m = waved.room_from_transmitter.transform_point(&transmitter_m.into()).coords;
                AnchorPoint { transmitter_m, room_m: room_m + V::new(0.001, -0.001, 0.001) }
            });
        let found = align(&waved.samples(1.0, 1.0), &anchors, true).unwrap();
        let off = found.room_from_transmitter.rotation.angle_to(&waved.room_from_transmitter.rotation);
        assert!(off.to_degrees() < 0.5, "room: {} degrees", off.to_degrees());
        let off = found.q_sensor_imu.angle_to(&waved.q_sensor_imu).to_degrees();
        assert!(off < 0.5, "IMU: {off} degrees");
        let off = (found.lever_m - waved.lever_m).norm();
        assert!(off < 5e-3, "lever: {off} m");
        let place = found.room_from_transmitter.translation.vector;
        let off = (place - waved.room_from_transmitter.translation.vector).norm();
        assert!(off < 5e-3, "transmitter: {off} m");
        assert!(
            (found.accel_bias_m_s2 - V::new(0.03, -0.02, 0.04)).norm() < 0.02,
            "{:?}",
            found.accel_bias_m_s2
        );
        assert!(found.residual_rad > 0.005 && found.residual_rad < 0.03);
    }

    #[test]
    fn without_noise_it_is_exact_and_anchors_give_the_heading() {
        let waved = Waved::new();
        let mut samples = waved.samples(1.0, 0.0);
        // A level frame of its own heading.
        let own = exp(&V::new(0.0, 0.0, -1.1));
        for sample in &mut samples {
            sample.level_from_imu = own * sample.level_from_imu;
        }
        let anchors = [V::new(0.3, 0.1, 0.2), V::new(-0.4, 0.5, 0.1)].map(|transmitter_m| AnchorPoint {
            transmitter_m,
            room_m: waved.room_from_transmitter.transform_point(&transmitter_m.into()).coords,
        });
        let found = align(&samples, &anchors, false).unwrap();
        let (off, expected) = (found.room_from_transmitter, waved.room_from_transmitter);
        assert!(off.rotation.angle_to(&expected.rotation) < 1e-7);
        assert!((off.translation.vector - expected.translation.vector).norm() < 1e-7);
        assert!((found.lever_m - waved.lever_m).norm() < 2e-4, "{:?}", found.lever_m);
        assert!(found.anchors_m < 1e-7);
    }

    #[test]
    fn what_does_not_turn_is_refused() {
        let waved = Waved::new();
        assert_eq!(align(&waved.samples(0.0, 0.0), &[], true), Err(AlignError::OneAxis));
        assert!(matches!(align(&waved.samples(1.0, 0.0)[..50], &[], true), Err(AlignError::TooShort { .. })));
    }
}
