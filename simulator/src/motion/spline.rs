//! A pose over time from samples: cubic splines with rest at both ends.

use nalgebra::{Isometry3, Quaternion, UnitQuaternion, Vector3};

/// Position (m) and quaternion (w, x, y, z) of one sample.
pub(super) type Row = [f64; 7];

/// A twice continuously differentiable pose through samples at rising times.
///
/// Each of the seven numbers is a cubic spline with zero slope at both ends; the quaternion is
/// normalised after interpolation, which is smooth because neighbouring samples were brought to the
/// same half of the sphere.
#[derive(Clone, Debug)]
pub(super) struct PoseSpline {
    t_s: Vec<f64>,
    values: Vec<Row>,
    /// Second derivatives at the knots.
    bends: Vec<Row>,
}

impl PoseSpline {
    /// Through `rows`; times rise strictly and there is at least one.
    pub(super) fn new(t_s: Vec<f64>, mut values: Vec<Row>) -> Self {
        for i in 1..values.len() {
            let dot: f64 = (3..7).map(|c| values[i - 1][c] * values[i][c]).sum();
            if dot < 0.0 {
                values[i][3..].iter_mut().for_each(|q| *q = -*q);
            }
        }
        let bends = second_derivatives(&t_s, &values);
        Self { t_s, values, bends }
    }

    /// First and last time, s.
    pub(super) fn span_s(&self) -> (f64, f64) {
        (self.t_s[0], self.t_s[self.t_s.len() - 1])
    }

    /// The pose at `t_s`, held before the first and after the last sample.
    pub(super) fn pose(&self, t_s: f64) -> Isometry3<f64> {
        let row = self.row(t_s);
        let q = Quaternion::new(row[3], row[4], row[5], row[6]);
        Isometry3::from_parts(
            Vector3::new(row[0], row[1], row[2]).into(),
            UnitQuaternion::try_new(q, 1e-9).unwrap_or_default(),
        )
    }

    fn row(&self, t_s: f64) -> Row {
        let (first, last) = self.span_s();
        let t = t_s.clamp(first, last);
        let high = self.t_s.partition_point(|&knot| knot <= t).clamp(1, self.t_s.len().max(2) - 1);
        if self.t_s.len() == 1 {
            return self.values[0];
        }
        let low = high - 1;
        let h = self.t_s[high] - self.t_s[low];
        let b = (t - self.t_s[low]) / h;
        let a = 1.0 - b;
        let (bend_a, bend_b) = ((a * a * a - a) * h * h / 6.0, (b * b * b - b) * h * h / 6.0);
        std::array::from_fn(|c| {
            a * self.values[low][c]
                + b * self.values[high][c]
                + bend_a * self.bends[low][c]
                + bend_b * self.bends[high][c]
        })
    }
}

/// Solves the tridiagonal system of a spline with zero end slopes (Thomas's algorithm).
fn second_derivatives(t: &[f64], y: &[Row]) -> Vec<Row> {
    let n = t.len();
    let mut bends = vec![[0.0; 7]; n];
    if n < 2 {
        return bends;
    }
    let slope = |i: usize| -> Row { std::array::from_fn(|c| (y[i + 1][c] - y[i][c]) / (t[i + 1] - t[i])) };
    let mut upper = vec![0.0; n];
    let (mut left, mut slope_left, mut before, mut upper_before) = (0.0, [0.0; 7], [0.0; 7], 0.0);
    for i in 0..n {
        let (right, slope_right) = if i + 1 < n { (t[i + 1] - t[i], slope(i)) } else { (0.0, [0.0; 7]) };
        let diagonal = 2.0 * (left + right) - left * upper_before;
        upper[i] = right / diagonal;
        bends[i] =
            std::array::from_fn(|c| (6.0 * (slope_right[c] - slope_left[c]) - left * before[c]) / diagonal);
        (left, slope_left, before, upper_before) = (right, slope_right, bends[i], upper[i]);
    }
    for i in (0..n - 1).rev() {
        let after = bends[i + 1];
        for (bend, after) in bends[i].iter_mut().zip(after) {
            *bend -= upper[i] * after;
        }
    }
    bends
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sampled(dt: f64) -> PoseSpline {
        let t: Vec<f64> = (0..=(4.0 / dt) as usize).map(|i| i as f64 * dt).collect();
        let rows = t.iter().map(|&t| {
            let half = 0.5 * (1.0 - libm::cos(0.5 * std::f64::consts::PI * t));
            // The other half of the sphere at every second sample: the same rotations.
            let sign = if (t / dt).round() as i64 % 2 == 0 { 1.0 } else { -1.0 };
            [half, 2.0, 3.0, sign * libm::cos(half), 0.0, sign * libm::sin(half), 0.0]
        });
        let rows = rows.collect();
        PoseSpline::new(t, rows)
    }

    #[test]
    fn it_meets_the_samples_and_stays_near_the_curve_between_them() {
        let spline = sampled(0.05);
        for i in 0..400 {
            let t = f64::from(i) * 0.01 + 0.003;
            let half = 0.5 * (1.0 - libm::cos(0.5 * std::f64::consts::PI * t.min(4.0)));
            let pose = spline.pose(t);
            assert!((pose.translation.x - half).abs() < 1e-6, "{t}");
            let q = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), 2.0 * half);
            assert!(pose.rotation.angle_to(&q) < 1e-6, "{t}: {}", pose.rotation.angle_to(&q));
        }
    }

    #[test]
    fn one_sample_is_a_place_to_stay() {
        let spline = PoseSpline::new(vec![1.0], vec![[1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0]]);
        assert_eq!(spline.pose(-5.0), spline.pose(5.0));
        assert_eq!(spline.pose(0.0).translation.vector, Vector3::new(1.0, 2.0, 3.0));
    }
}
