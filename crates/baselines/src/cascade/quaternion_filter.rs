//! The published filter: a quaternion, thirteen states, forward only.
//!
//! State: end of the pole, quaternion from the first direction to the present one, velocity, angular velocity (eqs. 2 to 5),
//! measured by eq. 6. Of the thirteen numbers a pole that turns across its axis shows twelve, one at rest eleven: its spin
//! about itself is never seen, so that its variance grows without end. The quaternion is carried as four numbers, as printed, and brought to
//! unit length after each update, of which the paper says nothing: without that the printed step has the pole a kilometre away after
//! 10 to 45 s.

use nalgebra::{Matrix3, Matrix4, Matrix4x3, SMatrix, SVector, Vector3, Vector4};
use posed_field::{FieldNoise, PoleRun, fit_line};

use super::pole::{LONGEST_GAP_S, Pole, ROUNDS, STEP_M, Steps, Track};

/// White acceleration of the end, m/s^2 per root Hz, and of the rotation, rad/s^2 per root Hz. The paper takes upper bounds of the
/// velocities; these let them come about within a second, so that a filter without a smoother lags by little.
const ACCELERATION: f64 = 1.0;
const TURNING: f64 = 2.0;

/// How far the quaternion is turned in a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Turn {
    /// By the factor 2/|w|, as printed: about twice too far, and longer.
    Printed,
    /// By 1/|w|, which is right.
    Repaired,
}

type State = SVector<f64, 13>;
type Covariance = SMatrix<f64, 13, 13>;

/// Where the quaternion, the velocity and the angular velocity begin.
const Q: usize = 3;
const V: usize = 7;
const W: usize = 10;

/// Left multiplication by (0, w), as printed.
fn rate_matrix(w: &Vector3<f64>) -> Matrix4<f64> {
    Matrix4::new(
        0.0, -w.x, -w.y, -w.z, //
        w.x, 0.0, -w.z, w.y, //
        w.y, w.z, 0.0, -w.x, //
        w.z, -w.y, w.x, 0.0,
    )
}

/// The quaternion's transition over `dt_s` and the derivatives of what it makes of `q` by the angular velocity.
fn transition(turn: Turn, w: &Vector3<f64>, q: &Vector4<f64>, dt_s: f64) -> (Matrix4<f64>, Matrix4x3<f64>) {
    let factor = if turn == Turn::Printed { 2.0 } else { 1.0 };
    let (rate, half) = (w.norm(), 0.5 * dt_s);
    let (sin, cos) = libm::sincos(rate * half);
    // sin(rate half) / rate, and its derivative by the rate, divided by the rate.
    let (share, slope) = if rate > 1e-6 {
        (sin / rate, (half * cos - sin / rate) / (rate * rate))
    } else {
        (half, -half.powi(3) / 3.0)
    };
    let matrix = rate_matrix(w);
    let by_rate = Matrix4x3::from_columns(&std::array::from_fn::<_, 3, _>(|axis| {
        let unit = Vector3::ith(axis, 1.0);
        q * (-half * share * w[axis]) + (matrix * w[axis] * slope + rate_matrix(&unit) * share) * q * factor
    }));
    (Matrix4::identity() * cos + matrix * (factor * share), by_rate)
}

/// `q e q*` for any `q`, and its derivatives.
fn turned(q: &Vector4<f64>, e: &Vector3<f64>) -> (Vector3<f64>, SMatrix<f64, 3, 4>) {
    let (w, v) = (q[0], Vector3::new(q[1], q[2], q[3]));
    let cross = v.cross(e);
    let value = e * (w * w - v.norm_squared()) + v * (2.0 * v.dot(e)) + cross * (2.0 * w);
    let by_v: Matrix3<f64> =
        e * v.transpose() * -2.0 + v * e.transpose() * 2.0 + Matrix3::identity() * (2.0 * v.dot(e))
            - e.cross_matrix() * (2.0 * w);
    let mut derivatives = SMatrix::<f64, 3, 4>::zeros();
    derivatives.set_column(0, &(e * (2.0 * w) + cross * 2.0));
    derivatives.fixed_view_mut::<3, 3>(0, 1).copy_from(&by_v);
    (value, derivatives)
}

