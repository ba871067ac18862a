//! The three-axis dipole source and its inversion.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

/// Field of three unit dipoles along the axes at `p_m` (m) from them, one column per dipole, 1/m^3.
///
/// K(p) = r^-3 (3 u u' - I) with r = |p|, u = p / r, in units of mu0 m / 4 pi. It is even, K(p) = K(-p),
/// which is why a device cannot tell p from -p. It is not finite at the dipoles themselves.
pub fn field_matrix(p_m: &Vector3<f64>) -> Matrix3<f64> {
    let r = p_m.norm();
    let u = p_m / r;
    (3.0 * u * u.transpose() - Matrix3::identity()) / r.powi(3)
}

/// What a sensor of the given orientation (sensor to transmitter) reads in that field: S = A' B.
///
/// `field` is that of [`field_matrix`] or [`Environment::field`](super::Environment::field), in 1/m^3 as the result. Rows are the
/// sensor's axes, columns the source's.
pub fn signal_matrix(field: &Matrix3<f64>, orientation: &UnitQuaternion<f64>) -> Matrix3<f64> {
    orientation.to_rotation_matrix().matrix().transpose() * field
}

/// The pose that a device solves from its signals.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Solution {
    /// Position of the sensor in the transmitter frame, m.
    pub position_m: Vector3<f64>,
    /// Sensor to transmitter.
    pub orientation: UnitQuaternion<f64>,
}

/// Solves the pure dipole model for the pose, in the transmitter frame; `signals` in 1/m^3, as of [`signal_matrix`].
///
/// S'S = r^-6 (3 u u' + I): the range comes from the trace, the direction is the leading eigenvector, its
/// sign is chosen so that the position lies on the side of `hemisphere` (an axis in the transmitter
/// frame, of any length), and A' = S K^-1 is projected to a rotation by a singular value decomposition. The model knows no metal:
/// with it, position and orientation are distorted.
///
/// `None` when the signals hold no pose: zero, not finite, or of rank below two.
pub fn solve(signals: &Matrix3<f64>, hemisphere: &Vector3<f64>) -> Option<Solution> {
    let gram = signals.transpose() * signals;
    let trace = gram.trace();
    if !trace.is_normal() {
        return None;
    }
    let r = libm::pow(6.0 / trace, 1.0 / 6.0);
    let eigen = gram.symmetric_eigen();
    let mut u: Vector3<f64> = eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned();
    if u.dot(hemisphere) < 0.0 {
        u = -u;
    }
    let position_m = r * u;
    // K^-1 = r^3 (3/2 u u' - I), since (3 u u' - I)(3/2 u u' - I) = I.
    let inverse = r.powi(3) * (1.5 * u * u.transpose() - Matrix3::identity());
    let orientation = nearest_rotation(&(signals * inverse).transpose())?;
    Some(Solution { position_m, orientation })
}

/// The rotation nearest to `m` in the Frobenius norm.
fn nearest_rotation(m: &Matrix3<f64>) -> Option<UnitQuaternion<f64>> {
    let svd = m.svd(true, true);
    let (u, v_t) = (svd.u?, svd.v_t?);
    let sign = (u * v_t).determinant().signum();
    let rotation = u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * v_t;
    if !rotation.iter().all(|x| x.is_finite()) {
        return None;
    }
    Some(UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::{Purpose, Random};

    fn pose(random: &mut Random) -> (Vector3<f64>, UnitQuaternion<f64>) {
        let mut v = || Vector3::new(random.normal(), random.normal(), random.normal());
        (v().normalize(), UnitQuaternion::new(v()))
    }

    #[test]
    fn the_field_is_the_same_at_p_and_minus_p() {
        let p = Vector3::new(0.3, -0.7, 1.1);
        assert_eq!(field_matrix(&p), field_matrix(&-p));
    }

    #[test]
    fn on_the_axis_the_field_is_twice_that_beside_it() {
        let k = field_matrix(&Vector3::new(0.0, 0.0, 2.0));
        assert_eq!(k, Matrix3::from_diagonal(&Vector3::new(-0.125, -0.125, 0.25)));
    }

    #[test]
    fn solving_clean_signals_gives_the_pose_back() {
        let mut random = Random::new(2, Purpose::Signals(0));
        for _ in 0..200 {
            let (u, q) = pose(&mut random);
            let p = u * (0.2 + 2.0 * random.uniform());
            let s = signal_matrix(&field_matrix(&p), &q);
            let solution = solve(&s, &p).unwrap();
            assert!((solution.position_m - p).norm() < 1e-9, "{p} {solution:?}");
            assert!(solution.orientation.angle_to(&q) < 1e-7);
            let mirrored = solve(&s, &-p).unwrap();
            assert!((mirrored.position_m + p).norm() < 1e-9);
            assert!(mirrored.orientation.angle_to(&q) < 1e-7, "the orientation knows no hemisphere");
        }
    }

    #[test]
    fn signals_without_a_pose_are_refused() {
        assert_eq!(solve(&Matrix3::zeros(), &Vector3::x()), None);
        assert_eq!(solve(&Matrix3::from_element(f64::NAN), &Vector3::x()), None);
    }

    /// Standard deviations along the ray, across it (per axis), and of the rotation (per axis).
    fn spread(r_m: f64, sigma_signal: f64) -> (f64, f64, f64) {
        let mut random = Random::new(3, Purpose::Signals(0));
        let (mut radial, mut across, mut rotation) = (0.0, 0.0, 0.0);
        let n = 4000;
        for _ in 0..n {
            let (u, q) = pose(&mut random);
            let mut s = signal_matrix(&field_matrix(&(r_m * u)), &q);
            s.apply(|x| *x += sigma_signal * random.normal());
            let solution = solve(&s, &u).unwrap();
            let error = solution.position_m - r_m * u;
            let along = error.dot(&u);
            radial += along * along;
            across += (error.norm_squared() - along * along) / 2.0;
            rotation += (q.inverse() * solution.orientation).scaled_axis().norm_squared() / 3.0;
        }
        let rms = |sum: f64| (sum / f64::from(n)).sqrt();
        (rms(radial), rms(across), rms(rotation))
    }

    #[test]
    fn noise_grows_with_the_fourth_and_third_power_of_the_range() {
        let sigma = 1e-5;
        for r in [0.5, 1.0, 2.0] {
            let (radial, across, _) = spread(r, sigma);
            let (expected_radial, expected_across) =
                (r.powi(4) * sigma / 54f64.sqrt(), 5f64.sqrt() / 3.0 * r.powi(4) * sigma);
            assert!((radial / expected_radial - 1.0).abs() < 0.05, "{r}: {radial} {expected_radial}");
            assert!((across / expected_across - 1.0).abs() < 0.05, "{r}: {across} {expected_across}");
            assert!((across / radial / 5.477 - 1.0).abs() < 0.06, "a disc 5.5 times wider than deep");
        }
        let slope = libm::log2(spread(2.0, sigma).2 / spread(1.0, sigma).2);
        assert!((slope - 3.0).abs() < 0.05, "rotation noise grows with r^{slope}");
    }
}
