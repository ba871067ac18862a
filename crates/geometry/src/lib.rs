//! Rotations and rigid motions: the Lie group kit that filters, faults and motion analysis share.
//!
//! What comes in: vectors, unit quaternions, poses. What goes out: the same. Conventions: radians and
//! metres; Hamilton quaternions; errors are local (right-multiplied): `R = R_hat * exp(error)`.
//!
//! Time stamps, gravity, the stuck test and a few small things that all crates share stand here, too.
//!
//! ```
//! use posed_geometry::{GRAVITY_M_S2, isometry, se3, wrapped_rad};
//!
//! let pose = isometry([1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]).expect("finite numbers");
//! // Half a turn about z, and back by the logarithm: rad, then m.
//! let twist = se3::log(&pose);
//! assert!((se3::exp(&twist).translation.vector - pose.translation.vector).norm() < 1e-12);
//! assert!((wrapped_rad(1.5 * std::f64::consts::TAU) - std::f64::consts::PI).abs() < 1e-12);
//! assert_eq!(GRAVITY_M_S2, 9.80665);
//! ```

pub mod bytes;
pub mod parallel;
pub mod repetition;
pub mod se3;
pub mod so3;
pub mod soonest;
mod time;

pub use time::Timestamp;

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};

/// Standard acceleration of gravity, m/s² (3rd CGPM, 1901): the one that filters, calibrations, drivers and the simulator use.
pub const GRAVITY_M_S2: f64 = 9.806_65;

/// The same angle in (-pi, pi], rad; NaN where `angle_rad` is not finite.
#[inline]
pub fn wrapped_rad(angle_rad: f64) -> f64 {
    use std::f64::consts::{PI, TAU};
    let wrapped = angle_rad.rem_euclid(TAU);
    if wrapped > PI { wrapped - TAU } else { wrapped }
}

/// Unit quaternion from (w, x, y, z), Hamilton, of any length: it is normalised.
///
/// `None` where a number is not finite or the length is at most 1e-6.
#[inline]
pub fn orientation_from_wxyz(wxyz: [f64; 4]) -> Option<UnitQuaternion<f64>> {
    let [w, x, y, z] = wxyz;
    // nalgebra's constructor takes w first although it stores it last.
    let quaternion = Quaternion::new(w, x, y, z);
    let norm = quaternion.norm();
    (norm.is_finite() && norm > 1e-6).then(|| UnitQuaternion::from_quaternion(quaternion))
}

/// (w, x, y, z), unit length, with w >= 0, so that equal rotations have equal numbers (but for angles of pi, where w is 0).
#[inline]
pub fn orientation_to_wxyz(orientation: &UnitQuaternion<f64>) -> [f64; 4] {
    let sign = if orientation.w < 0.0 { -1.0 } else { 1.0 };
    [sign * orientation.w, sign * orientation.i, sign * orientation.j, sign * orientation.k]
}

/// Farthest that anything is from the origin along an axis, m: beyond, differences of positions lose what is measured, and squares
/// become infinite in the end.
pub const FARTHEST_M: f64 = 1e6;

/// Rigid motion from a position, m, and a quaternion (w, x, y, z) of any length: coordinates in the moved frame to those in
/// the frame that both are given in.
///
/// `None` where a number is not finite or beyond [`FARTHEST_M`], or the quaternion is no orientation ([`orientation_from_wxyz`]).
#[inline]
pub fn isometry(position_m: [f64; 3], orientation_wxyz: [f64; 4]) -> Option<Isometry3<f64>> {
    let position = Vector3::from(position_m);
    position.iter().all(|value| value.abs() <= FARTHEST_M).then_some(())?;
    Some(Isometry3::from_parts(Translation3::from(position), orientation_from_wxyz(orientation_wxyz)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quarter_turn_about_z_keeps_the_order_of_the_components() {
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let rotation = orientation_from_wxyz([half, 0.0, 0.0, half]).unwrap();
        assert!((rotation * Vector3::x() - Vector3::y()).norm() < 1e-15);
        assert!((orientation_to_wxyz(&rotation)[3] - half).abs() < 1e-15);
    }

    #[test]
    fn both_signs_of_a_quaternion_give_the_same_numbers() {
        let q = orientation_from_wxyz([-0.5, 0.5, -0.5, 0.5]).unwrap();
        assert_eq!(orientation_to_wxyz(&q), [0.5, -0.5, 0.5, -0.5]);
    }

    #[test]
    fn zero_and_not_a_number_are_no_orientation() {
        assert!(orientation_from_wxyz([0.0; 4]).is_none());
        assert!(orientation_from_wxyz([f64::NAN, 0.0, 0.0, 1.0]).is_none());
        for far in [f64::INFINITY, f64::NAN, 1e300, -1.1e6] {
            assert!(isometry([far, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]).is_none(), "{far}");
        }
    }
}
