//! Tilt and gyro bias from the specific force.
//!
//! In: per window, the integrals of the rotation and of the specific force in the level frame. Out: the tilt
//! by which the level frame must be turned, and the gyro bias. It knows nothing of heading.
//!
//! Kalman filter over (tilt 2, gyro bias 3, horizontal velocity 2, sway 3). The specific force is the known input of
//! the velocity; that the velocity stays near zero is the measurement, white with a stated density. A tilt
//! error leaks gravity into the velocity, which then runs away: that is what is seen.
//! Unlike a low-pass of the specific force, the filter does not take a swing of the arm for tilt, because a swing ends
//! where it began.
//!
//! A bias about the vertical is seen only as the sensor leans: it then tilts, across to the lean. Somebody who sways in step
//! with what a limb does (every step of a walk) has a velocity of that very kind, and would be taken for such a bias; the sway is a
//! state, by which the two are distinguished where that can be.

use nalgebra::{Matrix2, Matrix2x3, Matrix3, SMatrix, SVector, Vector2, Vector3};
use posed_state::Plain;
use serde::{Deserialize, Serialize};

pub(super) const STATES: usize = 10;
pub(super) const TILT: usize = 0;
pub(super) const BIAS: usize = 2;
const VELOCITY: usize = 5;
const SWAY: usize = 7;
/// Leans that last longer are no swings, s.
const SWING_S: f64 = 5.0;
/// For so long a way of moving stays, s.
const SWAY_S: f64 = 30.0;
/// Movements show a bias no better than this, rad/s: 0.1 deg/s, as in Laidig & Seel (2023). Where no field turns the heading back, one that is known better, as by
/// a rest, is left as it is.
const MOVING_BIAS_RAD_S: f64 = 1.75e-3;

/// Noise that the inclination filter assumes (tilt, gyro bias, horizontal velocity); `docs/methods/orientation.md` has its
/// equations.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Plain)]
pub struct InclinationParams {
    /// Angle random walk of the gyro, rad/sqrt(s).
    pub gyro_noise_rad_per_sqrt_s: f64,
    /// Gyro scale and cross-axis error as a fraction: turning by an angle adds this part of it as noise.
    pub gyro_scale: f64,
    /// Initial standard deviation of the gyro bias, rad/s.
    pub bias_initial_rad_s: f64,
    /// Random walk of the gyro bias, rad/s per sqrt(s).
    pub bias_walk_rad_s_per_sqrt_s: f64,
    /// The same before a field was seen: what is wrongly taken for a bias turns the heading then, and nothing turns it back.
    pub bias_walk_alone_rad_s_per_sqrt_s: f64,
    /// Noise of the specific force, m/s per sqrt(s).
    pub accel_noise_m_s_per_sqrt_s: f64,
    /// Scale and cross-axis error of the specific force as a fraction of its departure from gravity.
    pub accel_scale: f64,
    /// Density of the horizontal velocity as noise, m/sqrt(s): smaller, gravity is trusted faster, and movement tilts more.
    pub velocity_density_m_sqrt_s: f64,
    /// Standard deviation of the velocity across a lean, in step with it, m/s for a lean of 1 rad.
    pub sway_sigma_m_s: f64,
    /// Standard deviation of the velocity at rest, m/s.
    pub rest_velocity_sigma_m_s: f64,
    /// Standard deviation of the low-passed gyro about its bias at rest, rad/s.
    pub rest_gyro_sigma_rad_s: f64,
}

impl Default for InclinationParams {
    fn default() -> Self {
        Self {
            gyro_noise_rad_per_sqrt_s: 1e-4,
            gyro_scale: 0.007,
            bias_initial_rad_s: 0.5_f64.to_radians(),
            bias_walk_rad_s_per_sqrt_s: 3e-4,
            bias_walk_alone_rad_s_per_sqrt_s: 5e-5,
            accel_noise_m_s_per_sqrt_s: 0.02,
            accel_scale: 0.02,
            velocity_density_m_sqrt_s: 0.25,
            sway_sigma_m_s: 0.3,
            rest_velocity_sigma_m_s: 0.1,
            rest_gyro_sigma_rad_s: 0.03_f64.to_radians(),
        }
    }
}

