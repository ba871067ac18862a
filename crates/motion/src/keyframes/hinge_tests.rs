//! The hinge statistic against a plain least-squares fit.

use nalgebra::{DMatrix, DVector, Vector3};

use super::*;

/// Positions without rule, from a fixed seed.
fn wander(frames: usize) -> Vec<Isometry3<f64>> {
    let mut state = 9u64;
    let mut random = || {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (state >> 40) as f64 / (1u64 << 24) as f64 - 0.5
    };
    (0..frames).map(|_| Isometry3::translation(random(), random(), 5.0 + random())).collect()
}

/// Squared coefficient of the hinge over its variance, by the normal equations; `easing` is in the model too.
fn by_least_squares(channel: &[f64], easing: &[f64]) -> f64 {
    let n = channel.len();
    let k = |i: usize| i as f64 - (n / 2) as f64;
    let a = DMatrix::from_fn(n, 5, |i, j| [1.0, k(i), k(i) * k(i), k(i).max(0.0), easing[i]][j]);
    let x = DVector::from_column_slice(channel);
    let inverse = (a.transpose() * &a).try_inverse().unwrap();
    let c = &inverse * a.transpose() * &x;
    let variance = (&x - &a * &c).norm_squared() / (n - 5) as f64;
    c[3] * c[3] / (inverse[(3, 3)] * variance)
}

#[test]
fn the_fit_is_the_f_statistic_of_the_hinge() {
    let basis = Basis::new(10);
    for (k, poses) in wander(60).windows(21).enumerate() {
        let channel: Vec<f64> = poses.iter().map(|pose| pose.translation.vector[k % 3]).collect();
        let fit = Fit::of(&mut channel.clone(), &basis);
        let expected = by_least_squares(&channel, &basis.easing);
        assert!((fit.hinge * fit.hinge / fit.variance / expected - 1.0).abs() < 1e-8);
    }
}

#[test]
fn a_clean_hinge_is_a_corner_and_an_eased_one_is_not() {
    let settings = HingeSettings { window: 20, orientation: false, ..HingeSettings::default() };
    let noise = wander(200);
    let score = |speed: &dyn Fn(usize) -> f64| {
        let mut hinge = Hinge::new(settings);
        let mut x = 0.0;
        let mut best: Option<Score> = None;
        for (k, noise) in noise.iter().enumerate() {
            x += speed(k);
            let v = Vector3::new(x, 0.0, 0.0) + noise.translation.vector * 1e-3;
            if let Some(score) = hinge.push(&Isometry3::translation(v.x, v.y, v.z))
                && best.is_none_or(|best| score.value > best.value)
            {
                best = Some(score);
            }
        }
        best.unwrap()
    };
    let sharp = score(&|k| if k < 100 { 0.0 } else { 0.01 });
    let eased = score(&|k| 0.01 * ((k as f64 - 93.0) / 14.0).clamp(0.0, 1.0));
    assert!(sharp.accepted && sharp.corner, "{sharp:?}");
    assert!(eased.accepted && !eased.corner, "{eased:?}");
}
