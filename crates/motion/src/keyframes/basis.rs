//! The shapes that are fitted to a window of frames, and what correlated noise does to the fit.

use nalgebra::DMatrix;
use posed_state::Plain;

use super::law;

/// Autocorrelations of noise (first order) at which the law is tabulated.
const CORRELATIONS: [f64; 15] =
    [-0.5, -0.25, 0.0, 0.15, 0.3, 0.45, 0.6, 0.7, 0.78, 0.84, 0.88, 0.92, 0.95, 0.97, 0.985];

/// How many shapes are fitted together.
pub(super) const MODEL: usize = 5;

/// Orthonormal shapes over frames -N..=N.
#[derive(Clone, Debug, Plain)]
pub(super) struct Basis {
    /// 1, k, k^2.
    pub(super) smooth: [Vec<f64>; 3],
    /// max(k, 0): the velocity changes in the middle at once.
    pub(super) hinge: Vec<f64>,
    /// The same change spread over the third of the window around the middle.
    pub(super) eased: Vec<f64>,
    /// What `eased` has beside parabola and hinge: in the model so that an eased change leaves no residuals.
    pub(super) easing: Vec<f64>,
    /// k^4: what a smooth motion would have instead of a hinge.
    pub(super) quartic: Vec<f64>,
}

impl Basis {
    pub(super) fn new(half: usize) -> Self {
        let n = half as f64;
        let shape = |value: &dyn Fn(f64) -> f64| -> Vec<f64> {
            (0..2 * half + 1).map(|k| value((k as f64 - n) / n)).collect()
        };
        let mut smooth = [shape(&|_| 1.0), shape(&|k| k), shape(&|k| k * k)];
        for k in 0..3 {
            let (done, rest) = smooth.split_at_mut(k);
            orthonormalise(&mut rest[0], done);
        }
        let beside = |mut shape: Vec<f64>| {
            orthonormalise(&mut shape, &smooth);
            shape
        };
        let width = 1.0 / 3.0;
        let hinge = beside(shape(&|k| k.max(0.0)));
        let eased = beside(shape(&|k| match k {
            k if k.abs() >= width => k.max(0.0),
            k => (k + width) * (k + width) / (4.0 * width),
        }));
        let quartic = beside(shape(&|k| k.powi(4)));
        let mut easing = eased.clone();
        orthonormalise(&mut easing, std::slice::from_ref(&hinge));
        Self { smooth, hinge, eased, easing, quartic }
    }

    /// The shapes that are fitted together.
    fn model(&self) -> [&[f64]; MODEL] {
        [&self.smooth[0], &self.smooth[1], &self.smooth[2], &self.hinge, &self.easing]
    }
}

/// Makes `shape` orthogonal to the orthonormal `others`, and of length one.
fn orthonormalise(shape: &mut [f64], others: &[Vec<f64>]) {
    // Twice is enough (Kahan).
    for _ in 0..2 {
        for other in others {
            let share = dot(shape, other);
            shape.iter_mut().zip(other).for_each(|(value, other)| *value -= share * other);
        }
    }
    let norm = dot(shape, shape).sqrt();
    if norm > 1e-9 {
        shape.iter_mut().for_each(|value| *value /= norm);
    }
}

pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    // Four sums side by side: the compiler may not reorder one.
    let mut sums = [0.0; 4];
    let (a4, a_rest) = a.as_chunks::<4>();
    let (b4, b_rest) = b.as_chunks::<4>();
    for (a, b) in a4.iter().zip(b4) {
        for c in 0..4 {
            sums[c] += a[c] * b[c];
        }
    }
    let rest: f64 = a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum();
    (sums[0] + sums[1]) + (sums[2] + sums[3]) + rest
}

/// What correlated noise does: the correlation that is seen in the residuals of a fit, and how much larger the
/// statistic is than for white noise at the same rate of false alarms.
#[derive(Clone, Debug, Plain)]
pub(super) struct Correlation {
    table: Vec<(f64, f64)>,
}