/// Integrals over one window, level frame.
pub(super) struct SpecificForceWindow {
    pub(super) duration_s: f64,
    pub(super) rotation_s: Matrix3<f64>,
    pub(super) velocity_m_s: Vector3<f64>,
    pub(super) shaking: f64,
    pub(super) turned_rad: f64,
    pub(super) bridged_rad2: f64,
    /// Whether a field tells the heading.
    pub(super) has_field: bool,
    pub(super) at_rest: bool,
    /// Mean gyro of a part of a rest.
    pub(super) rest_gyro_rad_s: Option<Vector3<f64>>,
}

/// The filter's state.
#[derive(Clone, Debug, PartialEq, Plain)]
pub(super) struct Inclination {
    /// Tilt, bias, velocity, sway; the tilt part is zero between updates.
    pub(super) x: SVector<f64, STATES>,
    pub(super) p: SMatrix<f64, STATES, STATES>,
    /// How the sensor leans on average: the level rows of its rotation, low-passed.
    upright: Option<Matrix2x3<f64>>,
}

impl Inclination {
    pub(super) fn new(params: &InclinationParams) -> Self {
        let sigma = |i| match i {
            TILT..BIAS => 0.2,
            BIAS..VELOCITY => params.bias_initial_rad_s,
            VELOCITY..SWAY => 0.5,
            _ => params.sway_sigma_m_s,
        };
        Self {
            x: SVector::zeros(),
            p: SMatrix::from_diagonal(&SVector::from_fn(|i, _| f64::powi(sigma(i), 2))),
            upright: None,
        }
    }

    pub(super) fn bias_rad_s(&self) -> Vector3<f64> {
        Vector3::new(self.x[BIAS], self.x[BIAS + 1], self.x[BIAS + 2])
    }

    /// Covariance of the tilt's error about level x and y, rad².
    pub(super) fn tilt_rad2(&self) -> Matrix2<f64> {
        self.p.fixed_view::<2, 2>(TILT, TILT).into_owned()
    }

    /// Standard deviation of the gyro's bias about an axis in sensor axes, rad/s.
    pub(super) fn bias_sigma_rad_s(&self, axis: &Vector3<f64>) -> f64 {
        let bias_rad2_s2 = self.p.fixed_view::<3, 3>(BIAS, BIAS);
        axis.dot(&(bias_rad2_s2 * axis)).max(0.0).sqrt()
    }

    /// Whether a gyro that reads so at rest (rad/s) shows a bias that is credible after what is known of it: four standard
    /// deviations. A body that turns slowly looks like rest too, and would be taken for bias ever after.
    pub(super) fn may_be_bias(&self, params: &InclinationParams, gyro: &Vector3<f64>) -> bool {
        (0..3).all(|i| {
            let sigma =
                libm::hypot(self.p[(BIAS + i, BIAS + i)].max(0.0).sqrt(), params.rest_gyro_sigma_rad_s);
            (gyro[i] - self.x[BIAS + i]).abs() < 4.0 * sigma
        })
    }

    /// The bias as at the beginning.
    pub(super) fn forget_bias(&mut self, params: &InclinationParams) {
        for i in BIAS..VELOCITY {
            self.x[i] = 0.0;
            self.p.row_mut(i).fill(0.0);
            self.p.column_mut(i).fill(0.0);
            self.p[(i, i)] = params.bias_initial_rad_s.powi(2);
        }
    }

    /// As new, but for the bias and what is known of it.
    pub(super) fn forget_motion(&mut self) {
        self.upright = None;
        for i in (TILT..BIAS).chain(VELOCITY..SWAY) {
            self.x[i] = 0.0;
            self.p.row_mut(i).fill(0.0);
            self.p.column_mut(i).fill(0.0);
            self.p[(i, i)] = f64::powi(if i < BIAS { 0.2 } else { 0.5 }, 2);
        }
    }

