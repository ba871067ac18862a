//! One axis of the room: where the pelvis's sensor is, how fast it goes, and where the feet stand.
//!
//! In: the sensor's acceleration, and where a point of a foot that stands is from the sensor. Out: the state with its covariance. It knows no other axis.

use nalgebra::{SMatrix, SVector};
use posed_state::Plain;

/// Of the acceleration: white noise, m/s² per root hertz, and what tilt and bias leave for a while, m/s², and how long, s.
const NOISE_M_S2: f64 = 0.05;
const LASTING_M_S2: f64 = 0.15;
const LASTING_S: f64 = 20.0;
/// And what a tilt and a scale that are a fiftieth wrong for a tenth of a second at a time make of the acceleration itself, per root hertz: 0.02 sqrt(0.1 s).
const SHAKEN: f64 = 0.006;
/// Without an acceleration the velocity changes at random by so much, m/s² per root hertz.
const COASTING_M_S2: f64 = 1.0;
/// What is known of the velocity at first, m/s.
const START_M_S: f64 = 1.0;

/// Position and velocity of the pelvis's sensor, lasting error of its acceleration, and a foothold for each of two points of both feet.
const STATES: usize = 7;
pub(super) const POSITION: usize = 0;
pub(super) const VELOCITY: usize = 1;
const ERROR: usize = 2;
/// Of which the first so many move; footholds stay.
const MOVING: usize = 3;

/// The foothold of a point (0 or 1) of the right (0) or left (1) foot.
pub(super) fn foothold(side: usize, point: usize) -> usize {
    MOVING + 2 * side + point
}

/// The filter of one axis.
#[derive(Clone, Copy, Debug, PartialEq, Plain)]
pub(super) struct Axis {
    state: SVector<f64, STATES>,
    covariance: SMatrix<f64, STATES, STATES>,
}

impl Axis {
    pub(super) fn new(at_m: f64) -> Self {
        let mut state = SVector::zeros();
        state[POSITION] = at_m;
        let sigmas = SVector::from([1e-3, START_M_S, LASTING_M_S2, 1.0, 1.0, 1.0, 1.0]);
        Self { state, covariance: SMatrix::from_diagonal(&sigmas.component_mul(&sigmas)) }
    }

    pub(super) fn value(&self, state: usize) -> f64 {
        self.state[state]
    }

    pub(super) fn variance(&self, state: usize) -> f64 {
        self.covariance[(state, state)]
    }

    /// Goes on by this acceleration along the axis, m/s², of which the whole vector has that norm; without one as fast as before.
    pub(super) fn predict(&mut self, accel_m_s2: Option<(f64, f64)>, dt_s: f64) {
        let (used, noise_m_s2) = match accel_m_s2 {
            Some((accel_m_s2, whole_m_s2)) => {
                (accel_m_s2 - self.state[ERROR], libm::hypot(NOISE_M_S2, SHAKEN * whole_m_s2))
            }
            None => (0.0, COASTING_M_S2),
        };
        self.state[POSITION] += dt_s * (self.state[VELOCITY] + 0.5 * dt_s * used);
        self.state[VELOCITY] += dt_s * used;
        let keep = 1.0 - (dt_s / LASTING_S).min(1.0);
        self.state[ERROR] *= keep;
        let mut f = SMatrix::<f64, MOVING, MOVING>::identity();
        f[(POSITION, VELOCITY)] = dt_s;
        if accel_m_s2.is_some() {
            f[(POSITION, ERROR)] = -0.5 * dt_s * dt_s;
            f[(VELOCITY, ERROR)] = -dt_s;
        }
        f[(ERROR, ERROR)] = keep;
        // Footholds stay: their own block is as before.
        let moving = f * self.covariance.fixed_rows::<MOVING>(0);
        self.covariance.fixed_rows_mut::<MOVING>(0).copy_from(&moving);
        let moving = self.covariance.fixed_columns::<MOVING>(0) * f.transpose();
        self.covariance.fixed_columns_mut::<MOVING>(0).copy_from(&moving);
        self.covariance[(VELOCITY, VELOCITY)] += noise_m_s2 * noise_m_s2 * dt_s;
        self.covariance[(ERROR, ERROR)] += LASTING_M_S2 * LASTING_M_S2 * (1.0 - keep * keep);
    }

    /// A foothold begins, so far from the pelvis's sensor, m, known to `variance_m2` from there.
    pub(super) fn begin(&mut self, foothold: usize, from_sensor_m: f64, variance_m2: f64) {
        self.state[foothold] = self.state[POSITION] + from_sensor_m;
        let row = self.covariance.row(POSITION).clone_owned();
        self.covariance.set_row(foothold, &row);
        self.covariance.set_column(foothold, &row.transpose());
        self.covariance[(foothold, foothold)] = row[POSITION] + variance_m2;
    }

    /// The foothold is this far from the pelvis's sensor, m.
    pub(super) fn hold(&mut self, foothold: usize, from_sensor_m: f64, noise_m2: f64) {
        let mut h = SVector::<f64, STATES>::zeros();
        (h[foothold], h[POSITION]) = (1.0, -1.0);
        self.update(&h, from_sensor_m, noise_m2);
    }

    /// A state is this.
    pub(super) fn observe(&mut self, state: usize, value: f64, variance: f64) {
        let mut h = SVector::<f64, STATES>::zeros();
        h[state] = 1.0;
        self.update(&h, value, variance);
    }

    /// A state is known less well than was thought, by this variance.
    pub(super) fn doubt(&mut self, state: usize, variance: f64) {
        self.covariance[(state, state)] += variance;
    }

    /// Body and footholds are elsewhere in the room, by so much, m.
    pub(super) fn shift(&mut self, by_m: f64) {
        self.state[POSITION] += by_m;
        (MOVING..STATES).for_each(|foothold| self.state[foothold] += by_m);
    }

    fn update(&mut self, h: &SVector<f64, STATES>, measured: f64, noise: f64) {
        let cross = self.covariance * h;
        let variance = h.dot(&cross) + noise;
        let gain = cross / variance;
        self.state += gain * (measured - h.dot(&self.state));
        self.covariance -= gain * cross.transpose();
        // Exactly symmetric, whatever was rounded.
        self.covariance = (self.covariance + self.covariance.transpose()) * 0.5;
    }
}

/// Turns velocity, acceleration's error and footholds of both level axes about the pelvis's sensor, so far to the left, rad; how well they are known is alike along
/// both.
pub(super) fn turn([x, y]: [&mut Axis; 2], by_rad: f64) {
    let (s, c) = libm::sincos(by_rad);
    for state in VELOCITY..STATES {
        let from = if state < MOVING { [0.0; 2] } else { [x.state[POSITION], y.state[POSITION]] };
        let [along, left] = [x.state[state] - from[0], y.state[state] - from[1]];
        (x.state[state], y.state[state]) = (from[0] + c * along - s * left, from[1] + s * along + c * left);
    }
}
