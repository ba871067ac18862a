//! Intrinsics of one IMU: gyro bias, accelerometer bias and scale, magnetometer ellipsoid.
//!
//! In: a recording in which the unit was laid to rest in many directions (and turned between them). Out: what to
//! subtract and multiply, with its quality; or a refusal that says which directions are missing. It never guesses from
//! directions that were not held.
//!
//! At rest the specific force has the length of gravity whatever the direction: with six unknowns (bias and scale
//! of three axes) nine directions leave three to check with. The magnetometer's samples, of all the
//! recording, lie on an ellipsoid whose centre is the hard iron and whose shape is the soft iron; it is fitted as a quadric.

use nalgebra::{Matrix3, Matrix6, SMatrix, SVector, SymmetricEigen, Vector3, Vector6};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::ahrs::ImuSample;

/// Standard gravity, m/s²: what the scale is referred to.
const GRAVITY_M_S2: f64 = 9.806_65;
/// Directions held at rest that it takes.
const MIN_DIRECTIONS: usize = 9;
/// Two rests count as two directions from this angle on, degrees.
const NEW_DIRECTION_DEG: f64 = 20.0;
/// A rest lasts at least this long, s.
const MIN_REST_S: f64 = 1.0;
/// A rest's rate departs from its mean by less, rad/s, and its force, m/s².
const REST_RATE: f64 = 0.03;
const REST_FORCE: f64 = 0.3;
/// Largest accepted residual of the force's length, m/s².
const MAX_RESIDUAL: f64 = 0.1;
/// Directions along each axis, both ways, of which at least one must be within this angle, degrees.
const NEAR_AXIS_DEG: f64 = 40.0;

/// What was found for one unit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Intrinsics {
    /// Subtract from the gyro, rad/s.
    pub gyro_bias_rad_s: [f64; 3],
    /// Standard deviation of that bias between the rests, rad/s.
    pub gyro_bias_sigma_rad_s: f64,
    /// Subtract from the accelerometer, m/s²; then multiply by the scale.
    pub accel_bias_m_s2: [f64; 3],
    /// Multiply the accelerometer, after subtracting the bias.
    pub accel_scale: [f64; 3],
    /// Root mean square of the length's error over the rests, m/s².
    pub accel_residual_m_s2: f64,
    /// Directions that were held.
    pub directions: usize,
    /// The magnetometer's, where there is one.
    pub mag: Option<MagIntrinsics>,
}

/// Hard and soft iron: `m = matrix (raw - offset)` has the length `norm` in every direction.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MagIntrinsics {
    /// Hard iron, in the unit of the samples.
    pub offset: [f64; 3],
    /// Soft iron, row by row; symmetric, determinant 1.
    pub matrix: [[f64; 3]; 3],
    /// Length of the corrected field, in the unit of the samples.
    pub norm: f64,
    /// Root mean square of the length's error, as a part of the length.
    pub residual: f64,
}

/// Why a unit could not be calibrated.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum IntrinsicsError {
    /// Too few directions at rest.
    #[error(
        "only {found} directions were held at rest, it takes {needed}: lay the unit on each of its six sides and on \
         some edges, {seconds:.0} s each"
    )]
    Directions {
        /// Directions there were.
        found: usize,
        /// Directions it takes.
        needed: usize,
        /// How long to hold each, s.
        seconds: f64,
    },
    /// The directions leave a side out.
    #[error("no rest with the unit's {missing} axis up: lay it on that side too")]
    Side {
        /// The axis, with its sign.
        missing: &'static str,
    },
    /// The accelerometer does not fit.
    #[error(
        "the rests disagree by {found:.2} m/s² (limit {limit:.2}): hold the unit stiller, or it is broken"
    )]
    Residual {
        /// Root mean square, m/s².
        found: f64,
        /// Largest accepted, m/s².
        limit: f64,
    },
    /// The magnetometer's samples lie on no ellipsoid.
    #[error(
        "the magnetometer's samples show no ellipsoid: turn the unit through all directions, away from iron"
    )]
    Ellipsoid,
}