    /// Returns the tilt (rotation about level x and y, rad) to be applied to the strapdown.
    pub(super) fn update(&mut self, params: &InclinationParams, w: &SpecificForceWindow) -> Vector2<f64> {
        self.predict(params, w);
        let r_velocity = if w.at_rest {
            params.rest_velocity_sigma_m_s.powi(2)
        } else {
            params.velocity_density_m_sqrt_s.powi(2) / w.duration_s
        };
        let lean = self.lean(w);
        // Somebody who runs in a circle has a velocity that stays: what it leaves is no noise, and would be taken for a bias again and again.
        let sigma_rad_s = (BIAS..VELOCITY).map(|i| self.p[(i, i)]).fold(0.0, f64::max).sqrt();
        let considered = !w.has_field && !w.at_rest && sigma_rad_s < MOVING_BIAS_RAD_S;
        for row in Self::velocity(&lean) {
            self.observe(&row, 0.0, r_velocity, considered);
        }
        if let Some(gyro) = w.rest_gyro_rad_s {
            for i in 0..3 {
                self.observe(&[(BIAS + i, 1.0)], gyro[i], params.rest_gyro_sigma_rad_s.powi(2), false);
            }
        }
        let tilt = Vector2::new(self.x[TILT], self.x[TILT + 1]);
        self.x[TILT] = 0.0;
        self.x[TILT + 1] = 0.0;
        tilt
    }

    /// The level rows of the rotation, less their slow mean.
    fn lean(&mut self, w: &SpecificForceWindow) -> Matrix2x3<f64> {
        let now = w.rotation_s.fixed_rows::<2>(0) / w.duration_s;
        let upright = self.upright.get_or_insert(now);
        *upright += (now - *upright) * (w.duration_s / (SWING_S + w.duration_s));
        now - *upright
    }

    /// What of the states the velocity is that stays near zero: itself, less the sway, which is across to a lean as a tilt by a bias is.
    fn velocity(lean: &Matrix2x3<f64>) -> [[(usize, f64); 4]; 2] {
        let row = |velocity: usize, across: usize, sign: f64| {
            let sway = |k: usize| (SWAY + k, sign * lean[(across, k)]);
            [(VELOCITY + velocity, 1.0), sway(0), sway(1), sway(2)]
        };
        [row(0, 1, 1.0), row(1, 0, -1.0)]
    }

    /// F of [`Self::predict`] as a matrix.
    pub(super) fn transition(w: &SpecificForceWindow) -> SMatrix<f64, STATES, STATES> {
        let mut f = SMatrix::<f64, STATES, STATES>::identity();
        f[(VELOCITY, TILT + 1)] = w.velocity_m_s.z;
        f[(VELOCITY + 1, TILT)] = -w.velocity_m_s.z;
        f.fixed_view_mut::<2, 3>(TILT, BIAS).copy_from(&-w.rotation_s.fixed_rows::<2>(0));
        for i in SWAY..STATES {
            f[(i, i)] = libm::exp(-w.duration_s / SWAY_S);
        }
        f
    }

    /// `P <- F P F' + Q` with the blocks of F applied as row and column operations.
    pub(super) fn predict(&mut self, params: &InclinationParams, w: &SpecificForceWindow) {
        let t = w.duration_s;
        let up = w.velocity_m_s.z;
        let (x, p) = (&mut self.x, &mut self.p);
        for i in 0..2 {
            x[VELOCITY + i] += w.velocity_m_s[i];
        }
        // velocity += up x tilt, then tilt -= rotation * bias: each from the old values, so in this order (the
        // terms of second order in the window are below the noise).
        for (to, from, factor) in [
            (VELOCITY, TILT + 1, up),
            (VELOCITY + 1, TILT, -up),
            (TILT, BIAS, -w.rotation_s[(0, 0)]),
            (TILT, BIAS + 1, -w.rotation_s[(0, 1)]),
            (TILT, BIAS + 2, -w.rotation_s[(0, 2)]),
            (TILT + 1, BIAS, -w.rotation_s[(1, 0)]),
            (TILT + 1, BIAS + 1, -w.rotation_s[(1, 1)]),
            (TILT + 1, BIAS + 2, -w.rotation_s[(1, 2)]),
        ] {
            for j in 0..STATES {
                p[(j, to)] += factor * p[(j, from)];
            }
            for j in 0..STATES {
                p[(to, j)] += factor * p[(from, j)];
            }
        }
        let keep = libm::exp(-t / SWAY_S);
        for i in SWAY..STATES {
            x[i] *= keep;
            for j in 0..STATES {
                p[(j, i)] *= keep;
            }
            for j in 0..STATES {
                p[(i, j)] *= keep;
            }
            p[(i, i)] += params.sway_sigma_m_s.powi(2) * (1.0 - keep * keep);
        }
        let q_tilt = params.gyro_noise_rad_per_sqrt_s.powi(2) * t
            + (params.gyro_scale * w.turned_rad).powi(2)
            + w.bridged_rad2;
        let q_velocity =
            params.accel_noise_m_s_per_sqrt_s.powi(2) * t + params.accel_scale.powi(2) * w.shaking * t;
        for i in 0..2 {
            p[(TILT + i, TILT + i)] += q_tilt;
            p[(VELOCITY + i, VELOCITY + i)] += q_velocity;
        }
        let bias_walk = if w.has_field {
            params.bias_walk_rad_s_per_sqrt_s
        } else {
            params.bias_walk_alone_rad_s_per_sqrt_s
        };
        for i in 0..3 {
            p[(BIAS + i, BIAS + i)] += bias_walk.powi(2) * t;
        }
    }

