//! Turns between the wire's three ways of writing an orientation.
//!
//! All of them describe R, sensor to transmitter axes: `R = Rz(azimuth) Ry(elevation) Rx(roll)`,
//! quaternions are Hamilton, scalar first.

/// Unit quaternion (w, x, y, z) of azimuth, elevation, roll in radians: rotations about z, then y, then x of the turned axes.
pub fn from_angles([azimuth, elevation, roll]: [f64; 3]) -> [f64; 4] {
    let (sa, ca) = libm::sincos(azimuth / 2.0);
    let (se, ce) = libm::sincos(elevation / 2.0);
    let (sr, cr) = libm::sincos(roll / 2.0);
    [
        ca * ce * cr + sa * se * sr,
        ca * ce * sr - sa * se * cr,
        ca * se * cr + sa * ce * sr,
        sa * ce * cr - ca * se * sr,
    ]
}

/// Azimuth, elevation, roll of a unit quaternion, in radians: azimuth and roll within ±pi, elevation within ±pi/2, and roll 0 at
/// its ends.
pub fn to_angles(q_wxyz: [f64; 4]) -> [f64; 3] {
    let m = to_matrix(q_wxyz);
    let elevation = libm::asin((-m[6]).clamp(-1.0, 1.0));
    if m[6].abs() > 1.0 - 1e-12 {
        // Straight up or down only the sum of azimuth and roll shows; all of it goes to azimuth.
        return [libm::atan2(-m[1], m[4]), elevation, 0.0];
    }
    [libm::atan2(m[3], m[0]), elevation, libm::atan2(m[7], m[8])]
}

/// Rotation matrix of a unit quaternion (w, x, y, z), row by row: sensor to transmitter, if the quaternion is.
pub fn to_matrix([w, x, y, z]: [f64; 4]) -> [f64; 9] {
    [
        1.0 - 2.0 * (y * y + z * z),
        2.0 * (x * y - w * z),
        2.0 * (x * z + w * y),
        2.0 * (x * y + w * z),
        1.0 - 2.0 * (x * x + z * z),
        2.0 * (y * z - w * x),
        2.0 * (x * z - w * y),
        2.0 * (y * z + w * x),
        1.0 - 2.0 * (x * x + y * y),
    ]
}

/// Unit quaternion of a nearly orthonormal matrix, row by row (Shepperd 1978: divide by the largest component). Its sign is that
/// which makes the largest component positive. Whether the matrix is a rotation is for [`orthonormality_error`].
pub fn from_matrix(m: [f64; 9]) -> [f64; 4] {
    let trace = m[0] + m[4] + m[8];
    let squares = [1.0 + trace, 1.0 + 2.0 * m[0] - trace, 1.0 + 2.0 * m[4] - trace, 1.0 + 2.0 * m[8] - trace];
    let largest = (1..4).fold(0, |best, i| if squares[i] > squares[best] { i } else { best });
    let q = match largest {
        0 => [squares[0], m[7] - m[5], m[2] - m[6], m[3] - m[1]],
        1 => [m[7] - m[5], squares[1], m[1] + m[3], m[2] + m[6]],
        2 => [m[2] - m[6], m[1] + m[3], squares[2], m[5] + m[7]],
        _ => [m[3] - m[1], m[2] + m[6], m[5] + m[7], squares[3]],
    };
    normalised(q)
}

/// `q / |q|`; the identity for a quaternion of no length, or with NaN in it.
pub fn normalised(q: [f64; 4]) -> [f64; 4] {
    let norm = norm(q);
    if norm > 0.0 { q.map(|c| c / norm) } else { [1.0, 0.0, 0.0, 0.0] }
}

/// Euclidean norm |q|; 1 for a rotation.
pub fn norm(q: [f64; 4]) -> f64 {
    (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]).sqrt()
}

/// Largest deviation of an element of `m * transpose(m)` from the identity, `m` row by row; infinity for a mirrored or singular
/// matrix, and for NaN. 0 for a rotation.
pub fn orthonormality_error(m: [f64; 9]) -> f64 {
    let row = |i: usize| [m[3 * i], m[3 * i + 1], m[3 * i + 2]];
    let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let mut worst: f64 = 0.0;
    for i in 0..3 {
        for j in 0..=i {
            let ideal = if i == j { 1.0 } else { 0.0 };
            worst = worst.max((dot(row(i), row(j)) - ideal).abs());
        }
    }
    let [a, b, c] = [row(0), row(1), row(2)];
    let cross = [b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]];
    if dot(a, cross) > 0.0 { worst } else { f64::INFINITY }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Angle of the rotation between two unit quaternions, rad.
    fn distance(a: [f64; 4], b: [f64; 4]) -> f64 {
        let dot = a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3];
        2.0 * libm::acos(dot.abs().min(1.0))
    }

    #[test]
    fn quarter_turns_have_their_closed_forms() {
        let h = std::f64::consts::FRAC_1_SQRT_2;
        let quarter = std::f64::consts::FRAC_PI_2;
        for (angles, q) in [
            ([quarter, 0.0, 0.0], [h, 0.0, 0.0, h]),
            ([0.0, quarter, 0.0], [h, 0.0, h, 0.0]),
            ([0.0, 0.0, quarter], [h, h, 0.0, 0.0]),
        ] {
            assert!(distance(from_angles(angles), q) < 1e-7, "{angles:?}");
        }
        // 90 degrees about z takes the sensor's x axis to the transmitter's y axis: first column of R.
        let m = to_matrix([h, 0.0, 0.0, h]);
        assert!((m[0].abs() + (m[3] - 1.0).abs() + m[6].abs()) < 1e-12);
    }

    #[test]
    fn every_way_back_is_the_same_rotation() {
        for i in 0..1000 {
            let t = f64::from(i);
            let q = normalised([
                libm::sin(t * 0.7),
                libm::cos(t * 1.3),
                libm::sin(t * 2.1),
                libm::cos(t * 0.3) - 0.5,
            ]);
            assert!(distance(from_matrix(to_matrix(q)), q) < 1e-6, "{q:?}");
            assert!(distance(from_angles(to_angles(q)), q) < 1e-6, "{q:?}");
        }
        for elevation in [1.0, -1.0] {
            let q = from_angles([0.4, elevation * std::f64::consts::FRAC_PI_2, -0.9]);
            assert!(distance(from_angles(to_angles(q)), q) < 1e-6);
        }
    }

    #[test]
    fn a_mirrored_matrix_is_no_rotation() {
        let mirror = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0];
        assert_eq!(orthonormality_error(mirror), f64::INFINITY);
        assert!(orthonormality_error(to_matrix([1.0, 0.0, 0.0, 0.0])) < 1e-15);
    }
}
