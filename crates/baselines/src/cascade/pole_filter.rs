//! The iterated extended Kalman filter of what a pole shows, and its smoother.
//!
//! State: middle t, direction u, velocity v, rate of u; ten error numbers. The direction is carried with two axes across it and turned
//! by the exponential map. The published filter is [`super::quaternion_filter`].

use nalgebra::{Matrix3, Rotation3, SMatrix, SVector, Vector3};

use posed_field::{FieldNoise, PoleRun, fit_line, side_basis};

use super::pole::{LONGEST_GAP_S, Pole, ROUNDS, STEP_M, Steps, Track};

/// White acceleration of the middle, m/s^2 per root Hz, and of the direction, rad/s^2 per root Hz.
const ACCELERATION: f64 = 0.3;
const TURNING: f64 = 0.6;

type Error = SVector<f64, 10>;
type Covariance = SMatrix<f64, 10, 10>;

/// Where the pole is and how it moves, in the frame of the readings: the transmitter's.
#[derive(Clone, Copy, Debug, PartialEq)]
struct PoleState {
    /// Middle of the pole, m.
    middle_m: Vector3<f64>,
    /// Direction, and two axes across it, as columns of a rotation.
    axes: Matrix3<f64>,
    /// Velocity of the middle, m/s.
    velocity_m_s: Vector3<f64>,
    /// Angular velocity of the direction along the two axes, rad/s.
    angular_velocity_rad_s: [f64; 2],
}

impl PoleState {
    /// Direction of the pole, unit, towards greater offsets.
    fn direction(&self) -> Vector3<f64> {
        self.axes.column(0).into_owned()
    }

    fn pole(&self) -> Pole {
        Pole { origin_m: self.middle_m, along: self.direction() }
    }

    /// Turns the axes so that the direction moves by `a` and `b` along the two axes across it.
    fn rotate(&mut self, a: f64, b: f64) {
        let w = self.axes.column(2) * a - self.axes.column(1) * b;
        self.axes = Rotation3::new(w).matrix() * self.axes;
    }

    fn plus(&self, error: &Error) -> Self {
        let mut state = *self;
        state.middle_m += error.fixed_rows::<3>(0);
        state.rotate(error[3], error[4]);
        state.velocity_m_s += error.fixed_rows::<3>(5);
        state.angular_velocity_rad_s[0] += error[8];
        state.angular_velocity_rad_s[1] += error[9];
        state
    }

    fn minus(&self, other: &Self) -> Error {
        let mut error = Error::zeros();
        error.fixed_rows_mut::<3>(0).copy_from(&(self.middle_m - other.middle_m));
        let seen = other.axes.transpose() * self.direction();
        let sine = libm::hypot(seen.y, seen.z);
        let scale = if sine > 1e-9 { libm::atan2(sine, seen.x) / sine } else { 1.0 };
        error[3] = scale * seen.y;
        error[4] = scale * seen.z;
        error.fixed_rows_mut::<3>(5).copy_from(&(self.velocity_m_s - other.velocity_m_s));
        error[8] = self.angular_velocity_rad_s[0] - other.angular_velocity_rad_s[0];
        error[9] = self.angular_velocity_rad_s[1] - other.angular_velocity_rad_s[1];
        error
    }
}

/// The iterated extended Kalman filter, frame by frame.
#[derive(Clone, Debug)]
struct PoleFilter {
    /// The present estimate.
    state: PoleState,
    covariance: Covariance,
}

impl PoleFilter {
    /// Starts at rest from one frame: positions (transmitter frame, m) and places along the pole (from its middle, m) of at least
    /// three sensors. With fewer the state means nothing.
    fn new(readings: &[(Vector3<f64>, f64)]) -> Self {
        let (points, offsets): (Vec<_>, Vec<_>) = readings.iter().copied().unzip();
        let (middle_m, along) = fit_line(&points, &offsets);
        let side = side_basis(&along);
        let axes = Matrix3::from_columns(&[along, side.column(0).into_owned(), side.column(1).into_owned()]);
        let state =
            PoleState { middle_m, axes, velocity_m_s: Vector3::zeros(), angular_velocity_rad_s: [0.0; 2] };
        let mut covariance = Covariance::identity();
        covariance.fixed_view_mut::<5, 5>(0, 0).fill_diagonal(0.01);
        Self { state, covariance }
    }

    /// Moves on by `dt_s`; returns the transition.
    fn predict(&mut self, dt_s: f64) -> Covariance {
        let state = &mut self.state;
        state.middle_m += state.velocity_m_s * dt_s;
        state.rotate(state.angular_velocity_rad_s[0] * dt_s, state.angular_velocity_rad_s[1] * dt_s);
        let mut transition = Covariance::identity();
        for k in 0..5 {
            transition[(k, 5 + k)] = dt_s;
        }
        let mut noise = Covariance::zeros();
        for k in 0..5 {
            let density = if k < 3 { ACCELERATION * ACCELERATION } else { TURNING * TURNING };
            noise[(k, k)] = density * dt_s.powi(3) / 3.0;
            noise[(k, 5 + k)] = density * dt_s * dt_s / 2.0;
            noise[(5 + k, k)] = noise[(k, 5 + k)];
            noise[(5 + k, 5 + k)] = density * dt_s;
        }
        self.covariance = transition * self.covariance * transition.transpose() + noise;
        transition
    }

