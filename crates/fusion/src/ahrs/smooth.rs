//! The orientations of a whole recording, each from all of it.
//!
//! In: samples of one sensor with the time since the one before. Out: sensor to a level frame at every sample, without a
//! magnetometer. The filter runs forward; then Rauch, Tung and Striebel's smoother goes back over its windows and corrects tilt and
//! gyro bias by what came later. What the bias turns out to have been corrects the heading's drift too.

use nalgebra::{SMatrix, SVector, UnitQuaternion, Vector3};

use super::inclination::{BIAS, Inclination, STATES, TILT};
use super::{Ahrs, ImuSample, Params};

/// What the smoother needs of one window.
struct Step {
    /// Index behind the window's last sample.
    end: usize,
    /// State and covariance before the window.
    before: Inclination,
    /// Cross-covariance of the state before and the predicted state, times the predicted covariance's inverse.
    gain: Option<SMatrix<f64, STATES, STATES>>,
    /// Predicted state.
    predicted: SVector<f64, STATES>,
    /// Tilt that the filter applied after it.
    tilt: [f64; 2],
    /// Integral of the rotation's third row, s: what a bias does to the heading.
    rotation_s: Vector3<f64>,
}

/// Sensor to a level frame (z up, heading of the gyro alone, from any start) at every sample of a recording, each from all of
/// it. `samples` holds each sample, and the time since the one before, s; `None` is bridged. A magnetic field is not looked
/// at.
///
/// The filter runs twice, the second time with the gyro bias that the first one found; then Rauch, Tung and Striebel's
/// recursion goes back (1965; `docs/methods/orientation.md`). As many orientations as samples; how accurate:
/// `docs/orientation.md`.
pub fn smoothed(params: &Params, samples: &[(Option<ImuSample>, f64)]) -> Vec<UnitQuaternion<f64>> {
    let mut filter = Ahrs::new(params.clone());
    for (sample, dt_s) in samples {
        match sample {
            Some(sample) => _ = filter.push(&ImuSample { mag: None, ..*sample }, *dt_s),
            None => filter.coast(*dt_s),
        }
    }
    filter.restart();
    let mut steps = Vec::new();
    let mut run = Vec::with_capacity(samples.len());
    for (k, (sample, dt_s)) in samples.iter().enumerate() {
        let Some(sample) = sample else {
            filter.coast(*dt_s);
            run.push(filter.orientation_6d());
            continue;
        };
        let due = filter.advance(&ImuSample { mag: None, ..*sample }, *dt_s);
        // Before the correction, which the smoother spreads over the window.
        run.push(filter.orientation_6d());
        if due {
            let before = filter.inclination.clone();
            let (specific_force, tilt) = filter.close_window();
            let mut predicted = before.clone();
            predicted.predict(&params.inclination, &specific_force);
            let cross = Inclination::transition(&specific_force) * before.p;
            let gain = predicted.p.cholesky().map(|factor| factor.solve(&cross).transpose());
            let rotation_s = specific_force.rotation_s.row(2).transpose();
            steps.push(Step {
                end: k + 1,
                before,
                gain,
                predicted: predicted.x,
                tilt: tilt.into(),
                rotation_s,
            });
        }
    }
    correct(&mut run, &steps, &filter.inclination);
    run
}