/// The filter, frame by frame.
#[derive(Clone, Debug)]
struct QuaternionFilter {
    turn: Turn,
    /// Direction of the pole in its first frame, unit.
    first: Vector3<f64>,
    state: State,
    covariance: Covariance,
}

impl QuaternionFilter {
    /// Starts at rest from one frame: positions (transmitter frame, m) and places along the pole from its end (m).
    fn new(turn: Turn, readings: &[(Vector3<f64>, f64)]) -> Self {
        let (points, offsets): (Vec<_>, Vec<_>) = readings.iter().copied().unzip();
        let (end_m, first) = fit_line(&points, &offsets);
        let mut state = State::zeros();
        state.fixed_rows_mut::<3>(0).copy_from(&end_m);
        state[Q] = 1.0;
        let mut covariance = Covariance::identity();
        covariance.fixed_view_mut::<V, V>(0, 0).fill_diagonal(0.01);
        Self { turn, first, state, covariance }
    }

    fn quaternion(&self) -> Vector4<f64> {
        self.state.fixed_rows::<4>(Q).into_owned()
    }

    fn predict(&mut self, dt_s: f64) {
        let (q, w) = (self.quaternion(), self.state.fixed_rows::<3>(W).into_owned());
        let (by_q, by_w) = transition(self.turn, &w, &q, dt_s);
        let step = self.state.fixed_rows::<3>(V) * dt_s;
        let mut moved = self.state.fixed_rows_mut::<3>(0);
        moved += step;
        self.state.fixed_rows_mut::<4>(Q).copy_from(&(by_q * q));
        let mut transition = Covariance::identity();
        transition.fixed_view_mut::<3, 3>(0, V).fill_diagonal(dt_s);
        transition.fixed_view_mut::<4, 4>(Q, Q).copy_from(&by_q);
        transition.fixed_view_mut::<4, 3>(Q, W).copy_from(&by_w);
        // White accelerations; what they do to the quaternion goes the way of the angular velocity.
        let mut noise = Covariance::zeros();
        let (moving, turning) = (ACCELERATION * ACCELERATION, TURNING * TURNING);
        for k in 0..3 {
            noise[(k, k)] = moving * dt_s.powi(3) / 3.0;
            noise[(k, V + k)] = moving * dt_s * dt_s / 2.0;
            noise[(V + k, k)] = noise[(k, V + k)];
            noise[(V + k, V + k)] = moving * dt_s;
            noise[(W + k, W + k)] = turning * dt_s;
        }
        let across = by_w * (turning * dt_s / 2.0);
        noise.fixed_view_mut::<4, 3>(Q, W).copy_from(&across);
        noise.fixed_view_mut::<3, 4>(W, Q).copy_from(&across.transpose());
        noise.fixed_view_mut::<4, 4>(Q, Q).copy_from(&(by_w * by_w.transpose() * (turning * dt_s / 3.0)));
        self.covariance = transition * self.covariance * transition.transpose() + noise;
    }

    /// Takes in the readings of one frame, in gain form: the variance of the spin may be anything.
    fn update(&mut self, readings: &[(Vector3<f64>, f64)], noise: &FieldNoise, steps: &mut Steps) {
        let predicted = self.state;
        let rows = 3 * readings.len();
        let mut state = predicted;
        let mut gain = None;
        for round in 0..ROUNDS {
            let q = state.fixed_rows::<4>(Q).into_owned();
            let (direction, by_q) = turned(&q, &self.first);
            let mut h = nalgebra::DMatrix::zeros(rows, 13);
            let mut residual = nalgebra::DVector::zeros(rows);
            for (k, (z, offset)) in readings.iter().enumerate() {
                let whitener = noise.whitener(z);
                h.fixed_view_mut::<3, 3>(3 * k, 0).copy_from(&whitener);
                h.fixed_view_mut::<3, 4>(3 * k, Q).copy_from(&(whitener * by_q * *offset));
                let expected = state.fixed_rows::<3>(0) + direction * *offset;
                residual.fixed_rows_mut::<3>(3 * k).copy_from(&(whitener * (z - expected)));
            }
            let across = self.covariance * h.transpose();
            let sum = &h * &across + nalgebra::DMatrix::identity(rows, rows);
            let Some(solver) = sum.cholesky() else { return };
            let k = solver.solve(&across.transpose()).transpose();
            let next = predicted + &k * (residual - &h * (predicted - state));
            let before = self.pole(&state);
            let after = self.pole(&next);
            state = next;
            gain = Some((k, h));
            if steps.push(round, &before, &after, readings) < STEP_M {
                break;
            }
        }
        let Some((k, h)) = gain else { return };
        let covariance = self.covariance - k * (h * self.covariance);
        self.covariance = (covariance + covariance.transpose()) * 0.5;
        let norm = state.fixed_rows::<4>(Q).norm();
        state.fixed_rows_mut::<4>(Q).unscale_mut(norm);
        self.state = state;
    }

