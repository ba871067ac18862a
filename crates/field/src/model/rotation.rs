//! How metal turns the measured orientation, and how that changes with the field.

use nalgebra::{Matrix3, Rotation3, SMatrix, UnitQuaternion, Vector3};

use super::dipole::field;
use super::metal::{FoundPosition, Metal};

/// Rotation that undoes what metal did to a reading at `z` whose true place is `p`: `R_true = E R_measured`.
///
/// The device takes A' = S K(z)^-1 for the orientation, where S = A_true' B(p); so E is the rotation nearest to
/// B(p) K(z)^-1.
pub(crate) fn by_metal(metal: &Metal, z: &Vector3<f64>, p: &Vector3<f64>) -> UnitQuaternion<f64> {
    let rotation = field(z).try_inverse().and_then(|inverse| nearest_rotation(metal.field(p) * inverse));
    rotation.map_or_else(UnitQuaternion::identity, |rotation| {
        UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation))
    })
}

/// Newton's iteration for the polar factor of a matrix near a rotation.
fn nearest_rotation(mut matrix: Matrix3<f64>) -> Option<Matrix3<f64>> {
    for _ in 0..6 {
        matrix = (matrix + matrix.try_inverse()?.transpose()) * 0.5;
    }
    Some(matrix)
}

/// Derivative of the rotation vector of [`by_metal`] (on the left) by the nine numbers of the field at a fixed reading: the
/// field turns by itself, and because the place that is found for the reading moves.
///
/// With `B K^-1 = S E`, S symmetric, a change A = dB K^-1 E' has the skew part of `(tr S - S) w`.
pub(crate) fn turning(
    metal: &Metal,
    z: &Vector3<f64>,
    position: &FoundPosition,
) -> Option<SMatrix<f64, 3, 9>> {
    let inverse = field(z).try_inverse()?;
    let matrix = metal.field(&position.p) * inverse;
    let back = nearest_rotation(matrix)?.transpose();
    let stretch = matrix * back;
    let soften = (Matrix3::identity() * stretch.trace() - stretch).try_inverse()?;
    let by_position = metal.gradient(&position.p, 1.0);
    let mut derivative = SMatrix::<f64, 3, 9>::zeros();
    for k in 0..9 {
        let mut change = Matrix3::zeros();
        change[k] = 1.0;
        for (l, gradient) in by_position.iter().enumerate() {
            change += gradient * position.by_field[(l, k)];
        }
        let a = change * inverse * back;
        let skew = Vector3::new(a.m32 - a.m23, a.m13 - a.m31, a.m21 - a.m12);
        derivative.set_column(k, &(soften * skew));
    }
    Some(derivative)
}

#[cfg(test)]
mod tests {
    use posed_geometry::so3;

    use super::super::metal::{Kind, Source, times};
    use super::*;

    #[test]
    fn how_metal_turns_a_sensor_follows_from_its_field() {
        let mut sources = vec![
            Source { kind: Kind::Plane, position_m: [0.1, -0.05, -1.2], strength: 0.1 },
            Source { kind: Kind::Object, position_m: [2.2, 1.3, 0.3], strength: 0.006 },
        ];
        let z = Vector3::new(1.7, 0.9, 0.4);
        let metal = Metal::new(&sources);
        let position = metal.position(&z).unwrap();
        let before = by_metal(&metal, &z, &position.p);
        let step = 1e-6;
        sources[1].strength += step;
        let stronger = Metal::new(&sources);
        let after = by_metal(&stronger, &z, &stronger.position(&z).unwrap().p);
        let difference = so3::log(&(after * before.inverse())) / step;
        let change = (stronger.field(&position.p) - metal.field(&position.p)) / step;
        let expected = times(&turning(&metal, &z, &position).unwrap(), &change);
        assert!(expected.norm() > 1.0 && (difference - expected).norm() < 1e-3 * expected.norm());
    }
}
