//! How noisy the readings of a pole are, and where.
//!
//! What comes in: positions in the transmitter frame. What goes out: covariances and whitening matrices. White
//! noise on the nine signals makes a disc across the transmitter's ray that grows with `r^4`; everything else
//! (words, filters, what the map does not explain) is a floor, alike in all directions and places.

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

/// Range over which the power law is believed, m.
const RANGE_M: [f64; 2] = [0.1, 5.0];

/// Noise of position readings: a disc across the transmitter's ray that grows with the fourth power of the range, and a
/// floor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FieldNoise {
    /// White noise on each of the nine signals, in units of the source's `mu0 m / 4 pi`, 1/m^3.
    pub sigma_signal: f64,
    /// Standard deviation that does not depend on the place, per axis, m.
    pub floor_m: f64,
}

impl FieldNoise {
    /// Standard deviations along the transmitter's ray and across it (per axis) at `range_m`, without the floor, m:
    /// `r^4 s / sqrt(54)` and `sqrt(5) / 3 r^4 s`. The range is held within 0.1 to 5 m, where the law is believed.
    pub fn disc_m(&self, range_m: f64) -> (f64, f64) {
        let spread = range_m.clamp(RANGE_M[0], RANGE_M[1]).powi(4) * self.sigma_signal;
        (spread / 54f64.sqrt(), 5f64.sqrt() / 3.0 * spread)
    }

    /// Expected square of the 3-D error of a reading at `position_m` (transmitter frame), floor included, m^2.
    pub fn mean_square_m2(&self, position_m: &Vector3<f64>) -> f64 {
        let (along, across) = self.disc_m(position_m.norm());
        along * along + 2.0 * across * across + 3.0 * self.floor_m * self.floor_m
    }

    /// Inverse square root of the covariance of a reading at `position_m` (transmitter frame), 1/m: symmetric, 3 x 3.
    /// The floor counts as at least a micrometre, so that it is finite everywhere.
    pub fn whitener(&self, position_m: &Vector3<f64>) -> Matrix3<f64> {
        let r = position_m.norm();
        let (along, across) = self.disc_m(r);
        let floor = self.floor_m.max(1e-6);
        let along = 1.0 / libm::hypot(along, floor);
        let across = 1.0 / libm::hypot(across, floor);
        let u = if r > 1e-9 { position_m / r } else { Vector3::x() };
        let mut whitener = u * u.transpose() * (along - across);
        whitener += Matrix3::identity() * across;
        whitener
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_whitener_is_the_inverse_root_of_the_covariance() {
        let noise = FieldNoise { sigma_signal: 1e-3, floor_m: 2e-3 };
        let p = Vector3::new(0.6, -1.0, 0.8);
        let (along, across) = noise.disc_m(p.norm());
        assert!((across / along - 5.477).abs() < 1e-3, "a disc 5.5 times wider than deep");
        let w = noise.whitener(&p);
        let u = p.normalize();
        let expected = u * u.transpose() * (along * along - across * across)
            + Matrix3::identity() * (across * across + 4e-6);
        assert!((w * w * expected - Matrix3::identity()).norm() < 1e-9);
        assert!((expected.trace() - noise.mean_square_m2(&p)).abs() < 1e-15);
    }
}