/// Corrects the filter's run by what the smoother says; `last` is the filter's state at the end.
fn correct(run: &mut [UnitQuaternion<f64>], steps: &[Step], last: &Inclination) {
    // Smoothed state at the beginning of each window, and at the end of the last; and at the end of each before the tilt was applied.
    let mut states = vec![last.x; steps.len() + 1];
    let mut ends = vec![last.x; steps.len()];
    for (k, step) in steps.iter().enumerate().rev() {
        let mut end = states[k + 1];
        end[TILT] += step.tilt[0];
        end[TILT + 1] += step.tilt[1];
        ends[k] = end;
        states[k] =
            step.before.x + step.gain.map_or_else(SVector::zeros, |gain| gain * (end - step.predicted));
    }
    let tilted = |tilt: [f64; 2], heading: f64| {
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), heading)
            * UnitQuaternion::from_scaled_axis(Vector3::new(tilt[0], tilt[1], 0.0))
    };
    let (mut begin, mut heading) = (0, 0.0);
    for (k, step) in steps.iter().enumerate() {
        let off = states[k].fixed_rows::<3>(BIAS) - step.before.x.fixed_rows::<3>(BIAS);
        let rotation_rad = -step.rotation_s.dot(&off);
        let count = (step.end - begin) as f64;
        for (i, q) in run[begin..step.end].iter_mut().enumerate() {
            let part = (i + 1) as f64 / count;
            let tilt = [TILT, TILT + 1].map(|i| states[k][i] + part * (ends[k][i] - states[k][i]));
            *q = tilted(tilt, heading + part * rotation_rad) * *q;
        }
        heading += rotation_rad;
        begin = step.end;
    }
    let rest = states[steps.len()];
    for q in &mut run[begin..] {
        *q = tilted([rest[TILT], rest[TILT + 1]], heading) * *q;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use posed_geometry::{GRAVITY_M_S2, so3};

    const DT_S: f64 = 0.01;

    type Samples = Vec<(Option<ImuSample>, f64)>;

    /// Two minutes in a hand: samples of a gyro with a bias, and the true orientations.
    fn recording() -> (Samples, Vec<UnitQuaternion<f64>>) {
        let turned = |t: f64| {
            so3::exp(&Vector3::new(
                0.9 * libm::sin(0.8 * t),
                0.7 * libm::sin(1.1 * t),
                1.2 * libm::sin(0.5 * t),
            ))
        };
        let position_m = |t: f64| {
            Vector3::new(0.2 * libm::sin(1.7 * t), 0.15 * libm::cos(2.3 * t), 0.1 * libm::sin(1.3 * t))
        };
        let bias = Vector3::new(0.006, -0.004, 0.005);
        let sample = |k: i32| {
            let (t, h) = (DT_S * f64::from(k), 1e-3);
            let angular_velocity_rad_s = so3::log(&(turned(t - DT_S).inverse() * turned(t))) / DT_S;
            let specific_force_m_s2 = (position_m(t + h) + position_m(t - h) - position_m(t) * 2.0) / (h * h)
                + Vector3::z() * GRAVITY_M_S2;
            let accel_m_s2 = turned(t).inverse() * specific_force_m_s2;
            (Some(ImuSample { gyro_rad_s: angular_velocity_rad_s + bias, accel_m_s2, mag: None }), DT_S)
        };
        ((0..12_000).map(sample).collect(), (0..12_000).map(|k| turned(DT_S * f64::from(k))).collect())
    }

    /// Tilt, rad, root mean square; and by how much the heading drifts in all, rad.
    fn errors(run: &[UnitQuaternion<f64>], truth: &[UnitQuaternion<f64>]) -> (f64, f64) {
        let off: Vec<_> = run.iter().zip(truth).map(|(q, truth)| q * truth.inverse()).collect();
        let squares: f64 =
            off.iter().map(|off| (2.0 * libm::acos(libm::hypot(off.w, off.k).min(1.0))).powi(2)).sum();
        let heading = |off: &UnitQuaternion<f64>| 2.0 * libm::atan2(off.k, off.w);
        let drift = heading(&(off[off.len() - 1] * off[0].inverse()));
        ((squares / off.len() as f64).sqrt(), drift.abs())
    }

    #[test]
    fn what_comes_later_improves_tilt_and_heading() {
        let (samples, truth) = recording();
        let params = Params::default();
        let mut filter = Ahrs::new(params.clone());
        let forward: Vec<_> =
            samples.iter().filter_map(|(sample, dt_s)| Some(filter.push(sample.as_ref()?, *dt_s))).collect();
        let (tilt, drift) = errors(&forward, &truth);
        let (smooth_tilt, smooth_drift) = errors(&smoothed(&params, &samples), &truth);
        assert!(smooth_tilt < 0.5 * tilt, "{smooth_tilt} of {tilt} rad");
        assert!(smooth_drift < 0.5 * drift, "{smooth_drift} of {drift} rad");
    }

    #[test]
    fn missing_samples_are_bridged() {
        let (mut samples, truth) = recording();
        for k in (50..12_000).step_by(100) {
            samples[k].0 = None;
        }
        let run = smoothed(&Params::default(), &samples);
        assert_eq!(run.len(), truth.len());
        assert!(errors(&run, &truth).0 < 1_f64.to_radians());
    }

    /// The matrix that goes back is the one that went forward.
    #[test]
    fn the_transition_is_the_one_that_predicts() {
        let params = Params::default().inclination;
        let specific_force = crate::ahrs::inclination::SpecificForceWindow {
            duration_s: 0.03,
            rotation_s: nalgebra::Matrix3::new(1.0, 0.2, -0.3, -0.1, 1.1, 0.4, 0.3, -0.2, 0.9) * 0.03,
            velocity_m_s: Vector3::new(0.02, -0.01, 0.3),
            shaking: 0.0,
            turned_rad: 0.0,
            bridged_rad2: 0.0,
            has_field: false,
            at_rest: false,
            rest_gyro_rad_s: None,
        };
        let mut state = Inclination::new(&params);
        let f = Inclination::transition(&specific_force);
        let carried = f * state.p * f.transpose();
        state.predict(&params, &specific_force);
        let added = state.p - carried;
        for i in 0..STATES {
            for j in 0..STATES {
                // The noise is diagonal; the terms of second order in the window are left out of the recursion.
                assert!(i == j || added[(i, j)].abs() < 1e-4, "({i}, {j}): {}", added[(i, j)]);
            }
        }
    }
}
