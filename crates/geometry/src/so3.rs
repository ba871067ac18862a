//! Rotations: exponential, logarithm and the right Jacobian of SO(3).

use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};

/// Below this angle (rad) series replace the closed forms.
const SMALL_ANGLE_RAD: f64 = 1e-6;
/// Below this angle (rad) the differences `1 - cos` and `angle - sin` cancel, and their series are exact.
const CANCELLING_ANGLE_RAD: f64 = 1e-2;

/// Matrix of the cross product, skew-symmetric: `hat(a) * b = a x b`.
#[inline]
pub fn hat(v: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(0.0, -v.z, v.y, v.z, 0.0, -v.x, -v.y, v.x, 0.0)
}

/// How the acceleration of a point depends on its place in a frame that turns by `omega`, rad/s, and `alpha`, rad/s², all in the frame's axes: multiplied by the
/// place, m, it is `alpha x r + omega x (omega x r)`, m/s².
#[inline]
pub fn lever(omega: &Vector3<f64>, alpha: &Vector3<f64>) -> Matrix3<f64> {
    hat(alpha) + hat(omega) * hat(omega)
}

/// Rotation by `|w|` rad about `w`, of any length (Rodrigues); the unit quaternion has w < 0 for angles between pi and 3 pi.
#[inline]
pub fn exp(w: &Vector3<f64>) -> UnitQuaternion<f64> {
    let angle = w.norm();
    let half_sinc =
        if angle < SMALL_ANGLE_RAD { 0.5 - angle * angle / 48.0 } else { libm::sin(0.5 * angle) / angle };
    let v = w * half_sinc;
    UnitQuaternion::new_unchecked(Quaternion::from_parts(libm::cos(0.5 * angle), v))
}

/// Rotation vector, rad, of length at most pi; the inverse of [`exp`], to 1e-12 up to pi - 1e-6. Both signs of the quaternion
/// give the same vector.
///
/// By `2 atan2(|v|, w)` with `w >= 0`, which stays accurate close to pi, unlike the trace's arccos.
#[inline]
pub fn log(q: &UnitQuaternion<f64>) -> Vector3<f64> {
    let (w, v) = if q.w < 0.0 { (-q.w, -q.imag()) } else { (q.w, q.imag()) };
    let sine = v.norm();
    let scale = if sine < SMALL_ANGLE_RAD {
        (2.0 / w) * (1.0 - sine * sine / (3.0 * w * w))
    } else {
        2.0 * libm::atan2(sine, w) / sine
    };
    v * scale
}

/// Mean of orientations that are near each other: of their rotation vectors from the first; the identity of none.
pub fn mean(orientations: &[UnitQuaternion<f64>]) -> UnitQuaternion<f64> {
    let first = orientations.first().copied().unwrap_or_else(UnitQuaternion::identity);
    let sum: Vector3<f64> = orientations.iter().map(|q| log(&(first.inverse() * q))).sum();
    first * exp(&(sum / orientations.len().max(1) as f64))
}

/// `(1 - cos t) / t^2` and `(t - sin t) / t^3`, the coefficients that SO(3) and SE(3) share.
pub(super) fn coefficients(angle_rad: f64) -> (f64, f64) {
    let t2 = angle_rad * angle_rad;
    if angle_rad < CANCELLING_ANGLE_RAD {
        (0.5 - t2 / 24.0 * (1.0 - t2 / 30.0), 1.0 / 6.0 - t2 / 120.0 * (1.0 - t2 / 42.0))
    } else {
        ((1.0 - libm::cos(angle_rad)) / t2, (angle_rad - libm::sin(angle_rad)) / (t2 * angle_rad))
    }
}

/// Right Jacobian at the rotation vector `w`, rad: `exp(w + d) = exp(w) * exp(right_jacobian(w) * d)` to first order in `d`
/// (Solà 2017; see `docs/methods/magnetic-pose.md`).
#[inline]
pub fn right_jacobian(w: &Vector3<f64>) -> Matrix3<f64> {
    let (b, c) = coefficients(w.norm());
    let h = hat(w);
    Matrix3::identity() - h * b + h * h * c
}

/// Inverse of [`right_jacobian`] for angles below 2 pi, where it becomes singular.
#[inline]
pub fn right_jacobian_inverse(w: &Vector3<f64>) -> Matrix3<f64> {
    let h = hat(w);
    Matrix3::identity() + h * 0.5 + h * h * cotangent_coefficient(w.norm())
}

/// `(1 - (t/2) cot(t/2)) / t^2`; 1/12 at zero.
pub(super) fn cotangent_coefficient(angle_rad: f64) -> f64 {
    if angle_rad < CANCELLING_ANGLE_RAD {
        1.0 / 12.0 + angle_rad * angle_rad / 720.0
    } else {
        let half = 0.5 * angle_rad;
        (1.0 - half * libm::cos(half) / libm::sin(half)) / (angle_rad * angle_rad)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn axis() -> Vector3<f64> {
        Vector3::new(0.48, -0.6, 0.64)
    }

    #[test]
    fn log_inverts_exp_from_zero_to_pi() {
        for angle in [0.0, 1e-12, 1e-9, 1e-7, 1e-6, 1e-4, 1e-2, 0.5, 1.5, 3.1, std::f64::consts::PI - 1e-6] {
            let w = axis() * angle;
            assert!((log(&exp(&w)) - w).norm() < 1e-12, "angle {angle}");
        }
    }

    #[test]
    fn log_is_the_same_for_both_signs_of_the_quaternion() {
        let q = exp(&(axis() * 2.0));
        let negative = UnitQuaternion::new_unchecked(-q.into_inner());
        assert!((log(&q) - log(&negative)).norm() < 1e-15);
    }

    #[test]
    fn the_right_jacobian_is_the_derivative_of_exp() {
        for angle in [0.0, 1e-3, 0.3, 2.0] {
            let w = axis() * angle;
            let analytic = right_jacobian(&w);
            let step = 1e-6;
            for column in 0..3 {
                let mut d = Vector3::zeros();
                d[column] = step;
                let difference = log(&(exp(&(w - d)).inverse() * exp(&(w + d)))) / (2.0 * step);
                assert!((analytic.column(column) - difference).norm() < 1e-8, "angle {angle}");
            }
            assert!((analytic * right_jacobian_inverse(&w) - Matrix3::identity()).norm() < 1e-12);
        }
    }

    #[test]
    fn hat_is_the_cross_product() {
        let (a, b) = (Vector3::new(1.0, 2.0, 3.0), Vector3::new(-0.5, 4.0, 0.25));
        assert_eq!(hat(&a) * b, a.cross(&b));
    }
}