impl Intrinsics {
    /// Corrects a sample.
    pub fn apply(&self, sample: &ImuSample) -> ImuSample {
        let accel = sample.accel_m_s2 - Vector3::from(self.accel_bias_m_s2);
        ImuSample {
            gyro_rad_s: sample.gyro_rad_s - Vector3::from(self.gyro_bias_rad_s),
            accel_m_s2: accel.component_mul(&Vector3::from(self.accel_scale)),
            mag: sample.mag.map(|raw| self.mag.as_ref().map_or(raw, |mag| mag.apply(raw))),
        }
    }
}

impl MagIntrinsics {
    /// Corrects a field.
    pub fn apply(&self, raw: Vector3<f64>) -> Vector3<f64> {
        let rows = self.matrix.map(|row| Vector3::from(row).transpose());
        Matrix3::from_rows(&rows) * (raw - Vector3::from(self.offset))
    }
}

/// One rest: means over it.
#[derive(Clone, Copy, Debug)]
struct Rest {
    gyro: Vector3<f64>,
    accel: Vector3<f64>,
}

/// Calibrates a unit from samples `dt_s` apart.
///
/// # Errors
/// Directions that are missing, rests that disagree, or a magnetometer that saw too little.
pub fn calibrate(samples: &[ImuSample], dt_s: f64) -> Result<Intrinsics, IntrinsicsError> {
    let rests = rests(samples, dt_s);
    let mut directions: Vec<Vector3<f64>> = Vec::new();
    for rest in &rests {
        if directions.iter().all(|known| known.angle(&rest.accel).to_degrees() > NEW_DIRECTION_DEG) {
            directions.push(rest.accel);
        }
    }
    if directions.len() < MIN_DIRECTIONS {
        let found = directions.len();
        return Err(IntrinsicsError::Directions { found, needed: MIN_DIRECTIONS, seconds: 2.0 * MIN_REST_S });
    }
    for (axis, names) in [["+x", "-x"], ["+y", "-y"], ["+z", "-z"]].into_iter().enumerate() {
        for (sign, missing) in [1.0, -1.0].into_iter().zip(names) {
            let mut side = Vector3::zeros();
            side[axis] = sign;
            if directions.iter().all(|held| held.angle(&side).to_degrees() > NEAR_AXIS_DEG) {
                return Err(IntrinsicsError::Side { missing });
            }
        }
    }
    let (accel_bias, accel_scale, accel_residual_m_s2) = fit_gravity(&rests);
    if accel_residual_m_s2.is_nan() || accel_residual_m_s2 > MAX_RESIDUAL {
        return Err(IntrinsicsError::Residual { found: accel_residual_m_s2, limit: MAX_RESIDUAL });
    }
    let count = rests.len() as f64;
    let bias = rests.iter().map(|rest| rest.gyro).sum::<Vector3<f64>>() / count;
    let spread = rests.iter().map(|rest| (rest.gyro - bias).norm_squared()).sum::<f64>() / (3.0 * count);
    let fields: Vec<Vector3<f64>> = samples.iter().filter_map(|sample| sample.mag).collect();
    Ok(Intrinsics {
        gyro_bias_rad_s: bias.into(),
        gyro_bias_sigma_rad_s: spread.sqrt(),
        accel_bias_m_s2: accel_bias.into(),
        accel_scale: accel_scale.into(),
        accel_residual_m_s2,
        directions: directions.len(),
        mag: if fields.is_empty() { None } else { Some(fit_ellipsoid(&fields)?) },
    })
}

/// Windows of a second in which nothing moves, joined.
fn rests(samples: &[ImuSample], dt_s: f64) -> Vec<Rest> {
    let length = ((MIN_REST_S / dt_s).ceil() as usize).max(2);
    samples
        .chunks_exact(length)
        .filter_map(|window| {
            let mean = |value: fn(&ImuSample) -> Vector3<f64>| {
                window.iter().map(value).sum::<Vector3<f64>>() / length as f64
            };
            let rest = Rest { gyro: mean(|s| s.gyro_rad_s), accel: mean(|s| s.accel_m_s2) };
            let still = window.iter().all(|sample| {
                (sample.gyro_rad_s - rest.gyro).norm() < REST_RATE
                    && (sample.accel_m_s2 - rest.accel).norm() < REST_FORCE
            });
            still.then_some(rest)
        })
        .collect()
}

