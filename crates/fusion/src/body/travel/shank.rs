//! How long a shank is, from an ankle that is at rest while the shank turns over it.
//!
//! In: the ankle's acceleration by the shank's sensor, and how it depends on the shank's length, at times when the foot lies flat. Out: the length with its
//! standard deviation. It learns nothing from a foot that moves.
//!
//! ```text
//! 0 = a(L used) + da/dL (L - L used) + lasting error + noise,    da/dL = (alpha x d) + omega x (omega x d)
//! ```
//! with `d` along the shank to the ankle: a Kalman filter of the length and of a lasting error of the acceleration, which tilt and bias leave.

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};
use posed_state::Plain;

/// Acceleration of an ankle of a foot that lies flat, root mean square of an axis, m/s²: skin, and a foot that is no rigid body; for so long it is one error, s.
const STILL_M_S2: f64 = 0.8;
const CORRELATED_S: f64 = 0.05;
/// An ankle that plays turns its shank about the knee, which looks as if the shank were shorter. What turns so many times faster than that could show its length.
const TURNS: f64 = 3.0;
/// What tilt and bias leave for a while, m/s², and how long, s.
const LASTING_M_S2: f64 = 0.15;
const LASTING_S: f64 = 20.0;
/// How well a length is known at first, as a share of it, and at best, m: where on the shank the sensor sits is known no better.
const LENGTH_SHARE: f64 = 0.05;
const BEST_M: f64 = 0.01;
/// Beyond so many of the standard deviations of the first it is not believed.
const MOST: f64 = 3.0;

/// What is seen of a shank at one time, room axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in super::super) struct ShankSeen {
    /// Its ankle's acceleration if it is so long, m/s², m.
    pub ankle_m_s2: Vector3<f64>,
    pub length_m: f64,
    /// How the acceleration grows with the length, 1/s².
    pub by_length: Vector3<f64>,
}

/// The length, m, and the lasting error of the ankle's acceleration, room axes, m/s².
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub(super) struct Shank {
    usual_m: f64,
    state: SVector<f64, 4>,
    covariance: SMatrix<f64, 4, 4>,
}

impl Shank {
    pub(super) fn new(usual_m: f64) -> Self {
        let sigmas = SVector::from([LENGTH_SHARE * usual_m, LASTING_M_S2, LASTING_M_S2, LASTING_M_S2]);
        Self {
            usual_m,
            state: SVector::from([usual_m, 0.0, 0.0, 0.0]),
            covariance: SMatrix::from_diagonal(&sigmas.component_mul(&sigmas)),
        }
    }

    /// Its length, and the standard deviation of that, m.
    pub(super) fn length_m(&self) -> [f64; 2] {
        [self.state[0], self.covariance[(0, 0)].sqrt()]
    }

    /// For `dt_s` the foot has lain flat with this probability.
    pub(super) fn push(&mut self, seen: &ShankSeen, flat: f64, dt_s: f64) {
        if seen.by_length.norm() * seen.length_m < TURNS * STILL_M_S2 {
            return;
        }
        let keep = 1.0 - (dt_s / LASTING_S).min(1.0);
        for k in 1..4 {
            self.state[k] *= keep;
            self.covariance.row_mut(k).scale_mut(keep);
            self.covariance.column_mut(k).scale_mut(keep);
            self.covariance[(k, k)] += LASTING_M_S2 * LASTING_M_S2 * (1.0 - keep * keep);
        }
        self.covariance[(0, 0)] = self.covariance[(0, 0)].max(BEST_M * BEST_M);
        let mut h = SMatrix::<f64, 3, 4>::zeros();
        h.set_column(0, &seen.by_length);
        h.fixed_columns_mut::<3>(1).copy_from(&Matrix3::identity());
        let cross = self.covariance * h.transpose();
        let noise = STILL_M_S2 * STILL_M_S2 * (CORRELATED_S / dt_s).max(1.0) / flat.max(1e-6);
        let Some(inverse) = (h * cross + Matrix3::identity() * noise).try_inverse() else { return };
        let gain = cross * inverse;
        let left = seen.by_length * seen.length_m - seen.ankle_m_s2 - h * self.state;
        self.state += gain * left;
        self.covariance -= gain * cross.transpose();
        self.covariance = (self.covariance + self.covariance.transpose()) * 0.5;
        let most_m = MOST * LENGTH_SHARE * self.usual_m;
        self.state[0] = self.state[0].clamp(self.usual_m - most_m, self.usual_m + most_m);
    }
}