    /// Takes in the readings of one frame, as for [`PoleFilter::new`], at the time of the state, five iterations at most; `noise`
    /// is that of a reading. A covariance that cannot be inverted leaves the state as it is.
    fn update(&mut self, readings: &[(Vector3<f64>, f64)], noise: &FieldNoise, steps: &mut Steps) {
        let Some(prior) = self.covariance.try_inverse() else { return };
        let predicted = self.state;
        let mut state = predicted;
        let mut information = prior;
        for round in 0..ROUNDS {
            information = prior;
            let mut gradient = prior * predicted.minus(&state);
            for (z, offset) in readings {
                let whitener = noise.whitener(z);
                let mut h = SMatrix::<f64, 3, 10>::zeros();
                h.fixed_view_mut::<3, 3>(0, 0).copy_from(&whitener);
                h.fixed_view_mut::<3, 2>(0, 3)
                    .copy_from(&(whitener * state.axes.fixed_columns::<2>(1) * *offset));
                information += h.transpose() * h;
                gradient += h.transpose() * (whitener * (z - state.pole().position_m(*offset)));
            }
            let Some(solver) = information.cholesky() else { return };
            let step = solver.solve(&gradient);
            let before = state.pole();
            state = state.plus(&step);
            if steps.push(round, &before, &state.pole(), readings) < STEP_M {
                break;
            }
        }
        if let Some(covariance) = information.try_inverse() {
            self.covariance = (covariance + covariance.transpose()) * 0.5;
            self.state = state;
        }
    }
}

/// One frame of the forward pass.
struct Step {
    predicted: PoleState,
    predicted_covariance: Covariance,
    filtered: PoleState,
    filtered_covariance: Covariance,
    transition: Covariance,
}

/// Filters a recording and smooths it backwards (Rauch, Tung and Striebel); `map` corrects the readings (transmitter frame, m)
/// first. It is not causal; over a gap of 0.5 s or more the filter starts anew and nothing is handed back.
pub(super) fn smooth(
    run: &PoleRun,
    noise: &FieldNoise,
    map: impl Fn(&Vector3<f64>) -> Vector3<f64>,
) -> Track {
    let mut converged = Steps::default();
    let mut steps: Vec<Option<Step>> = Vec::with_capacity(run.frames.len());
    let mut filter: Option<(f64, PoleFilter)> = None;
    let mut row = Vec::new();
    for frame in &run.frames {
        run.row(frame, &mut row);
        if row.len() < 3 {
            steps.push(None);
            continue;
        }
        row.iter_mut().for_each(|(z, _)| *z = map(z));
        let (mut next, transition) = match filter.take() {
            Some((t_s, mut filter)) if (0.0..LONGEST_GAP_S).contains(&(frame.t_s - t_s)) => {
                let transition = filter.predict(frame.t_s - t_s);
                (filter, transition)
            }
            // Nothing is handed back over a break.
            _ => (PoleFilter::new(&row), Covariance::zeros()),
        };
        let (predicted, predicted_covariance) = (next.state, next.covariance);
        next.update(&row, noise, &mut converged);
        steps.push(Some(Step {
            predicted,
            predicted_covariance,
            filtered: next.state,
            filtered_covariance: next.covariance,
            transition,
        }));
        filter = Some((frame.t_s, next));
    }
    let mut poles: Vec<Option<Pole>> = vec![None; steps.len()];
    let mut after: Option<(PoleState, &Step)> = None;
    for (index, step) in steps.iter().enumerate().rev() {
        let Some(step) = step else { continue };
        let mut state = step.filtered;
        if let Some((later, next)) = &after
            && let Some(inverse) = next.predicted_covariance.try_inverse()
        {
            let gain = step.filtered_covariance * next.transition.transpose() * inverse;
            state = state.plus(&(gain * later.minus(&next.predicted)));
        }
        poles[index] = Some(state.pole());
        after = Some((state, step));
    }
    Track { poles, steps: converged }
}

#[cfg(test)]
mod tests {
    use super::super::testing::truth;
    use super::*;

    #[test]
    fn the_error_algebra_is_consistent() {
        let (middle, direction) = truth(0.3);
        let filter = PoleFilter::new(&[(middle - direction, -1.0), (middle, 0.0), (middle + direction, 1.0)]);
        let error = Error::from_fn(|k, _| 0.01 * (k as f64 - 4.0));
        assert!((filter.state.plus(&error).minus(&filter.state) - error).norm() < 1e-9);
    }
}
