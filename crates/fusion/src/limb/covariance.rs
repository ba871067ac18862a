//! The covariance of an error-state filter and its updates.
//!
//! In: measurement rows with their innovation and noise. Out: the correction of the error state, and how well the
//! innovation fits. It knows nothing of what the states mean.

use nalgebra::{Matrix3, SMatrix, SVector};
use posed_state::Plain;

use super::parameters::{ByParameters, PARAMETERS};
use super::wide::{product, subtract, subtract_both};

/// Covariance of N error states, as if the limb's parameters were right, and how wrong each state is by each of those.
#[derive(Clone, Debug, PartialEq, Plain)]
pub(super) struct Covariance<const N: usize> {
    /// Exactly symmetric, and every step leaves it so.
    pub(super) own: SMatrix<f64, N, N>,
    /// Derivative of the states with respect to the parameters, one column per state; not kept where they are exact.
    pub(super) by_parameters: SMatrix<f64, PARAMETERS, N>,
    /// Whether it is kept.
    pub(super) depends: bool,
}

/// What is known of M measurements before they are used.
pub(super) struct Innovation<const M: usize, const N: usize> {
    /// Covariance with the states.
    pub(super) cross: SMatrix<f64, N, M>,
    /// Predicted covariance without the measurements' own noise.
    pub(super) predicted: SMatrix<f64, M, M>,
    /// How they depend on the parameters: directly, and through the states.
    pub(super) by_parameters: ByParameters<M>,
}

impl<const N: usize> Covariance<N> {
    /// From standard deviations.
    pub(super) fn from_sigmas(sigmas: SVector<f64, N>) -> Self {
        Self::of(SMatrix::from_diagonal(&sigmas.component_mul(&sigmas)))
    }

    /// Of states that depend on no parameter.
    pub(super) fn of(own: SMatrix<f64, N, N>) -> Self {
        Self { own, by_parameters: SMatrix::zeros(), depends: false }
    }

    /// `P H'` and `H P H'`; columns of `h` from `columns` on are zero. `direct` is how the measurements depend on the parameters beside the states.
    pub(super) fn innovation<const M: usize>(
        &self,
        h: &SMatrix<f64, M, N>,
        columns: usize,
        direct: &ByParameters<M>,
    ) -> Innovation<M, N> {
        let cross = product(&self.own, h, columns);
        let by_parameters = if self.depends {
            product(&self.by_parameters, h, columns) + direct
        } else {
            ByParameters::zeros()
        };
        let mut predicted = SMatrix::<f64, M, M>::zeros();
        for j in 0..columns {
            for i in 0..M {
                for k in 0..M {
                    predicted[(i, k)] += h[(i, j)] * cross[(j, k)];
                }
            }
        }
        Innovation { cross, predicted, by_parameters }
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
        subtract_both(&mut self.own, gain, &half);
        if self.depends {
            subtract(&mut self.by_parameters, &innovation.by_parameters, gain);
        }
    }

    /// The three rows from `to` on become the sum of `factor` times the three rows from `from` on; columns likewise: three lines
    /// of `F P F'`. The rows named must not have been changed by the same prediction before.
    pub(super) fn combine_blocks(&mut self, to: usize, parts: &[(usize, Matrix3<f64>)]) {
        let mut columns = SMatrix::<f64, N, 3>::zeros();
        for (from, factor) in parts {
            columns += self.own.fixed_view::<N, 3>(0, *from) * factor.transpose();
        }
        if self.depends {
            let mut by = SMatrix::<f64, PARAMETERS, 3>::zeros();
            for (from, factor) in parts {
                by += self.by_parameters.fixed_view::<PARAMETERS, 3>(0, *from) * factor.transpose();
            }
            self.by_parameters.fixed_view_mut::<PARAMETERS, 3>(0, to).copy_from(&by);
        }
        let corner = parts.iter().map(|(from, factor)| factor * columns.fixed_view::<3, 3>(*from, 0));
        let corner: Matrix3<f64> = corner.sum();
        columns.fixed_view_mut::<3, 3>(to, 0).copy_from(&(0.5 * (corner + corner.transpose())));
        self.own.fixed_view_mut::<N, 3>(0, to).copy_from(&columns);
        self.own.fixed_view_mut::<3, N>(to, 0).copy_from(&columns.transpose());
    }

    /// Row `to` becomes `keep` times itself plus the sum of `factor * row(from)`; columns likewise: one line of
    /// `F P F'`. The rows named must not have been changed by the same prediction before.
    pub(super) fn combine(&mut self, to: usize, keep: f64, others: &[(usize, f64)]) {
        let mut column = self.own.column(to) * keep;
        for &(from, factor) in others {
            column.axpy(factor, &self.own.column(from), 1.0);
        }
        if self.depends {
            let mut by = self.by_parameters.column(to) * keep;
            for &(from, factor) in others {
                by.axpy(factor, &self.by_parameters.column(from), 1.0);
            }
            self.by_parameters.set_column(to, &by);
        }
        let mut corner = keep * column[to];
        for &(from, factor) in others {
            corner += factor * column[from];
        }
        column[to] = corner;
        self.own.set_column(to, &column);
        self.own.set_row(to, &column.transpose());
    }
}

impl<const M: usize, const N: usize> Innovation<M, N> {
    /// The innovation's covariance, as if the parameters were right.
    pub(super) fn covariance(&self, noise: &SVector<f64, M>) -> SMatrix<f64, M, M> {
        let mut s = self.predicted;
        for i in 0..M {
            s[(i, i)] += noise[i];
        }
        s
    }

    /// Its inverse; `None` where it is not positive.
    pub(super) fn inverse(&self, noise: &SVector<f64, M>) -> Option<SMatrix<f64, M, M>> {
        inverse_of(self.covariance(noise))
    }
}

/// Inverse of a covariance; `None` where it is not positive.
pub(super) fn inverse_of<const M: usize>(mut s: SMatrix<f64, M, M>) -> Option<SMatrix<f64, M, M>> {
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
