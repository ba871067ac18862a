//! The filter's algebra against numeric differences, and its honesty in a matched model.

use nalgebra::{Matrix6, Vector6};

use super::super::testing::Random;
use super::*;

const NOISE: TrackerNoise = TrackerNoise { r0_m: 1.0, sigma_radial_m: 2e-4, sigma_rotation_rad: 2e-3 };

fn propagate(
    orientation: &UnitQuaternion<f64>,
    w: &Vector3<f64>,
    error: &Vector6<f64>,
    dt: f64,
) -> (UnitQuaternion<f64>, Vector3<f64>) {
    let turned = orientation * so3::exp(&error.fixed_rows::<3>(0).into_owned());
    let angular_velocity_rad_s = w + error.fixed_rows::<3>(3);
    (turned * so3::exp(&(angular_velocity_rad_s * dt)), angular_velocity_rad_s)
}

#[test]
fn the_rotation_transition_is_the_derivative_of_the_motion() {
    let orientation = so3::exp(&Vector3::new(0.4, -1.0, 0.3));
    let dt = 0.05;
    for w in [Vector3::zeros(), Vector3::new(3.0, -7.0, 12.0)] {
        let analytic = rotation_transition(&w, dt);
        let step = 1e-5;
        for column in 0..6 {
            let mut error = Vector6::zeros();
            error[column] = step;
            let (plus, velocity_plus) = propagate(&orientation, &w, &error, dt);
            let (minus, velocity_minus) = propagate(&orientation, &w, &-error, dt);
            let by_rotation = so3::log(&(minus.inverse() * plus)) / (2.0 * step);
            let by_angular_velocity = (velocity_plus - velocity_minus) / (2.0 * step);
            assert!((analytic.fixed_view::<3, 1>(0, column) - by_rotation).norm() < 1e-7);
            assert!((analytic.fixed_view::<3, 1>(3, column) - by_angular_velocity).norm() < 1e-7);
        }
    }
}

#[test]
fn a_prediction_in_two_steps_is_that_in_one() {
    let pose = MeasuredPose {
        position_m: Some(Vector3::new(0.5, 0.1, 0.2)),
        orientation: Some(so3::exp(&Vector3::new(0.1, 0.2, 0.3))),
    };
    let tuning = Tuning::default();
    let mut track = Track::new(Timestamp::ZERO, &pose, &NOISE, &tuning);
    track.velocity_m_s = Vector3::new(1.0, -2.0, 0.5);
    track.angular_velocity_rad_s = Vector3::new(2.0, 5.0, -3.0);
    let end = Timestamp::from_secs_f64(0.02);
    let once = track.predicted(end, &tuning);
    let twice = track.predicted(Timestamp::from_secs_f64(0.01), &tuning).predicted(end, &tuning);
    assert!((once.position_m - twice.position_m).norm() < 1e-12);
    assert!(once.orientation.angle_to(&twice.orientation) < 1e-7);
    assert!((once.translation.matrix() - twice.translation.matrix()).norm() < 1e-9);
    assert_eq!(track.predicted(Timestamp::ZERO, &tuning), track);
    let back = once.predicted(Timestamp::ZERO, &tuning);
    assert!((back.position_m - track.position_m).norm() < 1e-12);
    assert!(back.orientation.angle_to(&track.orientation) < 1e-7);
}

/// Normalised estimation error squared over 200 runs of motion and noise exactly as the filter believes.
#[test]
fn the_errors_are_as_large_as_the_covariance_says() {
    let (a, alpha) = (20.0, 100.0);
    let tuning = Tuning {
        acceleration_m_s2: [a, a],
        angular_acceleration_rad_s2: [alpha, alpha],
        noise_scale_max: 1.0,
        ..Tuning::default()
    };
    let (runs, steps, dt) = (200, 100, tuning.interval_s);
    let (mut translation, mut rotation) = (0.0, 0.0);
    for run in 0..runs {
        let mut random = Random::new(100 + run);
        // Far enough out that the place hardly changes the noise, which the filter takes at its own position.
        let mut p = Vector3::new(0.9, 0.3, -0.2);
        let mut v = random.vector() * tuning.velocity_m_s;
        let mut q = so3::exp(&random.vector());
        let mut w = random.vector() * tuning.angular_velocity_rad_s;
        let measure = |p: &Vector3<f64>, q: &UnitQuaternion<f64>, random: &mut Random| {
            let position = NOISE.position_m2(p).cholesky().unwrap().l() * random.vector();
            let rotation_vector_rad = NOISE.rotation_rad2(Some(p)).cholesky().unwrap().l() * random.vector();
            MeasuredPose {
                position_m: Some(p + position),
                orientation: Some(q * so3::exp(&rotation_vector_rad)),
            }
        };
        let mut track = Track::new(Timestamp::ZERO, &measure(&p, &q, &mut random), &NOISE, &tuning);
        for step in 1..=steps {
            // White acceleration of density a^2 dt over one interval, drawn exactly.
            let mut driven = |sigma: f64| {
                let (n1, n2) = (random.vector(), random.vector());
                let density = (sigma * sigma * dt).sqrt();
                let velocity = n1 * (density * dt.sqrt());
                let drift = velocity * (0.5 * dt) + n2 * (density * (dt.powi(3) / 12.0).sqrt());
                (drift, velocity)
            };
            let (dp, dv) = driven(a);
            p += v * dt + dp;
            v += dv;
            let (dq, dw) = driven(alpha);
            q *= so3::exp(&(w * dt + dq));
            w += dw;
            let t = Timestamp::from_secs_f64(step as f64 * dt);
            track = track.predicted(t, &tuning);
            track.update(&measure(&p, &q, &mut random), &NOISE, &tuning);
        }
        let mut e = Vector6::zeros();
        e.fixed_rows_mut::<3>(0).copy_from(&(p - track.position_m));
        e.fixed_rows_mut::<3>(3).copy_from(&(v - track.velocity_m_s));
        translation += nees(track.translation.matrix(), &e);
        e.fixed_rows_mut::<3>(0).copy_from(&so3::log(&(track.orientation.inverse() * q)));
        e.fixed_rows_mut::<3>(3).copy_from(&(w - track.angular_velocity_rad_s));
        rotation += nees(track.rotation.matrix(), &e);
    }
    // 95 % of chi-square with 1200 degrees of freedom, which these runs add up to.
    for (name, sum) in [("translation", translation), ("rotation", rotation)] {
        assert!((1105.9..1297.9).contains(&sum), "{name}: mean NEES {}", sum / 200.0);
    }
}

fn nees(covariance: &Matrix6<f64>, error: &Vector6<f64>) -> f64 {
    error.dot(&covariance.cholesky().unwrap().solve(error))
}