impl Correlation {
    /// The threshold for white noise, and the factors for correlated noise.
    pub(super) fn new(basis: &Basis, channels: usize, rate: f64) -> (f64, Self) {
        let effects = CORRELATIONS.map(|correlation| Effect::of(correlation, basis));
        let threshold = |effect: &Effect| law::threshold(channels, effect.dof, effect.decorrelation, rate);
        let white = threshold(&effects[2]);
        let row = |effect: &Effect| {
            let factor = effect.inflation / effects[2].inflation * threshold(effect) / white;
            (effect.seen, factor.max(1.0))
        };
        (white, Self { table: effects.iter().map(row).collect() })
    }

    /// By what to divide the statistic of a channel whose residuals have this correlation.
    pub(super) fn factor(&self, seen: f64) -> f64 {
        let above = self.table.iter().position(|(limit, _)| *limit > seen);
        match above {
            None => self.table.last().map_or(1.0, |last| last.1),
            Some(0) => 1.0,
            Some(k) => {
                let ((x0, y0), (x1, y1)) = (self.table[k - 1], self.table[k]);
                y0 + (y1 - y0) * (seen - x0) / (x1 - x0)
            }
        }
    }
}

/// What noise of a given first-order autocorrelation does to the fit.
struct Effect {
    /// First autocorrelation of the residuals.
    seen: f64,
    /// Variance of the hinge's coefficient over the variance estimated from the residuals.
    inflation: f64,
    /// Degrees of freedom of the latter (Satterthwaite).
    dof: f64,
    /// One minus the correlation of the hinge's coefficient with that of the next frame.
    decorrelation: f64,
}

impl Effect {
    fn of(correlation: f64, basis: &Basis) -> Self {
        let model = basis.model();
        let n = basis.hinge.len();
        let noise = |i: usize, j: usize| correlation.powi(i.abs_diff(j) as i32);
        // C = (I - P) R (I - P) with P the projection on the model.
        let u = DMatrix::from_fn(n, MODEL, |i, j| model[j][i]);
        let r = DMatrix::from_fn(n, n, noise);
        let ru = &r * &u;
        let s = u.transpose() * &ru;
        let left = &u * ru.transpose();
        let c = r - &left - left.transpose() + &u * s * u.transpose();
        let trace = c.trace();
        let beside: f64 = (0..n - 1).map(|k| c[(k, k + 1)]).sum();
        // The mean of a ratio is not the ratio of the means; for quadratic forms of normal numbers it differs by
        // this, to second order.
        let squared = &c * &c;
        let squared_beside: f64 = (0..n - 1).map(|k| squared[(k, k + 1)]).sum();
        let bias = 2.0 * (beside * squared.trace() / trace - squared_beside) / (trace * trace);
        let covariance = |shift: i32| -> f64 {
            let mut sum = 0.0;
            for i in 0..n {
                for j in 0..n {
                    let lag = i as i32 - j as i32 + shift;
                    sum += basis.hinge[i] * basis.hinge[j] * correlation.powi(lag.abs());
                }
            }
            sum
        };
        let variance = covariance(0);
        Self {
            seen: beside / trace + bias,
            inflation: variance / (trace / (n - MODEL) as f64),
            dof: trace * trace / squared.trace(),
            decorrelation: 1.0 - covariance(1) / variance,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shapes_are_orthonormal_and_the_hinge_is_the_even_part_of_itself() {
        let basis = Basis::new(20);
        let shapes = basis.model();
        for (i, a) in shapes.iter().enumerate() {
            for (j, b) in shapes.iter().enumerate() {
                let expected = if i == j { 1.0 } else { 0.0 };
                assert!((dot(a, b) - expected).abs() < 1e-12);
            }
        }
        for k in 0..20 {
            assert!((basis.hinge[k] - basis.hinge[40 - k]).abs() < 1e-12);
        }
    }

    #[test]
    fn white_noise_needs_no_correction_and_correlated_noise_a_growing_one() {
        let white = Effect::of(0.0, &Basis::new(30));
        assert!((white.inflation - 1.0).abs() < 1e-9);
        assert!((white.dof - 56.0).abs() < 1e-6);
        let (threshold, correlation) = Correlation::new(&Basis::new(30), 6, 1e-4);
        assert!((24.0..40.0).contains(&threshold), "{threshold}");
        assert_eq!(correlation.factor(-0.9), 1.0);
        let factors: Vec<f64> = (0..8).map(|k| correlation.factor(0.1 * f64::from(k))).collect();
        assert!(factors.windows(2).all(|pair| pair[0] < pair[1]), "{factors:?}");
    }
}
