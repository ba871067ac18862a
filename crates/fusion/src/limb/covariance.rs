//! The covariance of an error-state filter and its updates.
//!
//! In: measurement rows with their innovation and noise. Out: the correction of the error state, and how well the
//! innovation fits. It knows nothing of what the states mean.

use nalgebra::{Matrix3, SMatrix, SVector};
use posed_state::Plain;

use super::wide::{product, subtract_both};

/// Covariance of N error states; exactly symmetric, and every step leaves it so.
#[derive(Clone, Debug, PartialEq, Plain)]
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
        innovation: &Innovation<M, N>,
        inverse: &SMatrix<f64, M, M>,
        residual: &SVector<f64, M>,
        noise: &SVector<f64, M>,
    ) -> SVector<f64, N> {
        let gain = innovation.cross * inverse;
        self.apply(innovation, &gain, noise);
        gain * residual
    }

    /// What a correction with any `gain` does to the covariance, in Joseph's form:
    /// `(I - KH) P (I - KH)' + K R K' = P - K D' - D K'` with `D = P H' - K S / 2` and `S = H P H' + R`.
    pub(super) fn apply<const M: usize>(
        &mut self,
        innovation: &Innovation<M, N>,
        gain: &SMatrix<f64, N, M>,
        noise: &SVector<f64, M>,
    ) {
        let half = innovation.cross - gain * (innovation.covariance(noise) * 0.5);
        subtract_both(&mut self.0, gain, &half);
    }

    /// The three rows from `to` on become the sum of `factor` times the three rows from `from` on; columns likewise: three lines
    /// of `F P F'`. The rows named must not have been changed by the same prediction before.
    pub(super) fn combine_blocks(&mut self, to: usize, parts: &[(usize, Matrix3<f64>)]) {
        let mut columns = SMatrix::<f64, N, 3>::zeros();
        for (from, factor) in parts {
            columns += self.0.fixed_view::<N, 3>(0, *from) * factor.transpose();
        }
        let corner = parts.iter().map(|(from, factor)| factor * columns.fixed_view::<3, 3>(*from, 0));
        let corner: Matrix3<f64> = corner.sum();
        columns.fixed_view_mut::<3, 3>(to, 0).copy_from(&(0.5 * (corner + corner.transpose())));
        self.0.fixed_view_mut::<N, 3>(0, to).copy_from(&columns);
        self.0.fixed_view_mut::<3, N>(to, 0).copy_from(&columns.transpose());
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
    /// The innovation's covariance.
    fn covariance(&self, noise: &SVector<f64, M>) -> SMatrix<f64, M, M> {
        let mut s = self.predicted;
        for i in 0..M {
            s[(i, i)] += noise[i];
        }
        s
    }

    /// Its inverse; `None` where it is not positive.
    pub(super) fn inverse(&self, noise: &SVector<f64, M>) -> Option<SMatrix<f64, M, M>> {
        let mut s = self.covariance(noise);
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
