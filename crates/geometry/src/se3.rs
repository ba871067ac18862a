//! Rigid motions: exponential, logarithm and distance on SE(3).

use nalgebra::{Isometry3, Matrix3, Translation3, Vector3};

use super::so3;

/// An element of the Lie algebra se(3): a screw motion over one unit of time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Twist {
    /// Rotation vector, rad.
    pub angular: Vector3<f64>,
    /// Translation part of the screw, m: the displacement only where nothing rotates ([`exp`] has `V linear`).
    pub linear: Vector3<f64>,
}

/// The motion that a twist makes in one unit of time, for any angle: closed form of Merckel and Nishida (2010), eq. (9), with
/// series for the coefficients below 0.01 rad. Within 1e-12 of the matrix exponential (tests of this module).
#[inline]
pub fn exp(twist: &Twist) -> Isometry3<f64> {
    let (b, c) = so3::coefficients(twist.angular.norm());
    let h = so3::hat(&twist.angular);
    let v = Matrix3::identity() + h * b + h * h * c;
    Isometry3::from_parts(Translation3::from(v * twist.linear), so3::exp(&twist.angular))
}

/// The twist of a motion, with an angle of at most pi; the inverse of [`exp`], to 1e-12 up to pi - 1e-6.
///
/// By the inverse of the matrix V rather than Merckel and Nishida (2010), eq. (10), whose cubic in the
/// matrix is right but cancels: at 1e-5 rad, where consecutive tracker poses live, it errs by 6e-6.
#[inline]
pub fn log(motion: &Isometry3<f64>) -> Twist {
    let angular = so3::log(&motion.rotation);
    let h = so3::hat(&angular);
    let inverse = Matrix3::identity() - h * 0.5 + h * h * so3::cotangent_coefficient(angular.norm());
    Twist { angular, linear: inverse * motion.translation.vector }
}

/// Distance of two poses, m: length of the twist from `a` to `b`, whose angle counts `metres_per_radian` (m/rad). Left-invariant:
/// the same in every frame of reference, but not for another point of the moving body.
#[inline]
pub fn distance(a: &Isometry3<f64>, b: &Isometry3<f64>, metres_per_radian: f64) -> f64 {
    let twist = log(&a.inv_mul(b));
    (twist.linear.norm_squared() + (metres_per_radian * twist.angular.norm()).powi(2)).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix4;

    fn twist(angle: f64) -> Twist {
        Twist { angular: Vector3::new(0.48, -0.6, 0.64) * angle, linear: Vector3::new(0.3, -1.2, 0.7) }
    }

    fn generator(twist: &Twist) -> Matrix4<f64> {
        let mut matrix = Matrix4::zeros();
        matrix.fixed_view_mut::<3, 3>(0, 0).copy_from(&so3::hat(&twist.angular));
        matrix.fixed_view_mut::<3, 1>(0, 3).copy_from(&twist.linear);
        matrix
    }

    /// Scaled and squared Taylor series: shares nothing with the closed forms.
    fn matrix_exponential(matrix: &Matrix4<f64>) -> Matrix4<f64> {
        let scaled = matrix / 1024.0;
        let mut term = Matrix4::identity();
        let mut sum = Matrix4::identity();
        for n in 1..12 {
            term = term * scaled / f64::from(n);
            sum += term;
        }
        (0..10).fold(sum, |power, _| power * power)
    }

    #[test]
    fn exp_of_log_is_the_identity_map() {
        for angle in [0.0, 1e-9, 1e-7, 1e-5, 1e-4, 1e-3, 1e-2, 0.1, 1.0, 3.1, std::f64::consts::PI - 1e-6] {
            let motion = exp(&twist(angle));
            let back = exp(&log(&motion));
            assert!((motion.to_homogeneous() - back.to_homogeneous()).norm() < 1e-12, "angle {angle}");
        }
    }

    #[test]
    fn exp_agrees_with_the_matrix_exponential() {
        for angle in [0.0, 1e-8, 1e-3, 0.01, 0.7, 3.0] {
            let closed = exp(&twist(angle)).to_homogeneous();
            assert!((closed - matrix_exponential(&generator(&twist(angle)))).norm() < 1e-12, "angle {angle}");
        }
    }

    /// Merckel and Nishida (2010), eq. (10): the logarithm as a cubic in the homogeneous matrix M.
    fn log_by_equation_10(m: &Matrix4<f64>, angle: f64) -> Matrix4<f64> {
        let (s, c) = libm::sincos(angle);
        let (s2, c2) = libm::sincos(2.0 * angle);
        let half = 0.5 * angle;
        let lead = 1.0 / (8.0 * libm::sin(half).powi(3) * libm::cos(half));
        let m2 = m * m;
        let m3 = m2 * m;
        ((angle * c2 - s) * Matrix4::identity() - (angle * c + 2.0 * angle * c2 - s - s2) * m
            + (2.0 * angle * c + angle * c2 - s - s2) * m2
            - (angle * c - s) * m3)
            * lead
    }

    #[test]
    fn log_agrees_with_equation_10_where_that_does_not_cancel() {
        for angle in [0.01, 0.05, 0.3, 1.0, 2.0, 3.0] {
            let motion = exp(&twist(angle));
            let oracle = log_by_equation_10(&motion.to_homogeneous(), angle);
            let error = (generator(&log(&motion)) - oracle).norm();
            assert!(error < 1e-7, "angle {angle}: {error:e}");
        }
    }

    #[test]
    fn the_distance_does_not_depend_on_the_frame_of_reference() {
        let (a, b, c) = (exp(&twist(0.2)), exp(&twist(-1.4)), exp(&twist(2.5)));
        assert!((distance(&a, &b, 0.5) - distance(&(c * a), &(c * b), 0.5)).abs() < 1e-12);
        assert!(distance(&a, &a, 0.5) < 1e-12);
    }
}
