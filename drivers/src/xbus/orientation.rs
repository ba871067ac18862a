//! Orientations of the device in any of its forms, as a unit quaternion from sensor to a z-up frame.

use crate::flock::wire::rotation;

/// Axes of the frame in which a device gives orientation, free acceleration and velocity; right-handed, all three.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Axes {
    /// x east, y north, z up.
    Enu,
    /// x north, y east, z down.
    Ned,
    /// x north, y west, z up.
    Nwu,
}

/// How far from 1 the norm of a quaternion, or from 0 the error of a matrix, may be.
const TOLERANCE: f64 = 0.02;

/// Brings a quaternion from sensor to `axes` into a unit quaternion from sensor to east-north-up.
///
/// `None` when it is no rotation.
pub(super) fn from_quaternion(q: [f64; 4], axes: Axes) -> Option<[f64; 4]> {
    let norm = q.iter().map(|value| value * value).sum::<f64>().sqrt();
    // NaN is out of the range, too.
    if !(1.0 - TOLERANCE..=1.0 + TOLERANCE).contains(&norm) {
        return None;
    }
    let q = q.map(|value| value / norm);
    const H: f64 = std::f64::consts::FRAC_1_SQRT_2;
    Some(match axes {
        Axes::Enu => q,
        // x and y change places, z turns over: half a turn about (1, 1, 0).
        Axes::Ned => multiply([0.0, H, H, 0.0], q),
        // North becomes y, west becomes -x: a quarter turn about z.
        Axes::Nwu => multiply([H, 0.0, 0.0, H], q),
    })
}

/// Brings the rows of a rotation matrix from sensor to `axes` into a unit quaternion, as above.
pub(super) fn from_matrix(m: [[f64; 3]; 3], axes: Axes) -> Option<[f64; 4]> {
    let m = std::array::from_fn(|i| m[i / 3][i % 3]);
    let is_rotation = rotation::orthonormality_error(m) <= TOLERANCE;
    is_rotation.then(|| from_quaternion(rotation::from_matrix(m), axes)).flatten()
}

/// Brings roll, pitch, yaw in degrees (rotations about z, then y, then x) into a unit quaternion, as above.
pub(super) fn from_euler_deg(angles: [f64; 3], axes: Axes) -> Option<[f64; 4]> {
    if !angles.iter().all(|angle| angle.abs() <= 360.0) {
        return None;
    }
    let [(sr, cr), (sp, cp), (sy, cy)] = angles.map(|angle| libm::sincos(angle.to_radians() / 2.0));
    from_quaternion(multiply(multiply([cy, 0.0, 0.0, sy], [cp, 0.0, sp, 0.0]), [cr, sr, 0.0, 0.0]), axes)
}

fn multiply(a: [f64; 4], b: [f64; 4]) -> [f64; 4] {
    [
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rotate(q: [f64; 4], v: [f64; 3]) -> [f64; 3] {
        let p = multiply(multiply(q, [0.0, v[0], v[1], v[2]]), [q[0], -q[1], -q[2], -q[3]]);
        [p[1], p[2], p[3]]
    }

    fn close<const N: usize>(a: [f64; N], b: [f64; N]) -> bool {
        a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-9)
    }

    #[test]
    fn axes_are_turned_to_east_north_up() {
        let identity = [1.0, 0.0, 0.0, 0.0];
        let ned = from_quaternion(identity, Axes::Ned).unwrap();
        assert!(close(rotate(ned, [1.0, 0.0, 0.0]), [0.0, 1.0, 0.0]), "north is y");
        assert!(close(rotate(ned, [0.0, 0.0, 1.0]), [0.0, 0.0, -1.0]), "down is -z");
        let nwu = from_quaternion(identity, Axes::Nwu).unwrap();
        assert!(close(rotate(nwu, [1.0, 0.0, 0.0]), [0.0, 1.0, 0.0]), "north is y");
        assert!(close(rotate(nwu, [0.0, 1.0, 0.0]), [-1.0, 0.0, 0.0]), "west is -x");
    }

    #[test]
    fn a_matrix_gives_the_quaternion_that_made_it() {
        for q in [[0.5, -0.5, 0.5, 0.5], [0.0, 0.6, -0.8, 0.0], [0.1, 0.1, 0.7, -0.7], [0.9, 0.3, 0.3, 0.1]] {
            let q =
                from_quaternion(q.map(|v: f64| v / q.iter().map(|v| v * v).sum::<f64>().sqrt()), Axes::Enu)
                    .unwrap();
            let columns = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|axis| rotate(q, axis));
            let rows = std::array::from_fn(|i| std::array::from_fn(|j| columns[j][i]));
            let back = from_matrix(rows, Axes::Enu).unwrap();
            assert!(close(back, q) || close(back.map(|v| -v), q), "{q:?} {back:?}");
        }
    }

    #[test]
    fn what_is_no_rotation_is_refused() {
        assert_eq!(from_quaternion([f64::NAN, 0.0, 0.0, 0.0], Axes::Enu), None);
        assert_eq!(from_quaternion([0.5, 0.0, 0.0, 0.0], Axes::Enu), None);
        assert_eq!(
            from_matrix([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]], Axes::Enu),
            None,
            "mirror"
        );
        assert_eq!(from_matrix([[0.0; 3]; 3], Axes::Enu), None);
        assert_eq!(from_euler_deg([f64::INFINITY, 0.0, 0.0], Axes::Enu), None);
    }

    #[test]
    fn yaw_turns_last() {
        let q = from_euler_deg([90.0, 0.0, 90.0], Axes::Enu).unwrap();
        assert!(close(rotate(q, [0.0, 1.0, 0.0]), [0.0, 0.0, 1.0]));
        assert!(close(rotate(q, [1.0, 0.0, 0.0]), [0.0, 1.0, 0.0]));
    }
}
