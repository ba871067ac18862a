//! The two fits behind the intrinsics of an IMU: gravity's length at rest, and the ellipsoid of the magnetic field.

use nalgebra::{Matrix3, SMatrix, SVector, SymmetricEigen, Vector3};

use super::rests::Rest;
use super::{IntrinsicsError, MagIntrinsics};
use posed_geometry::GRAVITY_M_S2;

/// Unknowns of the accelerometer: bias, scale, cross-axis terms.
const UNKNOWNS: usize = 9;
/// Least eigenvalue of the quadric's normal matrix: below, the samples cover a cap or a plane, and many pass through them. A
/// whole sphere has 0.13.
const WEAKEST: f64 = 1e-4;

/// What turns an accelerometer's samples into specific force: `(diag(scale) + cross) (a - bias)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Gravity {
    pub(super) bias: Vector3<f64>,
    pub(super) scale: Vector3<f64>,
    /// Symmetric part beside the diagonal: yz, xz, xy.
    pub(super) cross: Vector3<f64>,
    /// Root mean square of the length's error over the rests, m/s².
    pub(super) residual: f64,
}

/// The symmetric gain of an accelerometer.
pub(super) fn gain(scale: &Vector3<f64>, cross: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(scale.x, cross.z, cross.y, cross.z, scale.y, cross.x, cross.y, cross.x, scale.z)
}

/// Bias and gain for which every rest has the length of gravity, by Gauss-Newton. `with_cross`: enough directions for nine
/// unknowns; else the axes count as square.
pub(super) fn fit_gravity(rests: &[Rest], with_cross: bool) -> Gravity {
    let (mut bias, mut scale, mut cross) = (Vector3::zeros(), Vector3::repeat(1.0), Vector3::zeros());
    let error = |bias: &Vector3<f64>, gain: &Matrix3<f64>, rest: &Rest| {
        let corrected = gain * (rest.accel - bias);
        (corrected, corrected.norm() - GRAVITY_M_S2)
    };
    for _ in 0..20 {
        let gain = gain(&scale, &cross);
        let mut information = SMatrix::<f64, UNKNOWNS, UNKNOWNS>::identity() * 1e-9;
        if !with_cross {
            (6..UNKNOWNS).for_each(|k| information[(k, k)] = 1e9);
        }
        let mut gradient = SVector::<f64, UNKNOWNS>::zeros();
        for rest in rests {
            let (corrected, error) = error(&bias, &gain, rest);
            let (unit, raw) = (corrected.normalize(), rest.accel - bias);
            let mut row = SVector::<f64, UNKNOWNS>::zeros();
            row.fixed_rows_mut::<3>(0).copy_from(&(-(gain * unit)));
            row.fixed_rows_mut::<3>(3).copy_from(&unit.component_mul(&raw));
            for k in 0..3 {
                let (i, j) = ((k + 1) % 3, (k + 2) % 3);
                row[6 + k] = unit[i] * raw[j] + unit[j] * raw[i];
            }
            information += row * row.transpose();
            gradient += row * error;
        }
        let Some(step) = information.cholesky().map(|c| c.solve(&gradient)) else { break };
        bias -= step.fixed_rows::<3>(0);
        scale -= step.fixed_rows::<3>(3);
        if with_cross {
            cross -= step.fixed_rows::<3>(6);
        }
        if step.norm() < 1e-12 {
            break;
        }
    }
    let gain = gain(&scale, &cross);
    let sum: f64 = rests.iter().map(|rest| error(&bias, &gain, rest).1.powi(2)).sum();
    Gravity { bias, scale, cross, residual: (sum / rests.len() as f64).sqrt() }
}

/// The least squares problem of a quadric `x'Ax + 2 b'x = 1` through fields, centred and scaled so that the numbers are near one.
struct Quadric {
    mean: Vector3<f64>,
    size: f64,
    normal: SMatrix<f64, 9, 9>,
    right: SVector<f64, 9>,
}

impl Quadric {
    fn of(fields: &[Vector3<f64>]) -> Option<Self> {
        let count = fields.len() as f64;
        let mean = fields.iter().sum::<Vector3<f64>>() / count;
        let size = (fields.iter().map(|m| (m - mean).norm_squared()).sum::<f64>() / count).sqrt();
        if !size.is_finite() || size <= 0.0 {
            return None;
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
        Some(Self { mean, size, normal, right })
    }
}

/// How much of the sphere fields have been seen in: the least eigenvalue of the fit; 0.13 is all of it, evenly.
pub(super) fn seen(fields: &[Vector3<f64>]) -> f64 {
    Quadric::of(fields).map_or(0.0, |quadric| quadric.normal.symmetric_eigenvalues().min().max(0.0))
}

/// The ellipsoid through fields.
pub(super) fn fit_ellipsoid(fields: &[Vector3<f64>]) -> Result<MagIntrinsics, IntrinsicsError> {
    let Quadric { mean, size, normal, right } = Quadric::of(fields).ok_or(IntrinsicsError::Ellipsoid)?;
    let weakest = normal.symmetric_eigenvalues().min();
    if weakest.is_nan() || weakest < WEAKEST {
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
    let volume = libm::cbrt(root.determinant());
    let matrix = root / volume;
    let norm = size / volume;
    let offset = mean + centre * size;
    let sum: f64 = fields.iter().map(|field| ((matrix * (field - offset)).norm() / norm - 1.0).powi(2)).sum();
    Ok(MagIntrinsics {
        offset: offset.into(),
        matrix: [0, 1, 2].map(|i| [matrix[(i, 0)], matrix[(i, 1)], matrix[(i, 2)]]),
        norm,
        residual: (sum / fields.len() as f64).sqrt(),
    })
}
