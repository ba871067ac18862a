//! The covariance of an error and its rate: one half of the pose filter.
//!
//! Position with velocity, and orientation with angular velocity, are driven and measured independently, so
//! that the 12 x 12 covariance of the error state is two 6 x 6 blocks, always; only the blocks are kept.

use nalgebra::{Matrix3, Matrix6, SMatrix, Vector3};
use posed_state::Plain;

/// Covariance of (error, rate error), 3 + 3.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub(super) struct Half(Matrix6<f64>);

impl Half {
    /// Known to the given covariance, with a rate that may be anything.
    pub(super) fn new(error: &Matrix3<f64>, angular_velocity_sigma_rad_s: f64) -> Self {
        let mut covariance = Matrix6::zeros();
        covariance.fixed_view_mut::<3, 3>(0, 0).copy_from(error);
        covariance
            .fixed_view_mut::<3, 3>(3, 3)
            .fill_diagonal(angular_velocity_sigma_rad_s * angular_velocity_sigma_rad_s);
        Self(covariance)
    }

    /// Covariance of the error.
    pub(super) fn error(&self) -> Matrix3<f64> {
        self.0.fixed_view::<3, 3>(0, 0).into_owned()
    }

    #[cfg(test)]
    pub(super) fn matrix(&self) -> &Matrix6<f64> {
        &self.0
    }

    /// `P = F P F' + Q` for white acceleration of spectral density `density` over `dt_s`.
    pub(super) fn predict(&mut self, transition: &Matrix6<f64>, density: f64, dt_s: f64) {
        let mut p = transition * self.0 * transition.transpose();
        let (q11, q12, q22) = (density * dt_s.powi(3) / 3.0, density * dt_s * dt_s / 2.0, density * dt_s);
        for i in 0..3 {
            p[(i, i)] += q11;
            p[(i, i + 3)] += q12;
            p[(i + 3, i)] += q12;
            p[(i + 3, i + 3)] += q22;
        }
        self.0 = (p + p.transpose()) * 0.5;
    }

    /// Takes a measurement of the error; returns how (error, rate) are to be corrected, or `None` where the
    /// innovation's covariance cannot be inverted.
    ///
    /// Joseph's form `(I - KH) P (I - KH)' + K R K'`, which stays positive definite whatever K is.
    pub(super) fn update(
        &mut self,
        innovation: &Vector3<f64>,
        noise: &Matrix3<f64>,
    ) -> Option<(Vector3<f64>, Vector3<f64>)> {
        let p_h = self.0.fixed_columns::<3>(0).into_owned();
        let factor = (self.error() + noise).cholesky()?;
        let gain: SMatrix<f64, 6, 3> = factor.solve(&p_h.transpose()).transpose();
        let mut keep = Matrix6::identity();
        let mut left = keep.fixed_columns_mut::<3>(0);
        left -= gain;
        let p = keep * self.0 * keep.transpose() + gain * noise * gain.transpose();
        self.0 = (p + p.transpose()) * 0.5;
        let correction = gain * innovation;
        Some((correction.fixed_rows::<3>(0).into_owned(), correction.fixed_rows::<3>(3).into_owned()))
    }

    /// Turns the error's axes, after the reference that it is local to has been corrected.
    pub(super) fn reset(&mut self, jacobian: &Matrix3<f64>) {
        let mut transform = Matrix6::identity();
        transform.fixed_view_mut::<3, 3>(0, 0).copy_from(jacobian);
        self.0 = transform * self.0 * transform.transpose();
    }
}