/// Bias and scale for which every rest has the length of gravity, by Gauss-Newton; and the residual.
fn fit_gravity(rests: &[Rest]) -> (Vector3<f64>, Vector3<f64>, f64) {
    let (mut bias, mut scale) = (Vector3::zeros(), Vector3::repeat(1.0));
    let residual = |bias: &Vector3<f64>, scale: &Vector3<f64>, rest: &Rest| {
        let corrected = (rest.accel - bias).component_mul(scale);
        (corrected, corrected.norm() - GRAVITY_M_S2)
    };
    for _ in 0..20 {
        let mut information = Matrix6::identity() * 1e-9;
        let mut gradient = Vector6::zeros();
        for rest in rests {
            let (corrected, error) = residual(&bias, &scale, rest);
            let unit = corrected.normalize();
            let by_bias = -unit.component_mul(&scale);
            let by_scale = unit.component_mul(&(rest.accel - bias));
            let row = Vector6::new(by_bias.x, by_bias.y, by_bias.z, by_scale.x, by_scale.y, by_scale.z);
            information += row * row.transpose();
            gradient += row * error;
        }
        let Some(step) = information.cholesky().map(|c| c.solve(&gradient)) else { break };
        bias -= step.fixed_rows::<3>(0);
        scale -= step.fixed_rows::<3>(3);
        if step.norm() < 1e-12 {
            break;
        }
    }
    let sum: f64 = rests.iter().map(|rest| residual(&bias, &scale, rest).1.powi(2)).sum();
    (bias, scale, (sum / rests.len() as f64).sqrt())
}

