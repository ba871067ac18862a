//! Heading from the magnetometer.
//!
//! In: per window, the mean field turned into the level frame, and the mean rotation. Out: the angle that
//! turns the level frame to north. It never touches the tilt.
//!
//! A sample is `R m = e + d + R h + tau R (w x m) + noise`, all in the level frame: `e` the earth's field, which
//! only drifts with the gyro's heading, at a rate that is a state too; `d` a disturbance in the room; `h` a
//! magnet or iron attached to the sensor; `tau` the lag of the magnetometer behind the gyro. That is linear in
//! (e, d, h, tau), so one Kalman filter with eleven states tells them apart as the sensor turns.
//!
//! As long as the innovations are healthy, `d` is zero. When the field jumps, `d` and `h` are made uncertain and
//! `e` is not: the heading holds by the gyro until the turning has shown which of the two it was. `d` ends when
//! the samples are explained without it by what was known of `h` before, or is known to be nothing, and is forgotten only after many minutes: a field that turns with norm
//! and dip unchanged cannot be distinguished from a turned sensor by any other sign.

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};
use posed_state::Plain;
use serde::{Deserialize, Serialize};

use super::inclination::SpecificForceWindow;

const STATES: usize = 11;
const EARTH: usize = 0;
const ROOM: usize = 3;
const MAGNET: usize = 6;
const LAG: usize = 9;
const RATE: usize = 10;
/// Variance of an angle that may be any, rad².
const UNKNOWN_RAD2: f64 = std::f64::consts::PI * std::f64::consts::PI / 3.0;

/// What the heading filter assumes; fields as fractions of the first sample's norm. Equations: `docs/methods/orientation.md`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Plain)]
pub struct HeadingParams {
    /// Drift of the gyro's heading, rad per sqrt(s).
    pub drift_rad_per_sqrt_s: f64,
    /// Gyro scale error as a fraction: turning by an angle adds this part of it to the drift.
    pub drift_scale: f64,
    /// Standard deviation of the rate at which the gyro's heading drifts, rad/s.
    pub drift_rate_sigma_rad_s: f64,
    /// Time in which that rate changes, s.
    pub drift_rate_tau_s: f64,
    /// The same deviation at rest, where the gyro's bias is measured, rad/s.
    pub drift_rate_rest_rad_s: f64,
    /// Drift of the earth's field in norm and dip, fraction per sqrt(s).
    pub earth_walk_per_sqrt_s: f64,
    /// Initial standard deviation of the field of a magnet on the sensor, fraction: small, because a magnetometer comes
    /// calibrated. A magnet that is put on shows as a jump.
    pub magnet_initial: f64,
    /// Drift of that field, fraction per sqrt(s).
    pub magnet_walk_per_sqrt_s: f64,
    /// Initial standard deviation of the magnetometer's lag, s.
    pub lag_initial_s: f64,
    /// Drift of the lag, s per sqrt(s).
    pub lag_walk_s_per_sqrt_s: f64,
    /// White noise of a window's mean field, fraction.
    pub field_noise: f64,
    /// Error of the field per rotation in a window (misalignment, nonlinearity of the lag), fraction per rad.
    pub rotation_noise_per_rad: f64,
    /// Normalised innovation squared (3 degrees of freedom, low-passed) that shows a jump.
    pub jump_nis: f64,
    /// Time constant of its low-pass, s.
    pub jump_tau_s: f64,
    /// Standard deviation that room disturbance and magnet are given at a jump, fraction.
    pub jump_sigma: f64,
    /// Standard deviation of a lasting disturbance in the room, fraction.
    pub room_sigma: f64,
    /// Time after which a lasting disturbance is taken for the earth's field, s.
    pub room_memory_s: f64,
    /// Standard deviation, a fraction, to which a disturbance in the room must be known before it can be taken for none.
    pub room_known: f64,
    /// Normalised innovation squared (3 degrees of freedom, low-passed) under no disturbance, below which it has passed.
    pub clear_nis: f64,
    /// Time constant of that low-pass, s.
    pub clear_tau_s: f64,
}

