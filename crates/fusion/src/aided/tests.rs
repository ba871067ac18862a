use super::*;
use crate::testing::Random;

type V3 = Vector3<f64>;

impl State {
    /// The error state by which this one differs from another.
    fn minus(&self, other: &Self) -> SVector<f64, N> {
        let mut dx = SVector::<f64, N>::zeros();
        let mut put = |at: usize, part: V3| dx.fixed_rows_mut::<3>(at).copy_from(&part);
        put(P, self.position_m - other.position_m);
        put(V, self.velocity_m_s - other.velocity_m_s);
        put(R, log(&(other.q.inverse() * self.q)));
        put(BG, self.gyro_bias - other.gyro_bias);
        put(BA, self.accel_bias - other.accel_bias);
        dx
    }
}

fn truth(t: f64) -> Isometry3<f64> {
    let rotation_vector_rad =
        V3::new(0.9 * libm::sin(1.9 * t), 0.7 * libm::cos(1.3 * t + 0.4), 0.9 * libm::sin(2.7 * t));
    let position_m =
        V3::new(0.3 * libm::sin(1.1 * t), 0.2 * libm::cos(1.7 * t), 1.0 + 0.15 * libm::sin(2.3 * t));
    Isometry3::from_parts(position_m.into(), exp(&rotation_vector_rad))
}

/// Runs a filter over seconds of simulated truth; magnetic poses at 50 Hz come 40 ms late.
struct Scene {
    filter: Aided,
    random: Random,
    gyro_bias: V3,
    accel_bias: V3,
    step: u32,
}

const SIGMA_M: f64 = 0.002;
const SIGMA_RAD: f64 = 0.01;

impl Scene {
    fn new(seed: u64) -> Self {
        let params = AidedParams {
            lever_m: V3::new(0.02, -0.01, 0.03),
            q_imu_sensor: exp(&V3::new(0.4, -0.9, 0.2)),
            ..AidedParams::default()
        };
        let mut random = Random::new(seed);
        let (gyro_bias, accel_bias) = (random.vector() * 0.01, random.vector() * 0.1);
        Self { filter: Aided::new(params), random, gyro_bias, accel_bias, step: 0 }
    }

    fn imu(&mut self, t: f64) -> ImuSample {
        let h = 1e-3;
        let (a, b, c) = (truth(t - h), truth(t), truth(t + h));
        let angular_velocity_rad_s = log(&(a.rotation.inverse() * c.rotation)) / (2.0 * h);
        let accel = (a.translation.vector + c.translation.vector - b.translation.vector * 2.0) / (h * h);
        let n = self.filter.params;
        // A density at 100 Hz.
        ImuSample {
            gyro_rad_s: angular_velocity_rad_s
                + self.gyro_bias
                + self.random.vector() * (n.gyro_density_rad_s_per_sqrt_hz * 10.0),
            accel_m_s2: b.rotation.inverse() * (accel + V3::z() * GRAVITY_M_S2)
                + self.accel_bias
                + self.random.vector() * (n.accel_density_m_s2_per_sqrt_hz * 10.0),
            mag: None,
        }
    }

    fn pose(&mut self, t: f64) -> MagneticPose {
        let n = self.filter.params;
        let lever = Isometry3::from_parts(n.lever_m.into(), n.q_imu_sensor);
        let mut room_from_sensor = truth(t) * lever;
        room_from_sensor.translation.vector += self.random.vector() * SIGMA_M;
        room_from_sensor.rotation *= exp(&(self.random.vector() * SIGMA_RAD));
        MagneticPose {
            t_s: t,
            room_from_sensor,
            position_cov_m2: Matrix3::identity() * SIGMA_M * SIGMA_M,
            rotation_var_rad2: SIGMA_RAD * SIGMA_RAD,
        }
    }

    /// One step of 10 ms: a sample of the middle of the step, and every second step a late pose if `magnetic`.
    fn next(&mut self, magnetic: bool) -> (f64, Option<Verdict>) {
        self.step += 1;
        let t = 0.01 * f64::from(self.step);
        let sample = self.imu(t - 0.005);
        self.filter.imu(t, &sample);
        if magnetic && self.step.is_multiple_of(2) && self.step > 6 {
            let pose = self.pose(t - 0.04);
            return (t, Some(self.filter.magnetic(&pose)));
        }
        (t, None)
    }