    /// The pole of a state, its origin at the end.
    fn pole(&self, state: &State) -> Pole {
        let (along, _) = turned(&state.fixed_rows::<4>(Q).into_owned(), &self.first);
        Pole { origin_m: state.fixed_rows::<3>(0).into_owned(), along }
    }
}

/// Filters a recording whose readings `map` (transmitter frame, m) corrects first. One pole per frame, none where fewer than three sensors
/// were measured; over a gap of 0.5 s or more the filter starts anew.
pub(super) fn follow(
    run: &PoleRun,
    turn: Turn,
    noise: &FieldNoise,
    map: impl Fn(&Vector3<f64>) -> Vector3<f64>,
) -> Track {
    // Eq. 6 counts from 1: the end lies one spacing before the first sensor.
    let end_m = run.offset_m(0) - run.spacing_m;
    let mut track = Track::default();
    let mut filter: Option<(f64, QuaternionFilter)> = None;
    let mut row = Vec::new();
    for frame in &run.frames {
        run.row(frame, &mut row);
        if row.len() < 3 {
            track.poles.push(None);
            continue;
        }
        for (z, offset) in &mut row {
            (*z, *offset) = (map(z), *offset - end_m);
        }
        let mut next = match filter.take() {
            Some((t_s, mut filter)) if (0.0..LONGEST_GAP_S).contains(&(frame.t_s - t_s)) => {
                filter.predict(frame.t_s - t_s);
                filter
            }
            _ => QuaternionFilter::new(turn, &row),
        };
        next.update(&row, noise, &mut track.steps);
        let pole = next.pole(&next.state);
        track.poles.push(Some(Pole { origin_m: pole.origin_m - pole.along * end_m, ..pole }));
        filter = Some((frame.t_s, next));
    }
    track
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_printed_step_turns_twice_too_far_and_stretches() {
        let (w, q) = (Vector3::new(1.2, -0.9, 1.15), Vector4::new(1.0, 0.0, 0.0, 0.0));
        let dt_s = 0.0634 / w.norm();
        let angle = |turn| {
            let q = transition(turn, &w, &q, dt_s).0 * q;
            (2.0 * libm::atan2(q.fixed_rows::<3>(1).norm(), q[0]), q.norm())
        };
        let (repaired, norm) = angle(Turn::Repaired);
        assert!((repaired - 0.0634).abs() < 1e-12 && (norm - 1.0).abs() < 1e-12);
        let (printed, norm) = angle(Turn::Printed);
        assert!((printed - 0.1266).abs() < 1e-4 && norm > 1.001, "{printed}, {norm}");
    }

    #[test]
    fn derivatives_are_differences() {
        let (q, e) = (Vector4::new(0.8, -0.3, 0.4, 0.2), Vector3::new(0.6, 0.0, 0.8));
        let (_, by_q) = turned(&q, &e);
        for k in 0..4 {
            let step = Vector4::ith(k, 1e-6);
            let difference = (turned(&(q + step), &e).0 - turned(&(q - step), &e).0) / 2e-6;
            assert!((by_q.column(k) - difference).norm() < 1e-8);
        }
        for (turn, w) in [Turn::Printed, Turn::Repaired]
            .into_iter()
            .flat_map(|turn| [Vector3::new(0.7, -1.1, 0.4), Vector3::zeros()].map(|w| (turn, w)))
        {
            let (_, by_w) = transition(turn, &w, &q, 0.03);
            for k in 0..3 {
                let step = Vector3::ith(k, 1e-5);
                let moved = |w: Vector3<f64>| transition(turn, &w, &q, 0.03).0 * q;
                let difference = (moved(w + step) - moved(w - step)) / 2e-5;
                assert!((by_w.column(k) - difference).norm() < 1e-8, "{turn:?} {w}");
            }
        }
    }
}