impl Default for HeadingParams {
    fn default() -> Self {
        Self {
            drift_rad_per_sqrt_s: 1e-4,
            drift_scale: 0.003,
            drift_rate_sigma_rad_s: 3e-4,
            drift_rate_tau_s: 300.0,
            drift_rate_rest_rad_s: 1e-5,
            earth_walk_per_sqrt_s: 1e-4,
            magnet_initial: 5e-4,
            magnet_walk_per_sqrt_s: 1e-5,
            lag_initial_s: 0.01,
            lag_walk_s_per_sqrt_s: 1e-5,
            field_noise: 0.04,
            rotation_noise_per_rad: 0.1,
            jump_nis: 13.0,
            jump_tau_s: 0.4,
            jump_sigma: 1.0,
            room_sigma: 0.5,
            room_memory_s: 600.0,
            room_known: 0.1,
            clear_nis: 8.0,
            clear_tau_s: 1.0,
        }
    }
}

/// Means over one window, level frame.
pub(super) struct FieldWindow {
    pub(super) duration_s: f64,
    pub(super) field: Vector3<f64>,
    pub(super) lag: Vector3<f64>,
    pub(super) rotation: Matrix3<f64>,
    pub(super) turned_rad: f64,
    pub(super) bridged_rad2: f64,
    /// Standard deviation of the gyro's bias about the vertical, rad/s.
    pub(super) bias_sigma_rad_s: f64,
    pub(super) at_rest: bool,
}

/// The filter's state.
#[derive(Clone, Debug, PartialEq, Plain)]
pub(super) struct Heading {
    /// Norm of the first sample: the unit of all fields here; 0 before it.
    unit: f64,
    x: SVector<f64, STATES>,
    p: SMatrix<f64, STATES, STATES>,
    nis: f64,
    disturbed: bool,
    /// The magnet on the sensor as it was known before the field changed, with its covariance.
    calm: (Vector3<f64>, Matrix3<f64>),
    clear_nis: f64,
    offset_rad: f64,
    /// Since the last field: time, s, and what noise and scale of the gyro have added to the variance, rad².
    unseen_s: f64,
    unseen_rad2: f64,
    /// Standard deviation of the heading by a gyro bias that the inclination does not know yet, rad: the filter does not estimate it,
    /// and does not count it in its gains.
    biased_rad: f64,
}

impl Heading {
    pub(super) fn new(params: &HeadingParams) -> Self {
        let sigma = |i| match i {
            EARTH..ROOM => 1.0,
            ROOM..MAGNET => 0.0,
            MAGNET..LAG => params.magnet_initial,
            LAG => params.lag_initial_s,
            _ => params.drift_rate_sigma_rad_s,
        };
        Self {
            unit: 0.0,
            x: SVector::zeros(),
            p: SMatrix::from_diagonal(&SVector::from_fn(|i, _| f64::powi(sigma(i), 2))),
            nis: 0.0,
            disturbed: false,
            calm: (Vector3::zeros(), Matrix3::zeros()),
            clear_nis: 0.0,
            offset_rad: 0.0,
            unseen_s: 0.0,
            unseen_rad2: 0.0,
            biased_rad: 0.0,
        }
    }

    /// Begins with the first sample, level frame.
    pub(super) fn start(&mut self, field: Vector3<f64>) {
        self.unit = field.norm();
        self.x.fixed_rows_mut::<3>(EARTH).copy_from(&(field / self.unit));
        self.offset_rad = libm::atan2(field.x, field.y);
    }

    /// Begins anew with the next field; the heading holds until then.
    pub(super) fn resume(&mut self, params: &HeadingParams) {
        *self = Self { offset_rad: self.offset_rad, ..Self::new(params) };
    }

    pub(super) fn offset_rad(&self) -> f64 {
        self.offset_rad
    }

    /// Variance of the heading's error, rad²; that of a heading that may be any before a field has given it.
    pub(super) fn variance_rad2(&self) -> f64 {
        if !self.begun() {
            return UNKNOWN_RAD2;
        }
        let rate_rad2 = self.p[(RATE, RATE)] * self.unseen_s.powi(2);
        (self.seen_rad2() + self.unseen_rad2 + rate_rad2 + self.biased_rad.powi(2)).min(UNKNOWN_RAD2)
    }

