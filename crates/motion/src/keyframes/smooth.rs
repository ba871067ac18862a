//! Means that statistics and path share: a parabola's value in the middle of a window, and the mean of rotations.

use nalgebra::{Quaternion, UnitQuaternion};

/// Weights of the value at the centre of a least-squares parabola over `2 half + 1` values (Savitzky and Golay, 1964).
pub(super) fn parabola_weights(half: usize) -> Vec<f64> {
    if half == 0 {
        return vec![1.0];
    }
    let m = half as f64;
    let norm = (2.0 * m + 3.0) * (2.0 * m + 1.0) * (2.0 * m - 1.0);
    let weight = |k: usize| {
        let k = k as f64 - m;
        3.0 * (3.0 * m * m + 3.0 * m - 1.0 - 5.0 * k * k) / norm
    };
    (0..2 * half + 1).map(weight).collect()
}

/// Normalised sum of quaternions (w, x, y, z) with weights, signs as the middle one's: the chordal mean to first order. All are within a
/// right angle of the middle one, so that the sum is not zero.
pub(super) fn mean_rotation<'a>(
    quaternions: impl Iterator<Item = (&'a [f64], f64)>,
    middle: &[f64],
) -> UnitQuaternion<f64> {
    let mut sum = [0.0; 4];
    for (q, weight) in quaternions {
        let cosine: f64 = q.iter().zip(middle).map(|(a, b)| a * b).sum();
        let turned = if cosine < 0.0 { -weight } else { weight };
        sum.iter_mut().zip(q).for_each(|(sum, q)| *sum += turned * q);
    }
    UnitQuaternion::from_quaternion(Quaternion::new(sum[0], sum[1], sum[2], sum[3]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_savitzky_golay_filter_keeps_a_parabola() {
        let weights = parabola_weights(10);
        let parabola = (-10..=10).map(|k| 3.0 - 0.5 * f64::from(k) + 0.1 * f64::from(k * k));
        let value: f64 = weights.iter().zip(parabola).map(|(weight, value)| weight * value).sum();
        assert!((value - 3.0).abs() < 1e-12);
    }
}