    fn error(&self, t: f64) -> (V3, V3) {
        let state = self.filter.state.as_ref().unwrap();
        let expected = truth(t);
        (expected.translation.vector - state.position_m, log(&(state.q.inverse() * expected.rotation)))
    }
}

#[test]
fn it_is_better_than_the_tracker_alone_and_knows_how_good() {
    const RUNS: u64 = 50;
    let (mut nees, mut position, mut rotation, mut count) = (0.0, 0.0, 0.0, 0.0);
    for run in 0..RUNS {
        let mut scene = Scene::new(2000 + run);
        for k in 0..500 {
            let (t, _) = scene.next(true);
            if k < 300 || k % 20 != 0 {
                continue;
            }
            let (p, r) = scene.error(t);
            let covariance = scene.filter.state.as_ref().unwrap().covariance;
            let mut e = SVector::<f64, 9>::zeros();
            e.fixed_rows_mut::<3>(0).copy_from(&p);
            e.fixed_rows_mut::<3>(3).copy_from(&r);
            let pick = |i: usize| if i < 3 { i } else { R + i - 3 };
            let block = SMatrix::<f64, 6, 6>::from_fn(|i, j| covariance[(pick(i), pick(j))]);
            let e = e.fixed_rows::<6>(0).into_owned();
            nees += e.dot(&block.cholesky().unwrap().solve(&e)) / 6.0;
            position += p.norm_squared() / 3.0;
            rotation += r.norm_squared() / 3.0;
            count += 1.0;
        }
    }
    let (nees, position, rotation) = (nees / count, f64::sqrt(position / count), f64::sqrt(rotation / count));
    assert!((0.7..1.4).contains(&nees), "{nees}");
    assert!(position < 0.6 * SIGMA_M, "{position} m");
    assert!(rotation < 0.4 * SIGMA_RAD, "{rotation} rad");
}

#[test]
fn it_coasts_through_a_dropout_and_then_says_that_it_does_not_know() {
    let mut scene = Scene::new(3);
    for _ in 0..500 {
        scene.next(true);
    }
    let mut last_known = 0;
    for k in 1..=80 {
        let (t, _) = scene.next(false);
        if scene.filter.pose().is_some() {
            last_known = k;
            let (p, r) = scene.error(t);
            assert!(p.norm() < 0.02 && r.norm() < 0.02, "{} m, {} rad after {k}", p.norm(), r.norm());
        }
    }
    assert!((44..=50).contains(&last_known), "{last_known}");
    for _ in 0..6 {
        scene.next(true);
    }
    assert!(scene.filter.pose().is_some());
}

#[test]
fn what_cannot_be_is_gated_and_what_is_no_number_or_too_old_is_refused() {
    let mut scene = Scene::new(8);
    for _ in 0..300 {
        scene.next(true);
    }
    let before = scene.filter.clone();
    let mut mirrored = scene.pose(2.96);
    mirrored.room_from_sensor.translation.vector *= -1.0;
    assert_eq!(scene.filter.magnetic(&mirrored), Verdict::Suspect);
    // Whether a tracker is stuck is not for this filter to decide.
    assert_eq!(scene.filter.magnetic(&mirrored), Verdict::Suspect);
    assert_eq!(scene.filter.state, before.state);
    let mut none = scene.pose(2.96);
    none.room_from_sensor.translation.vector.x = f64::NAN;
    assert_eq!(scene.filter.magnetic(&none), Verdict::Dropped);
    let old = scene.pose(2.0);
    assert_eq!(scene.filter.magnetic(&old), Verdict::Dropped);
    let good = scene.pose(2.97);
    assert_eq!(scene.filter.magnetic(&good), Verdict::Used);
}