/// Quadric through the samples: `x'Ax + 2 b'x = 1`, centred and scaled first so that the numbers are near one.
fn fit_ellipsoid(fields: &[Vector3<f64>]) -> Result<MagIntrinsics, IntrinsicsError> {
    let count = fields.len() as f64;
    let mean = fields.iter().sum::<Vector3<f64>>() / count;
    let size = (fields.iter().map(|m| (m - mean).norm_squared()).sum::<f64>() / count).sqrt();
    if !size.is_finite() || size <= 0.0 {
        return Err(IntrinsicsError::Ellipsoid);
    }
    let mut normal = SMatrix::<f64, 9, 9>::zeros();
    let mut right = SVector::<f64, 9>::zeros();
    for field in fields {
        let m = (field - mean) / size;
        let row = SVector::<f64, 9>::from_row_slice(&[
            m.x * m.x,
            m.y * m.y,
            m.z * m.z,
            2.0 * m.x * m.y,
            2.0 * m.x * m.z,
            2.0 * m.y * m.z,
            2.0 * m.x,
            2.0 * m.y,
            2.0 * m.z,
        ]);
        normal += row * row.transpose() / count;
        right += row / count;
    }
    // Where the samples cover a cap or a plane, many quadrics pass through them.
    let weakest = normal.symmetric_eigenvalues().min();
    if weakest.is_nan() || weakest < 1e-4 {
        return Err(IntrinsicsError::Ellipsoid);
    }
    let Some(q) = normal.cholesky().map(|c| c.solve(&right)) else { return Err(IntrinsicsError::Ellipsoid) };
    let a = Matrix3::new(q[0], q[3], q[4], q[3], q[1], q[5], q[4], q[5], q[2]);
    let Some(inverse) = a.try_inverse() else { return Err(IntrinsicsError::Ellipsoid) };
    let b = Vector3::new(q[6], q[7], q[8]);
    let centre = -inverse * b;
    let shape = a / (1.0 + b.dot(&(inverse * b)));
    let eigen = SymmetricEigen::new(shape);
    let least = eigen.eigenvalues.min();
    if least.is_nan() || least <= 0.0 {
        return Err(IntrinsicsError::Ellipsoid);
    }
    let root = eigen.eigenvalues.map(f64::sqrt);
    let root = eigen.eigenvectors * Matrix3::from_diagonal(&root) * eigen.eigenvectors.transpose();
    let volume = root.determinant().cbrt();
    let matrix = root / volume;
    let norm = size / volume;
    let offset = mean + centre * size;
    let sum: f64 = fields.iter().map(|field| ((matrix * (field - offset)).norm() / norm - 1.0).powi(2)).sum();
    Ok(MagIntrinsics {
        offset: offset.into(),
        matrix: [0, 1, 2].map(|i| [matrix[(i, 0)], matrix[(i, 1)], matrix[(i, 2)]]),
        norm,
        residual: (sum / count).sqrt(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::so3;

    /// A unit with errors of MPU class, laid to rest in given directions and turned between them.
    fn recording(directions: &[Vector3<f64>]) -> Vec<ImuSample> {
        let (gyro_bias, accel_bias) = (Vector3::new(0.05, -0.03, 0.02), Vector3::new(0.6, -0.7, 0.3));
        let gain = Vector3::new(1.03, 0.98, 1.01);
        let soft = Matrix3::new(1.1, 0.05, -0.03, 0.05, 0.95, 0.02, -0.03, 0.02, 1.0);
        let mut samples = Vec::new();
        let mut noise = 1_u64;
        let mut random = || {
            noise = noise.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (noise >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
        };
        for (k, up) in directions.iter().enumerate() {
            for i in 0..400 {
                // Two seconds at rest, then two of turning about a changing axis.
                let turning = f64::from(i - 200).max(0.0) * 0.01;
                let turn = so3::exp(&(Vector3::new(1.0, k as f64 % 3.0, 2.0 - k as f64 % 5.0) * turning));
                let side = turn * up.cross(&Vector3::new(0.3, -0.5, 0.8)).normalize();
                let up = turn * up.normalize();
                let rate = if turning > 0.0 { Vector3::repeat(1.0) } else { Vector3::zeros() };
                let small = Vector3::from_fn(|_, _| random());
                let field = side * 20.0 - up * 40.0;
                samples.push(ImuSample {
                    gyro_rad_s: rate + gyro_bias + small * 0.01,
                    accel_m_s2: (up * GRAVITY_M_S2).component_div(&gain) + accel_bias + small * 0.05,
                    mag: Some(soft * field + Vector3::new(12.0, -7.0, 25.0) + small * 0.3),
                });
            }
        }
        samples
    }

    fn many() -> Vec<Vector3<f64>> {
        let mut all = Vec::new();
        for s in [1.0, -1.0] {
            all.extend([Vector3::x() * s, Vector3::y() * s, Vector3::z() * s]);
            all.extend([Vector3::new(s, 1.0, 1.0), Vector3::new(-1.0, s, 0.0), Vector3::new(1.0, -1.0, s)]);
        }
        all
    }

    #[test]
    fn errors_of_a_unit_are_found() {
        let samples = recording(&many());
        let found = calibrate(&samples, 0.01).unwrap();
        let off = |a: [f64; 3], b: [f64; 3]| (Vector3::from(a) - Vector3::from(b)).amax();
        assert!(off(found.gyro_bias_rad_s, [0.05, -0.03, 0.02]) < 1e-3);
        assert!(off(found.accel_bias_m_s2, [0.6, -0.7, 0.3]) < 0.02, "{found:?}");
        assert!(off(found.accel_scale, [1.03, 0.98, 1.01]) < 0.003, "{found:?}");
        let mag = found.mag.as_ref().unwrap();
        assert!(off(mag.offset, [12.0, -7.0, 25.0]) < 0.3, "{mag:?}");
        assert!(mag.residual < 0.01, "{mag:?}");
        let corrected = found.apply(&samples[50]);
        assert!((corrected.accel_m_s2.norm() - GRAVITY_M_S2).abs() < 0.05);
        assert!((corrected.mag.unwrap().norm() / mag.norm - 1.0).abs() < 0.03);
    }

    #[test]
    fn missing_directions_are_named() {
        let few = calibrate(&recording(&many()[..5]), 0.01).unwrap_err();
        assert!(matches!(few, IntrinsicsError::Directions { found: 5, .. }), "{few:?}");
        // Everything but what has the z axis well below the horizon.
        let above: Vec<_> = many().into_iter().filter(|up| up.normalize().z > -0.1).collect();
        let side = calibrate(&recording(&above), 0.01).unwrap_err();
        assert_eq!(side, IntrinsicsError::Side { missing: "-z" });
    }

    #[test]
    fn a_magnetometer_that_was_not_turned_is_refused() {
        let mut samples = recording(&many());
        for sample in &mut samples {
            sample.mag = sample.mag.map(|m| Vector3::new(m.x, m.y, 0.0));
        }
        assert_eq!(calibrate(&samples, 0.01).unwrap_err(), IntrinsicsError::Ellipsoid);
    }
}