    /// Variance of the azimuth of the earth's field, rad².
    fn seen_rad2(&self) -> f64 {
        let (ex, ey) = (self.x[EARTH], self.x[EARTH + 1]);
        let p = |i: usize, j: usize| self.p[(EARTH + i, EARTH + j)];
        let across = ey * ey * p(0, 0) - 2.0 * ex * ey * p(0, 1) + ex * ex * p(1, 1);
        (across / (ex * ex + ey * ey).powi(2).max(1e-12)).max(0.0)
    }

    /// A window without a field: the gyro alone carries the heading.
    pub(super) fn hold(&mut self, params: &HeadingParams, w: &SpecificForceWindow, bias_sigma_rad_s: f64) {
        self.unseen_s += w.duration_s;
        self.unseen_rad2 += drift_rad2(params, w.duration_s, w.turned_rad) + w.bridged_rad2;
        self.biased_rad += bias_sigma_rad_s * w.duration_s;
    }

    pub(super) fn begun(&self) -> bool {
        self.unit > 0.0
    }

    pub(super) fn disturbed(&self) -> bool {
        self.disturbed
    }

    pub(super) fn magnet(&self) -> Vector3<f64> {
        Vector3::new(self.x[MAGNET], self.x[MAGNET + 1], self.x[MAGNET + 2]) * self.unit
    }

    /// Takes one window.
    pub(super) fn update(&mut self, params: &HeadingParams, w: &FieldWindow) {
        if self.unit == 0.0 {
            self.start(w.field);
        }
        (self.unseen_s, self.unseen_rad2) = (0.0, 0.0);
        self.predict(params, w);
        let expected_rad2 = self.seen_rad2();
        let field = w.field / self.unit;
        let lag = w.lag / self.unit;
        let noise = params.field_noise.powi(2) + (params.rotation_noise_per_rad * w.turned_rad).powi(2);
        if self.disturbed {
            let nis = self.nis_if_clear(w, field, lag, noise);
            self.clear_nis += (nis - self.clear_nis) * (w.duration_s / (params.clear_tau_s + w.duration_s));
        }
        let mut nis = 0.0;
        for i in 0..3 {
            let row = [
                (EARTH + i, 1.0),
                (ROOM + i, 1.0),
                (MAGNET, w.rotation[(i, 0)]),
                (MAGNET + 1, w.rotation[(i, 1)]),
                (MAGNET + 2, w.rotation[(i, 2)]),
                (LAG, lag[i]),
            ];
            nis += self.observe(&row, field[i], noise);
        }
        if w.at_rest {
            self.observe(&[(RATE, 1.0)], 0.0, params.drift_rate_rest_rad_s.powi(2));
        }
        // The field takes off the same share of an error that is not counted.
        let left = (self.seen_rad2() / expected_rad2.max(1e-12)).min(1.0);
        self.biased_rad = left * (self.biased_rad + w.bias_sigma_rad_s * w.duration_s);
        self.watch(params, nis, w.duration_s);
        if libm::hypot(self.x[EARTH], self.x[EARTH + 1]) > 0.02 {
            self.offset_rad = libm::atan2(self.x[EARTH], self.x[EARTH + 1]);
        }
    }

