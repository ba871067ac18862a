//! Change points by singular spectrum analysis, with which Merckel and Nishida (2010) compare theirs (Fig. 11).
//!
//! V. Moskvina and A. Zhigljavsky, "An algorithm based on singular spectrum analysis for change-point detection", Communications in
//! Statistics: Simulation and Computation 32 (2003).
//!
//! What comes in: a whole series of poses, evenly spaced. What goes out: a score for each frame, [`SingularSpectrum::scores`], and its peaks. Of
//! each of the six components of the signal, position and rotation vector from the first pose, `N` subsequences of `N` frames before a frame make a
//! trajectory matrix, whose first `rank` left singular vectors span what is known. The score is how much more of the `N` subsequences from
//! the frame on lies outside of that than of those before: the logarithm of the ratio of squares, mean over the components. It sees `2 N` frames of
//! the future.
//!
//! Chosen here, where Merckel and Nishida took what the authors' program suggests: `N`, the rank, and a threshold on the score in place of
//! the sum over time, found on other gestures.

use nalgebra::{DMatrix, DVector, Isometry3, SymmetricEigen};

/// Thresholds that are tried: quantiles of the scores.
const QUANTILES: [f64; 9] = [0.5, 0.6, 0.7, 0.8, 0.85, 0.9, 0.95, 0.98, 0.99];
/// Places of a peak against the change that are tried, frames: the score is high as soon as the future is new.
const SHIFTS: [isize; 13] = [-30, -25, -20, -15, -10, -5, 0, 5, 10, 15, 20, 25, 30];

/// What is left of a subsequence at least, as a square per frame: numbers without noise leave nothing.
const LEAST_SQUARE: f64 = 1e-14;

/// The analysis. The default: `N` = 30 frames, rank 3: a parabola.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SingularSpectrum {
    /// `N`: length of the subsequences, and their number, frames; at least 2.
    pub window: usize,
    /// Directions of the past that count as known, below `N`.
    pub rank: usize,
}

impl Default for SingularSpectrum {
    fn default() -> Self {
        Self { window: 30, rank: 3 }
    }
}

/// From which score on a peak is a change, and where the change is beside it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Threshold {
    /// Least score.
    pub score: f64,
    /// Frames from a peak to its change.
    pub shift: isize,
}

impl SingularSpectrum {
    /// The score of each frame; 0 in the first and last `2 N`.
    pub fn scores(&self, poses: &[Isometry3<f64>]) -> Vec<f64> {
        let n = self.window.max(2);
        let channels = channels(poses);
        let mut scores = vec![0.0; poses.len()];
        let last = (poses.len() + 1).saturating_sub(2 * n);
        for (frame, score) in scores.iter_mut().enumerate().take(last).skip(2 * n) {
            let around = |x: &Vec<f64>| self.score(&x[frame + 1 - 2 * n..frame - 1 + 2 * n], n);
            *score = channels.iter().map(around).sum::<f64>() / channels.len() as f64;
        }
        scores
    }

    /// Of `2 N - 1` frames before and as many from one on, `n` = N.
    fn score(&self, x: &[f64], n: usize) -> f64 {
        let (past, future) = x.split_at(2 * n - 1);
        let [past, future] = [past, future].map(|x| DMatrix::from_fn(n, n, |row, column| x[row + column]));
        let known = left_vectors(&past, self.rank.min(n - 1));
        let outside = |matrix: &DMatrix<f64>| {
            let square = matrix.norm_squared() - known.tr_mul(matrix).norm_squared();
            square.max(0.0) / (n * n) as f64 + LEAST_SQUARE
        };
        libm::log(outside(&future) / outside(&past))
    }

    /// Frames of the scores that exceed the threshold and all others within `N`, moved by its shift.
    pub fn peaks(&self, scores: &[f64], threshold: Threshold) -> Vec<usize> {
        let n = self.window;
        let is_peak = |at: usize| {
            let around = &scores[at.saturating_sub(n)..(at + n + 1).min(scores.len())];
            let first =
                around.iter().position(|score| *score == scores[at]).map(|k| at.saturating_sub(n) + k);
            scores[at] > threshold.score
                && around.iter().all(|score| *score <= scores[at])
                && first == Some(at)
        };
        (0..scores.len())
            .filter(|at| is_peak(*at))
            .filter_map(|at| at.checked_add_signed(threshold.shift))
            .collect()
    }

    /// The threshold and shift of the fewest `errors` over series of scores; of equal ones the lowest quantile and shift.
    pub fn threshold(&self, series: &[Vec<f64>], errors: impl Fn(&[usize]) -> usize) -> Threshold {
        let mut all: Vec<f64> = series.iter().flatten().copied().filter(|score| *score > 0.0).collect();
        all.sort_by(f64::total_cmp);
        let quantile = |q: f64| all.get((q * all.len() as f64) as usize).copied().unwrap_or(0.0);
        let choices =
            QUANTILES.iter().flat_map(|q| SHIFTS.map(|shift| Threshold { score: quantile(*q), shift }));
        let total = |choice: &Threshold| {
            series.iter().map(|scores| errors(&self.peaks(scores, *choice))).sum::<usize>()
        };
        choices.min_by_key(total).unwrap_or(Threshold { score: 0.0, shift: 0 })
    }
}

/// Position, m, and rotation vector from the first pose, rad.
fn channels(poses: &[Isometry3<f64>]) -> [Vec<f64>; 6] {
    let first = poses.first().map(|pose| pose.rotation.inverse()).unwrap_or_default();
    std::array::from_fn(|c| {
        let value = |pose: &Isometry3<f64>| match c.checked_sub(3) {
            None => pose.translation.vector[c],
            Some(axis) => (first * pose.rotation).scaled_axis()[axis],
        };
        poses.iter().map(value).collect()
    })
}

/// The first left singular vectors of a square matrix.
fn left_vectors(matrix: &DMatrix<f64>, count: usize) -> DMatrix<f64> {
    let eigen = SymmetricEigen::new(matrix * matrix.transpose());
    let mut order: Vec<usize> = (0..matrix.nrows()).collect();
    order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
    let columns: Vec<DVector<f64>> =
        order[..count].iter().map(|k| eigen.eigenvectors.column(*k).into_owned()).collect();
    DMatrix::from_columns(&columns)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_change_of_velocity_scores_highest_where_it_is() {
        let poses: Vec<_> = (0..300)
            .map(|k| {
                let k = f64::from(k);
                // A bend of the way, and a tremble that is not the same twice.
                let x = 0.01 * (k - 150.0).max(0.0) + 1e-4 * libm::sin(k * k);
                Isometry3::translation(x, 0.01 * k, 0.0)
            })
            .collect();
        let transform = SingularSpectrum { window: 15, ..SingularSpectrum::default() };
        let scores = transform.scores(&poses);
        let threshold = transform.threshold(std::slice::from_ref(&scores), |found| {
            let near = found.iter().filter(|frame| frame.abs_diff(150) < 10).count();
            found.len() - near + usize::from(near != 1)
        });
        let found = transform.peaks(&scores, threshold);
        assert!(found.len() == 1 && found[0].abs_diff(150) < 10, "{found:?} {threshold:?}");
        // It never sees beyond the ends.
        assert!(scores[..30].iter().chain(&scores[272..]).all(|score| *score == 0.0));
        assert!(transform.scores(&poses[..20]).iter().all(|score| *score == 0.0));
    }
}