#[test]
fn clocks_that_differ_are_tolerated_where_the_offset_is_known() {
    let mut scene = Scene::new(21);
    scene.filter.params.offset_s = 0.02;
    let (mut used, mut gated) = (0, 0);
    for k in 0..600 {
        scene.step += 1;
        let t = 0.01 * f64::from(scene.step);
        let sample = scene.imu(t - 0.005);
        scene.filter.imu(t, &sample);
        if k % 2 == 0 && k > 10 {
            let mut pose = scene.pose(t - 0.03);
            pose.t_s -= 0.02;
            match scene.filter.magnetic(&pose) {
                Verdict::Used => used += 1,
                Verdict::Suspect => gated += 1,
                // Those older than the first one.
                taken => assert!(t < 0.2, "{taken:?} at {t} s"),
            }
        }
    }
    // A gate turns a few good poses away.
    assert!(used > 280 && gated <= 3, "{used} used, {gated} turned away");
    let (p, r) = scene.error(6.0);
    assert!(p.norm() < 2.0 * SIGMA_M && r.norm() < SIGMA_RAD, "{} m, {} rad", p.norm(), r.norm());
}

/// 95 % of the mean of 50 chi squared variables with 15 degrees of freedom.
const MEAN_OF_50: (f64, f64) = (13.52, 16.55);

#[test]
fn in_a_matched_model_all_fifteen_errors_are_as_large_as_it_says() {
    const RUNS: u64 = 50;
    const STEPS: usize = 400;
    let mut sums = vec![0.0; STEPS];
    for run in 0..RUNS {
        let mut scene = Scene::new(2000 + run);
        let params = scene.filter.params;
        let pose = scene.pose(0.0);
        scene.filter.magnetic(&pose);
        // The truth begins where the filter stands, as far off as it says.
        let mut truth = scene.filter.state.clone().unwrap();
        let root = (truth.covariance + SMatrix::<f64, N, N>::identity() * 1e-16).cholesky().unwrap().l();
        let off = root * SVector::<f64, N>::from_fn(|_, _| scene.random.vector().x);
        truth.add(&off);
        for (k, sum) in sums.iter_mut().enumerate() {
            let t = 0.01 * (k + 1) as f64;
            let step = 0.1;
            // What the sensor would say without noise, and what it says.
            let angular_velocity_rad_s =
                V3::new(libm::sin(1.3 * t), libm::cos(2.1 * t), 0.7 * libm::sin(1.7 * t));
            let specific_force_m_s2 = truth.q.inverse()
                * (V3::new(libm::sin(3.0 * t), libm::cos(2.0 * t), libm::sin(2.6 * t)) * 2.0
                    + V3::z() * GRAVITY_M_S2);
            let clean = ImuSample {
                gyro_rad_s: angular_velocity_rad_s + truth.gyro_bias,
                accel_m_s2: specific_force_m_s2 + truth.accel_bias,
                mag: None,
            };
            truth.advance(&params, &clean, t);
            truth.gyro_bias += scene.random.vector() * (params.bias_walks[0] * step);
            truth.accel_bias += scene.random.vector() * (params.bias_walks[1] * step);
            let noisy = ImuSample {
                gyro_rad_s: clean.gyro_rad_s
                    + scene.random.vector() * (params.gyro_density_rad_s_per_sqrt_hz / step),
                accel_m_s2: clean.accel_m_s2
                    + scene.random.vector() * (params.accel_density_m_s2_per_sqrt_hz / step),
                mag: None,
            };
            scene.filter.imu(t, &noisy);
            if k % 2 == 0 {
                let mut room_from_sensor = Isometry3::from_parts(truth.position_m.into(), truth.q)
                    * Isometry3::from_parts(params.lever_m.into(), params.q_imu_sensor);
                room_from_sensor.translation.vector += scene.random.vector() * SIGMA_M;
                room_from_sensor.rotation *= exp(&(scene.random.vector() * SIGMA_RAD));
                let pose = MagneticPose { t_s: t, room_from_sensor, ..pose };
                scene.filter.magnetic(&pose);
            }
            let state = scene.filter.state.as_ref().unwrap();
            let e = truth.minus(state);
            *sum += e.dot(&state.covariance.cholesky().unwrap().solve(&e));
        }
    }
    let inside =
        sums.iter().filter(|sum| (MEAN_OF_50.0..MEAN_OF_50.1).contains(&(**sum / RUNS as f64))).count();
    assert!(
        inside * 10 >= STEPS * 9,
        "{inside} of {STEPS} steps inside; mean {}",
        sums.iter().sum::<f64>() / (RUNS as usize * STEPS) as f64
    );
}