    fn predict(&mut self, params: &HeadingParams, w: &FieldWindow) {
        let t = w.duration_s;
        let (x, p) = (&mut self.x, &mut self.p);
        if self.disturbed {
            let keep = libm::exp(-t / params.room_memory_s);
            for i in ROOM..MAGNET {
                x[i] *= keep;
                for j in 0..STATES {
                    p[(i, j)] *= keep;
                }
                for j in 0..STATES {
                    p[(j, i)] *= keep;
                }
                p[(i, i)] += params.room_sigma.powi(2) * (1.0 - keep * keep);
            }
        }
        let keep = libm::exp(-t / params.drift_rate_tau_s);
        x[RATE] *= keep;
        for j in 0..STATES {
            p[(RATE, j)] *= keep;
        }
        for j in 0..STATES {
            p[(j, RATE)] *= keep;
        }
        p[(RATE, RATE)] += params.drift_rate_sigma_rad_s.powi(2) * (1.0 - keep * keep);
        let (ex, ey, rate) = (x[EARTH], x[EARTH + 1], x[RATE]);
        x[EARTH] -= t * rate * ey;
        x[EARTH + 1] += t * rate * ex;
        for (to, factor) in [(EARTH, -t * ey), (EARTH + 1, t * ex)] {
            for j in 0..STATES {
                p[(j, to)] += factor * p[(j, RATE)];
            }
            for j in 0..STATES {
                p[(to, j)] += factor * p[(RATE, j)];
            }
        }
        // A heading drift turns the earth's field about the vertical.
        let q = drift_rad2(params, t, w.turned_rad) + w.bridged_rad2;
        p[(EARTH, EARTH)] += q * ey * ey;
        p[(EARTH, EARTH + 1)] -= q * ex * ey;
        p[(EARTH + 1, EARTH)] -= q * ex * ey;
        p[(EARTH + 1, EARTH + 1)] += q * ex * ex;
        for i in 0..3 {
            p[(EARTH + i, EARTH + i)] += params.earth_walk_per_sqrt_s.powi(2) * t;
            p[(MAGNET + i, MAGNET + i)] += params.magnet_walk_per_sqrt_s.powi(2) * t;
        }
        p[(LAG, LAG)] += params.lag_walk_s_per_sqrt_s.powi(2) * t;
    }

    /// One scalar measurement with a sparse row; returns its normalised innovation squared.
    fn observe(&mut self, row: &[(usize, f64)], z: f64, r: f64) -> f64 {
        let mut ph = SVector::<f64, STATES>::zeros();
        let mut innovation = z;
        for &(i, h) in row {
            ph += self.p.column(i) * h;
            innovation -= h * self.x[i];
        }
        let s = r + row.iter().map(|&(i, h)| h * ph[i]).sum::<f64>();
        let gain = ph / s;
        self.x += gain * innovation;
        for j in 0..STATES {
            for k in 0..STATES {
                self.p[(k, j)] -= gain[k] * ph[j];
            }
        }
        innovation * innovation / s
    }

    /// Would the sample be explained by the earth's field and the magnet as they were known before the change?
    /// Normalised, 3 degrees of freedom. What the magnet has become since says nothing: made uncertain, it
    /// explains any field of a sensor that hardly turns.
    fn nis_if_clear(&self, w: &FieldWindow, field: Vector3<f64>, lag: Vector3<f64>, noise: f64) -> f64 {
        let (magnet, covariance) = &self.calm;
        let expected = w.rotation * magnet;
        let spread = w.rotation * covariance * w.rotation.transpose();
        let mut nis = 0.0;
        for i in 0..3 {
            let row = [(EARTH + i, 1.0), (LAG, lag[i])];
            let mut innovation = field[i] - expected[i];
            let mut s = noise + spread[(i, i)];
            for &(j, h) in &row {
                innovation -= h * self.x[j];
                for &(k, g) in &row {
                    s += h * self.p[(j, k)] * g;
                }
            }
            nis += innovation * innovation / s;
        }
        nis
    }

    /// Whether the room's disturbance is known to be nothing: the turning has shown that all of it sits on the sensor.
    fn all_on_sensor(&self, params: &HeadingParams) -> bool {
        let room = self.x.fixed_rows::<3>(ROOM);
        let p = self.p.fixed_view::<3, 3>(ROOM, ROOM);
        let known = p.trace() < 3.0 * params.room_known.powi(2);
        known && p.cholesky().is_some_and(|factor| room.dot(&factor.solve(&room)) < params.clear_nis)
    }

