//! The covariance of an error-state filter and its updates.
//!
//! In: measurement rows with their innovation and noise. Out: the correction of the error state, and how well the
//! innovation fits. It knows nothing of what the states mean.

use nalgebra::{SMatrix, SVector};
use serde::{Deserialize, Serialize};

/// Covariance of N error states.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Covariance<const N: usize>(pub(super) SMatrix<f64, N, N>);

/// What is known of M measurements before they are used.
pub(super) struct Innovation<const M: usize, const N: usize> {
    /// Covariance with the states.
    pub(super) cross: SMatrix<f64, N, M>,
    /// Predicted covariance without the measurements' own noise.
    pub(super) predicted: SMatrix<f64, M, M>,
}

impl<const N: usize> Covariance<N> {
    /// From standard deviations.
    pub(super) fn from_sigmas(sigmas: SVector<f64, N>) -> Self {
        Self(SMatrix::from_diagonal(&sigmas.component_mul(&sigmas)))
    }

    /// `P H'` and `H P H'`; columns of `h` from `columns` on are zero.
    pub(super) fn innovation<const M: usize>(
        &self,
        h: &SMatrix<f64, M, N>,
        columns: usize,
    ) -> Innovation<M, N> {
        let cross = product(&self.0, h, columns);
        let mut predicted = SMatrix::<f64, M, M>::zeros();
        for j in 0..columns {
            for i in 0..M {
                for k in 0..M {
                    predicted[(i, k)] += h[(i, j)] * cross[(j, k)];
                }
            }
        }
        Innovation { cross, predicted }
    }

    /// Kalman update in Joseph's form; returns the correction of the error state. `inverse` is that of the
    /// innovation's covariance with this `noise` ([`Innovation::inverse`]).
    pub(super) fn update<const M: usize>(
        &mut self,
        h: &SMatrix<f64, M, N>,
        columns: usize,
        innovation: &Innovation<M, N>,
        inverse: &SMatrix<f64, M, M>,
        residual: &SVector<f64, M>,
        noise: &SVector<f64, M>,
    ) -> SVector<f64, N> {
        let gain = innovation.cross * inverse;
        self.apply(h, columns, innovation, &gain, noise);
        gain * residual
    }

    /// What a correction with any `gain` does to the covariance, in Joseph's form:
    /// `(I - KH) P (I - KH)' + K R K' = A - (A H' - K R) K'` with `A = P - K (P H')'`.
    pub(super) fn apply<const M: usize>(
        &mut self,
        h: &SMatrix<f64, M, N>,
        columns: usize,
        innovation: &Innovation<M, N>,
        gain: &SMatrix<f64, N, M>,
        noise: &SVector<f64, M>,
    ) {
        subtract_product(&mut self.0, gain, &innovation.cross);
        let mut rest = product(&self.0, h, columns);
        for i in 0..M {
            rest.column_mut(i).axpy(-noise[i], &gain.column(i), 1.0);
        }
        subtract_product(&mut self.0, &rest, gain);
    }

    /// The mean of the matrix and its transpose.
    pub(super) fn symmetrise(&mut self) {
        for j in 0..N {
            for i in 0..j {
                let mean = 0.5 * (self.0[(i, j)] + self.0[(j, i)]);
                self.0[(i, j)] = mean;
                self.0[(j, i)] = mean;
            }
        }
    }

    /// Row `to` becomes `keep` times itself plus the sum of `factor * row(from)`; columns likewise: one line of
    /// `F P F'`. The rows named must not have been changed by the same prediction before.
    pub(super) fn combine(&mut self, to: usize, keep: f64, others: &[(usize, f64)]) {
        let mut column = self.0.column(to) * keep;
        for &(from, factor) in others {
            column.axpy(factor, &self.0.column(from), 1.0);
        }
        let mut corner = keep * column[to];
        for &(from, factor) in others {
            corner += factor * column[from];
        }
        column[to] = corner;
        self.0.set_column(to, &column);
        self.0.set_row(to, &column.transpose());
    }
}

impl<const M: usize, const N: usize> Innovation<M, N> {
    /// Inverse of the innovation's covariance; `None` where that is not positive.
    pub(super) fn inverse(&self, noise: &SVector<f64, M>) -> Option<SMatrix<f64, M, M>> {
        let mut s = self.predicted;
        for i in 0..M {
            s[(i, i)] += noise[i];
        }
        // Gauss-Jordan without pivots: a covariance needs none, and M is at most three.
        let mut out = SMatrix::<f64, M, M>::identity();
        for i in 0..M {
            let pivot = s[(i, i)];
            if !(pivot > 0.0 && pivot.is_finite()) {
                return None;
            }
            for j in 0..M {
                s[(i, j)] /= pivot;
                out[(i, j)] /= pivot;
            }
            for k in (0..M).filter(|k| *k != i) {
                let factor = s[(k, i)];
                for j in 0..M {
                    s[(k, j)] -= factor * s[(i, j)];
                    out[(k, j)] -= factor * out[(i, j)];
                }
            }
        }
        Some(out)
    }
}

/// `p h'`, all M columns in one pass over `p`; columns of `h` from `columns` on are zero.
fn product<const M: usize, const N: usize>(
    p: &SMatrix<f64, N, N>,
    h: &SMatrix<f64, M, N>,
    columns: usize,
) -> SMatrix<f64, N, M> {
    let mut out = [[0.0; N]; M];
    for (p, h) in p.data.0.iter().zip(&h.data.0).take(columns) {
        // Many states do not touch many measurements.
        if h.iter().all(|factor| *factor == 0.0) {
            continue;
        }
        for i in 0..M {
            for k in 0..N {
                out[i][k] += h[i] * p[k];
            }
        }
    }
    SMatrix::from_data(nalgebra::ArrayStorage(out))
}

/// `p -= left right'`, in one pass over `p`.
#[expect(clippy::needless_range_loop, reason = "plain indices let the compiler vectorise over the rows")]
fn subtract_product<const M: usize, const N: usize>(
    p: &mut SMatrix<f64, N, N>,
    left: &SMatrix<f64, N, M>,
    right: &SMatrix<f64, N, M>,
) {
    for (j, column) in p.data.0.iter_mut().enumerate() {
        let factors: [f64; M] = std::array::from_fn(|i| right.data.0[i][j]);
        for k in 0..N {
            let mut sum = 0.0;
            for i in 0..M {
                sum += factors[i] * left.data.0[i][k];
            }
            column[k] -= sum;
        }
    }
}