    /// A sum of states was measured as `z` with variance `r`. A bias that is `considered` stays, and so does what is known of it, though it may be what the measurement shows
    /// (Schmidt's consider update).
    fn observe(&mut self, row: &[(usize, f64)], z: f64, r: f64, considered: bool) {
        let mut ph = SVector::<f64, STATES>::zeros();
        let (mut innovation, mut variance) = (z, r);
        for &(i, h) in row {
            ph += self.p.column(i) * h;
            innovation -= h * self.x[i];
        }
        for &(i, h) in row {
            variance += h * ph[i];
        }
        let mut gain = ph / variance;
        if considered {
            gain.fixed_rows_mut::<3>(BIAS).fill(0.0);
        }
        self.x += gain * innovation;
        // P - K D' - D K' with D = P H' - K S / 2: of the best gain that is P - K H P.
        let half = ph - gain * (0.5 * variance);
        for j in 0..STATES {
            for k in 0..STATES {
                self.p[(k, j)] -= gain[k] * half[j] + half[k] * gain[j];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::consistency;
    use posed_geometry::{GRAVITY_M_S2, so3};

    /// Fifty runs in which bias, tilt, velocity and what is measured are as the filter assumes.
    #[test]
    fn it_is_consistent_in_a_matched_model() {
        const WINDOWS: usize = 200;
        let params = InclinationParams::default();
        // 95 % of chi squared with 500 degrees of freedom, over 50.
        let inside = consistency(50, &(8.80..11.28), |mut random| {
            let mut filter = Inclination::new(&params);
            let mut truth = filter.clone();
            truth.x += SVector::from_fn(|i, _| filter.p[(i, i)].sqrt() * random.normal());
            let window = |k: usize| {
                let turned = so3::exp(&Vector3::new(libm::sin(0.05 * k as f64), 0.03 * k as f64, 0.4));
                let w = SpecificForceWindow {
                    duration_s: 0.03,
                    rotation_s: turned.to_rotation_matrix().into_inner() * 0.03,
                    velocity_m_s: Vector3::z() * GRAVITY_M_S2 * 0.03,
                    shaking: 0.5,
                    turned_rad: 0.03,
                    bridged_rad2: 0.0,
                    has_field: true,
                    at_rest: false,
                    rest_gyro_rad_s: None,
                };
                // One step's noise from the filter's own Q.
                let mut noise = Inclination { x: SVector::zeros(), p: SMatrix::zeros(), upright: None };
                noise.predict(&params, &w);
                truth.x = Inclination::transition(&w) * truth.x
                    + SVector::from_fn(|i, _| noise.p[(i, i)].sqrt() * random.normal());
                filter.x = Inclination::transition(&w) * filter.x;
                filter.predict(
                    &params,
                    &SpecificForceWindow { velocity_m_s: Vector3::z() * w.velocity_m_s.z, ..w },
                );
                let r = params.velocity_density_m_sqrt_s.powi(2) / w.duration_s;
                for row in Inclination::velocity(&filter.lean(&w)) {
                    let seen: f64 = row.iter().map(|&(i, h)| h * truth.x[i]).sum();
                    filter.observe(&row, seen + r.sqrt() * random.normal(), r, false);
                }
                let e = truth.x - filter.x;
                e.dot(&filter.p.cholesky().unwrap().solve(&e))
            };
            (0..WINDOWS).map(window).collect()
        });
        assert!(inside >= 0.9, "{inside}");
    }
}