    /// Watches the innovations; a run of large ones means that the field has changed.
    fn watch(&mut self, params: &HeadingParams, nis: f64, t: f64) {
        self.nis += (nis - self.nis) * (t / (params.jump_tau_s + t));
        if self.nis > params.jump_nis {
            if !self.disturbed {
                let covariance = self.p.fixed_view::<3, 3>(MAGNET, MAGNET).into_owned();
                self.calm = (self.x.fixed_rows::<3>(MAGNET).into_owned(), covariance);
            }
            self.nis = 0.0;
            self.disturbed = true;
            self.clear_nis = 100.0;
            for i in ROOM..LAG {
                self.p[(i, i)] += params.jump_sigma.powi(2);
            }
        } else if self.disturbed && self.clear_nis < params.clear_nis {
            self.disturbed = false;
            self.forget(ROOM..LAG);
            self.x.fixed_rows_mut::<3>(MAGNET).copy_from(&self.calm.0);
            self.p.fixed_view_mut::<3, 3>(MAGNET, MAGNET).copy_from(&self.calm.1);
        } else if self.disturbed && self.all_on_sensor(params) {
            self.disturbed = false;
            self.forget(ROOM..MAGNET);
        }
    }

    /// Makes states zero and certain.
    fn forget(&mut self, states: std::ops::Range<usize>) {
        for i in states {
            self.x[i] = 0.0;
            self.p.row_mut(i).fill(0.0);
            self.p.column_mut(i).fill(0.0);
        }
    }
}

/// What noise and scale of the gyro add to the heading's variance, rad².
fn drift_rad2(params: &HeadingParams, duration_s: f64, turned_rad: f64) -> f64 {
    params.drift_rad_per_sqrt_s.powi(2) * duration_s + (params.drift_scale * turned_rad).powi(2)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::consistency;
    use posed_geometry::so3;

    /// Fifty runs in which the field, the magnet, the lag and the gyro's drift are as the filter assumes.
    #[test]
    fn it_is_consistent_in_a_matched_model() {
        const WINDOWS: usize = 200;
        // The room's disturbance is certainly none: eight states are left.
        let others = [0, 1, 2, 6, 7, 8, 9, 10];
        let params = HeadingParams::default();
        // 95 % of chi squared with 400 degrees of freedom, over 50.
        let inside = consistency(50, &(6.93..9.15), |mut random| {
            let mut filter = Heading::new(&params);
            filter.unit = 1.0;
            filter.x[EARTH + 1] = 0.4;
            filter.x[EARTH + 2] = -0.9;
            for i in EARTH..ROOM {
                filter.p[(i, i)] = 0.01;
            }
            let mut truth = filter.clone();
            truth.x += SVector::from_fn(|i, _| filter.p[(i, i)].sqrt() * random.normal());
            let window = |k: usize| {
                let turned = so3::exp(&Vector3::new(libm::sin(0.05 * k as f64), 0.03 * k as f64, 0.4));
                let mut w = FieldWindow {
                    duration_s: 0.03,
                    field: Vector3::zeros(),
                    lag: Vector3::new(0.3, -0.2, 0.1),
                    rotation: turned.to_rotation_matrix().into_inner(),
                    turned_rad: 0.03,
                    bridged_rad2: 0.0,
                    bias_sigma_rad_s: 0.0,
                    at_rest: false,
                };
                // One step's noise from the filter's own Q at the truth.
                let mut step = truth.clone();
                step.p.fill(0.0);
                step.predict(&params, &w);
                let root = (step.p + SMatrix::identity() * 1e-24).cholesky().unwrap().l();
                truth.x = step.x + root * SVector::from_fn(|_, _| random.normal());
                let variance =
                    params.field_noise.powi(2) + (params.rotation_noise_per_rad * w.turned_rad).powi(2);
                let part = |at: usize| truth.x.fixed_rows::<3>(at).into_owned();
                w.field = part(EARTH)
                    + w.rotation * part(MAGNET)
                    + w.lag * truth.x[LAG]
                    + Vector3::from_fn(|_, _| variance.sqrt() * random.normal());
                filter.update(&params, &w);
                assert!(!filter.disturbed, "a jump in window {k}");
                let e = SVector::<f64, 8>::from_fn(|i, _| truth.x[others[i]] - filter.x[others[i]]);
                let p = SMatrix::<f64, 8, 8>::from_fn(|i, j| filter.p[(others[i], others[j])]);
                e.dot(&p.cholesky().unwrap().solve(&e))
            };
            (0..WINDOWS).map(window).collect()
        });
        assert!(inside >= 0.9, "{inside}");
    }
}
