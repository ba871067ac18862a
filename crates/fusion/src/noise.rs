//! How noisy a magnetic tracker is, and where.
//!
//! What comes in: a position in the transmitter frame. What goes out: covariances of the measured position and
//! orientation there. White noise on the nine signals makes the position uncertain by `r^4`, 5.5 times more
//! across the transmitter's ray than along it, and the orientation by `r^3`; the device's words add their step.

use nalgebra::{Matrix3, Vector3};
use posed_state::Plain;

/// Width of the noise disc over its depth, `(sqrt(5) / 3) sqrt(54)`: it follows from the equations of the dipole, not from a
/// device.
pub const ACROSS_OVER_ALONG: f64 = 5.477_225_575_051_661;
/// Standard deviation of a position word's step (72 inch over 14 bits), m.
const POSITION_STEP_M: f64 = 6.5e-5;
/// Standard deviation of an orientation word's step, rad.
const ROTATION_STEP_RAD: f64 = 1e-4;
/// Range over which the power laws hold, m; nearer and farther the noise is taken as at the end.
const RANGE_M: [f64; 2] = [0.1, 4.0];

/// Noise of a magnetic tracker as standard deviations at a reference distance; white noise only (`docs/methods/noise.md`).
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub struct TrackerNoise {
    /// Reference distance from the transmitter, m, above 0.
    pub r0_m: f64,
    /// Position along the ray at `r0_m`, m; across it [`ACROSS_OVER_ALONG`] times as much.
    pub sigma_radial_m: f64,
    /// Rotation about each axis at `r0_m`, rad.
    pub sigma_rotation_rad: f64,
}

impl Default for TrackerNoise {
    /// A quiet Flock of Birds without its filters, at one metre. Rather too small than too large: an assumed
    /// noise that is too large makes the filter lag behind fast motion, one that is too small only makes
    /// it repeat the measurement, and the filter raises it from its innovations.
    fn default() -> Self {
        Self { r0_m: 1.0, sigma_radial_m: 5e-5, sigma_rotation_rad: 5e-4 }
    }
}

impl TrackerNoise {
    /// Covariance of a measured position, m², 3 x 3, transmitter axes: a disc across the ray that grows with the fourth power
    /// of the distance, and the device's word step. The law holds from 0.1 m to 4 m; nearer and farther the values of the
    /// ends are given.
    pub fn position_m2(&self, position_m: &Vector3<f64>) -> Matrix3<f64> {
        let r = position_m.norm();
        let ratio = r.clamp(RANGE_M[0], RANGE_M[1]) / self.r0_m;
        let along = self.sigma_radial_m * ratio.powi(4);
        let across = ACROSS_OVER_ALONG * along;
        let u = if r > 1e-9 { position_m / r } else { Vector3::x() };
        let ray = u * u.transpose();
        (Matrix3::identity() - ray) * (across * across)
            + ray * (along * along)
            + Matrix3::identity() * (POSITION_STEP_M * POSITION_STEP_M)
    }

    /// Covariance of a measured orientation, rad², 3 x 3, sensor axes, equal about all axes: it grows with the third power of
    /// the distance of `position_m` (m, transmitter frame) within 0.1 m to 4 m. `None` counts as 1 m: a format without
    /// positions.
    pub fn rotation_rad2(&self, position_m: Option<&Vector3<f64>>) -> Matrix3<f64> {
        let r = position_m.map_or(1.0, |position| position.norm());
        let sigma = self.sigma_rotation_rad * (r.clamp(RANGE_M[0], RANGE_M[1]) / self.r0_m).powi(3);
        Matrix3::identity() * (sigma * sigma + ROTATION_STEP_RAD * ROTATION_STEP_RAD)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOISE: TrackerNoise = TrackerNoise { r0_m: 1.0, sigma_radial_m: 0.01, sigma_rotation_rad: 0.02 };

    #[test]
    fn the_cloud_is_a_disc_across_the_ray() {
        let p = Vector3::new(0.6, 0.8, 0.0);
        let covariance = NOISE.position_m2(&p);
        let along = (p.transpose() * covariance * p)[0];
        let across = covariance[(2, 2)];
        assert!(((across / along).sqrt() - 5.477).abs() < 0.01);
    }

    #[test]
    fn it_grows_with_the_fourth_and_the_third_power() {
        let (near, far) = (Vector3::x() * 0.8, Vector3::x() * 1.6);
        let ratio = NOISE.position_m2(&far)[(0, 0)] / NOISE.position_m2(&near)[(0, 0)];
        assert!((ratio.sqrt() - 16.0).abs() < 0.05, "{ratio}");
        let ratio = NOISE.rotation_rad2(Some(&far))[(0, 0)] / NOISE.rotation_rad2(Some(&near))[(0, 0)];
        assert!((ratio.sqrt() - 8.0).abs() < 0.05, "{ratio}");
    }

    #[test]
    fn the_transmitter_itself_is_no_singular_place() {
        assert!(NOISE.position_m2(&Vector3::zeros()).iter().all(|value| value.is_finite()));
    }
}
