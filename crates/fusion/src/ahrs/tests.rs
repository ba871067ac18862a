//! Simulated sensors with known truth.

use super::*;
use crate::testing::{Random, consistency};
use posed_geometry::so3;

const RATE_HZ: f64 = 100.0;

/// A sensor whose motion is known: sums of sines for the angular velocity and the acceleration.
struct Simulation {
    time_s: f64,
    truth: UnitQuaternion<f64>,
    seed: u64,
    bias: Vector3<f64>,
    /// Amplitude of the turning, rad/s.
    turning: f64,
    /// Field in the room, µT.
    field: Vector3<f64>,
    /// Field of a magnet on the sensor, µT.
    magnet: Vector3<f64>,
}

impl Simulation {
    fn new(turning: f64) -> Self {
        Self {
            time_s: 0.0,
            truth: so3::exp(&Vector3::new(0.2, -0.1, 0.4)),
            seed: 7,
            bias: Vector3::new(0.5, -0.3, 0.4) * 1_f64.to_radians(),
            turning,
            field: field(0.0, 1.0, 65.0),
            magnet: Vector3::zeros(),
        }
    }

    fn noise(&mut self, sigma: f64) -> Vector3<f64> {
        // Sums of four uniform numbers are Gaussian enough.
        Vector3::from_fn(|_, _| {
            let mut sum = 0.0;
            for _ in 0..4 {
                self.seed = self.seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                sum += (self.seed >> 11) as f64 / (1_u64 << 53) as f64 - 0.5;
            }
            sigma * 3_f64.sqrt() * sum
        })
    }

    fn step(&mut self) -> ImuSample {
        let (t, a) = (self.time_s, self.turning);
        let angular_velocity_rad_s =
            Vector3::new(a * libm::sin(2.1 * t), a * libm::sin(1.3 * t + 1.0), 0.7 * a * libm::cos(0.9 * t));
        self.truth *= so3::exp(&(angular_velocity_rad_s / RATE_HZ));
        let shaking = if a > 0.0 {
            Vector3::new(libm::sin(5.0 * t), libm::cos(6.1 * t), libm::sin(7.0 * t))
        } else {
            Vector3::zeros()
        };
        let back = self.truth.inverse();
        let specific_force_m_s2 = back * (Vector3::z() * GRAVITY_M_S2 + 2.0 * shaking);
        let mag = back * self.field + self.magnet;
        self.time_s += 1.0 / RATE_HZ;
        ImuSample {
            gyro_rad_s: angular_velocity_rad_s + self.bias + self.noise(0.002),
            accel_m_s2: specific_force_m_s2 + self.noise(0.03),
            mag: Some(mag + self.noise(0.5)),
        }
    }
}

fn field(azimuth_deg: f64, norm: f64, dip_deg: f64) -> Vector3<f64> {
    let (azimuth, dip) = (azimuth_deg.to_radians(), dip_deg.to_radians());
    Vector3::new(libm::cos(dip) * libm::sin(azimuth), libm::cos(dip) * libm::cos(azimuth), -libm::sin(dip))
        * (46.0 * norm)
}

fn params() -> Params {
    // The simulated gyro has no low-pass.
    Params { gyro_delay_s: 0.0, ..Params::default() }
}

/// Runs for `seconds` and returns the largest (heading, inclination) error of that time, degrees.
fn run(ahrs: &mut Ahrs, simulation: &mut Simulation, seconds: f64) -> (f64, f64) {
    let mut worst = (0.0_f64, 0.0_f64);
    for _ in 0..(seconds * RATE_HZ) as usize {
        let sample = simulation.step();
        let error = ahrs.push(&sample, 1.0 / RATE_HZ) * simulation.truth.inverse();
        let heading = (2.0 * libm::atan(error.k / error.w)).to_degrees().abs();
        let inclination = (2.0 * libm::acos(libm::hypot(error.w, error.k).min(1.0))).to_degrees();
        worst = (worst.0.max(heading), worst.1.max(inclination));
    }
    worst
}

/// A filter that has rested 10 s and moved 50 s.
fn warmed(turning: f64) -> (Ahrs, Simulation) {
    let (mut ahrs, mut simulation) = (Ahrs::new(params()), Simulation::new(0.0));
    run(&mut ahrs, &mut simulation, 10.0);
    simulation.turning = turning;
    run(&mut ahrs, &mut simulation, 50.0);
    (ahrs, simulation)
}

#[test]
fn a_constant_angular_velocity_is_integrated_exactly() {
    let mut ahrs = Ahrs::new(params());
    let angular_velocity_rad_s = Vector3::new(0.0, 0.0, 1.5);
    let up = Vector3::z() * GRAVITY_M_S2;
    let mut orientation = UnitQuaternion::identity();
    for _ in 0..1000 {
        orientation =
            ahrs.push(&ImuSample { gyro_rad_s: angular_velocity_rad_s, accel_m_s2: up, mag: None }, 0.01);
    }
    let expected = so3::exp(&(angular_velocity_rad_s * 10.0));
    assert!(orientation.angle_to(&expected) < 1e-9, "{}", orientation.angle_to(&expected));
}

#[test]
fn the_step_of_the_strapdown_is_the_exponential() {
    for angular_velocity_rad_s in [1e-6, 0.1, 10.0, 60.0] {
        let angular_velocity_rad_s = Vector3::new(0.6, -0.48, 0.64) * angular_velocity_rad_s;
        let exact = so3::exp(&(angular_velocity_rad_s * 0.01));
        assert!(integrate(UnitQuaternion::identity(), angular_velocity_rad_s, 0.01).angle_to(&exact) < 1e-10);
    }
}

#[test]
fn gravity_rights_a_filter_that_began_in_a_blow() {
    let (mut ahrs, mut simulation) = (Ahrs::new(params()), Simulation::new(0.5));
    let mut blow = simulation.step();
    blow.accel_m_s2 = simulation.truth.inverse() * Vector3::new(6.0, 0.0, 8.0);
    ahrs.push(&blow, 0.01);
    let (_, at_first) = run(&mut ahrs, &mut simulation, 1.0);
    run(&mut ahrs, &mut simulation, 14.0);
    let (_, later) = run(&mut ahrs, &mut simulation, 5.0);
    assert!(at_first > 10.0 && later < 1.0, "{at_first} then {later} degrees");
}

#[test]
fn ten_seconds_of_rest_remove_a_bias() {
    let (mut ahrs, mut simulation) = (Ahrs::new(params()), Simulation::new(0.0));
    run(&mut ahrs, &mut simulation, 10.0);
    assert!(ahrs.at_rest());
    let left = (ahrs.bias_rad_s() - simulation.bias).amax().to_degrees();
    assert!(left < 0.02, "{left} deg/s");
}

#[test]
fn a_rest_proves_the_bias_of_a_unit_that_nobody_calibrated() {
    for mag in [true, false] {
        let (mut ahrs, mut simulation) = (Ahrs::new(params()), Simulation::new(0.0));
        simulation.bias = Vector3::new(3.0, -4.5, 4.0) * 1_f64.to_radians();
        for _ in 0..500 {
            let sample = simulation.step();
            ahrs.push(&ImuSample { mag: sample.mag.filter(|_| mag), ..sample }, 1.0 / RATE_HZ);
        }
        let left = (ahrs.bias_rad_s() - simulation.bias).amax().to_degrees();
        assert!(left < 0.1, "{left} deg/s");
        if mag {
            run(&mut ahrs, &mut simulation, 5.0);
            let (heading, tilt) = run(&mut ahrs, &mut simulation, 10.0);
            assert!(heading < 3.0 && tilt < 1.0, "{heading}, {tilt} degrees");
        }
    }
}

/// A turntable, which turns gravity or the field, is no bias however evenly it turns.
#[test]
fn an_even_rotation_is_no_bias() {
    for axis in [Vector3::z(), Vector3::x()] {
        let (mut ahrs, mut simulation) = (Ahrs::new(params()), Simulation::new(0.0));
        run(&mut ahrs, &mut simulation, 5.0);
        let angular_velocity_rad_s = axis * 5_f64.to_radians();
        for _ in 0..1500 {
            simulation.truth *= so3::exp(&(angular_velocity_rad_s / RATE_HZ));
            let mut sample = simulation.step();
            sample.gyro_rad_s += angular_velocity_rad_s;
            ahrs.push(&sample, 1.0 / RATE_HZ);
        }
        let left = (ahrs.bias_rad_s() - simulation.bias).amax().to_degrees();
        assert!(left < 0.3, "{left} deg/s");
    }
}

/// As slow as a bias may be, and from the first moment on, when nothing is known of the bias.
#[test]
fn a_slow_rotation_is_no_rest() {
    for axis in [Vector3::x(), Vector3::new(1.0, 1.0, 0.0)] {
        let (mut ahrs, mut simulation) = (Ahrs::new(params()), Simulation::new(0.0));
        simulation.bias = Vector3::zeros();
        let angular_velocity_rad_s = axis * 1.6_f64.to_radians();
        let mut most_deg = 0.0_f64;
        for _ in 0..2000 {
            simulation.truth *= so3::exp(&(angular_velocity_rad_s / RATE_HZ));
            let mut sample = simulation.step();
            sample.gyro_rad_s += angular_velocity_rad_s;
            let q = ahrs.push(&sample, 1.0 / RATE_HZ);
            let down = |q: &UnitQuaternion<f64>| q.inverse() * Vector3::z();
            most_deg = most_deg.max(down(&q).angle(&down(&simulation.truth)).to_degrees());
        }
        assert!(most_deg < 2.0, "tilts {most_deg} degrees off");
        // Then it lies still, which is seen.
        run(&mut ahrs, &mut simulation, 4.0);
        assert!(ahrs.at_rest());
    }
}

#[test]
fn motion_alone_reveals_the_bias() {
    let (mut ahrs, mut simulation) = (Ahrs::new(params()), Simulation::new(1.5));
    run(&mut ahrs, &mut simulation, 60.0);
    assert!(!ahrs.at_rest());
    let left = (ahrs.bias_rad_s() - simulation.bias).amax().to_degrees();
    assert!(left < 0.1, "{left} deg/s");
}

#[test]
fn a_disturbed_field_does_not_turn_the_heading() {
    for (azimuth, norm, dip) in [(45.0, 0.86, 49.0), (45.0, 1.0, 65.0)] {
        for turning in [0.5, 1.5] {
            let (mut ahrs, mut simulation) = warmed(turning);
            let (before, _) = run(&mut ahrs, &mut simulation, 10.0);
            simulation.field = field(azimuth, norm, dip);
            let (during, tilt) = run(&mut ahrs, &mut simulation, 30.0);
            assert!(ahrs.magnetic_disturbance());
            simulation.field = field(0.0, 1.0, 65.0);
            let (after, _) = run(&mut ahrs, &mut simulation, 30.0);
            assert!(!ahrs.magnetic_disturbance());
            assert!(during - before < 1.0 && after - before < 1.0, "{before}, {during}, {after} degrees");
            assert!(tilt < 1.0, "the magnetometer tilted it by {tilt} degrees");
        }
    }
}

/// A sensor that hardly turns cannot tell a disturbed room from a magnet on itself, and must not choose one.
#[test]
fn a_disturbance_lasts_for_a_sensor_that_hardly_turns() {
    let (mut ahrs, mut simulation) = warmed(0.1);
    let (before, _) = run(&mut ahrs, &mut simulation, 10.0);
    simulation.field = field(45.0, 0.86, 49.0);
    let (during, _) = run(&mut ahrs, &mut simulation, 30.0);
    assert!(ahrs.magnetic_disturbance());
    simulation.field = field(0.0, 1.0, 65.0);
    let (after, _) = run(&mut ahrs, &mut simulation, 30.0);
    assert!(!ahrs.magnetic_disturbance());
    assert!(during - before < 2.0 && after - before < 2.0, "{before}, {during}, {after} degrees");
}

#[test]
fn a_magnet_on_the_sensor_is_found_and_does_not_turn_the_heading() {
    let (mut ahrs, mut simulation) = warmed(1.0);
    simulation.magnet = Vector3::new(20.0, -10.0, 30.0);
    let (heading, _) = run(&mut ahrs, &mut simulation, 60.0);
    assert!(heading < 2.0, "{heading} degrees");
    let left = (ahrs.magnet() - simulation.magnet).norm();
    assert!(left < 2.0, "{left} µT");
}

#[test]
fn the_unit_of_the_field_does_not_matter() {
    let (mut one, mut other) = (Ahrs::new(params()), Ahrs::new(params()));
    let mut simulation = Simulation::new(1.0);
    for _ in 0..2000 {
        let sample = simulation.step();
        let gauss = ImuSample { mag: sample.mag.map(|m| m * 0.01), ..sample };
        assert!(one.push(&sample, 0.01).angle_to(&other.push(&gauss, 0.01)) < 1e-6);
    }
}

#[test]
fn without_a_magnetometer_only_the_heading_drifts() {
    let (mut ahrs, mut simulation) = (Ahrs::new(params()), Simulation::new(0.0));
    let step = |simulation: &mut Simulation| ImuSample { mag: None, ..simulation.step() };
    let mut worst = 0.0_f64;
    for i in 0..6000 {
        if i == 1000 {
            simulation.turning = 1.0;
        }
        let error = ahrs.push(&step(&mut simulation), 0.01) * simulation.truth.inverse();
        worst = worst.max((2.0 * libm::acos(libm::hypot(error.w, error.k).min(1.0))).to_degrees());
    }
    assert!(worst < 1.0, "{worst} degrees");
}

/// A sensor without a field, at rest for `rest_s`, s, then turned as `turned` says, rad, and moved, m; its bias about the vertical, rad/s.
fn bias_about_up(
    rest_s: f64,
    seconds: f64,
    turned: impl Fn(f64) -> UnitQuaternion<f64>,
    position_m: impl Fn(f64) -> Vector3<f64>,
) -> f64 {
    const H: f64 = 1e-3;
    let mut random = Random::new(3);
    let mut ahrs = Ahrs::new(Params::instantaneous());
    for k in 0..((rest_s + seconds) * RATE_HZ) as usize {
        let t = k as f64 / RATE_HZ - rest_s;
        let (turned, position_m) = (|t: f64| turned(t.max(0.0)), |t: f64| position_m(t.max(0.0)));
        let gyro_rad_s = so3::log(&(turned(t - H).inverse() * turned(t + H))) / (2.0 * H);
        let accel = (position_m(t + H) + position_m(t - H) - position_m(t) * 2.0) / (H * H);
        let accel_m_s2 = turned(t).inverse() * (accel + Vector3::z() * GRAVITY_M_S2);
        let noise = random.vector() * 1e-3;
        ahrs.push(&ImuSample { gyro_rad_s: gyro_rad_s + noise, accel_m_s2, mag: None }, 1.0 / RATE_HZ);
    }
    (ahrs.orientation_6d() * ahrs.bias_rad_s()).z
}

/// From rest into a slow turn, which the detector of rests sees a while later.
#[test]
fn the_slow_beginning_of_a_turn_is_no_bias() {
    let turned = |t: f64| so3::exp(&Vector3::new(0.0, 0.0, 0.004 * t * t * t));
    for rest_s in [20.0, 60.0] {
        let bias = bias_about_up(rest_s, 4.0, turned, |_| Vector3::zeros()).to_degrees();
        assert!(bias.abs() < 0.01, "{bias} degrees/s after {rest_s} s");
    }
}

/// Who walks sways with every step of a leg that swings; a bias about the vertical would show in the same way.
#[test]
fn a_sway_in_step_with_a_swing_is_no_bias() {
    let omega = std::f64::consts::TAU * 0.45;
    let begins = |t: f64| 1.0 - libm::exp(-t * t);
    let turned = |t: f64| so3::exp(&Vector3::new(0.6 * begins(t) * libm::sin(omega * t), 0.0, 0.0));
    let sway = |t: f64| Vector3::x() * (0.2 / omega * begins(t) * libm::cos(omega * t));
    let bias = bias_about_up(20.0, 120.0, turned, sway).to_degrees();
    assert!(bias.abs() < 0.01, "{bias} degrees/s");
}

#[test]
fn numbers_that_are_none_change_nothing_but_a_count() {
    let (mut ahrs, mut simulation) = warmed(1.0);
    let before = ahrs.orientation();
    let good = simulation.step();
    for bad in [
        ImuSample { gyro_rad_s: Vector3::repeat(f64::NAN), ..good },
        ImuSample { accel_m_s2: Vector3::repeat(f64::INFINITY), ..good },
    ] {
        assert_eq!(ahrs.push(&bad, 0.01), before);
    }
    assert_eq!(ahrs.push(&good, f64::NAN), before);
    assert_eq!(ahrs.push(&good, 0.0), before);
    assert_eq!(ahrs.rejected(), 4);
    let no_field = ImuSample { mag: Some(Vector3::repeat(f64::NAN)), ..good };
    assert!(ahrs.push(&no_field, 0.01).coords.iter().all(|v| v.is_finite()));
}

#[test]
fn a_filter_goes_on_from_its_serialised_state() {
    let (mut ahrs, mut simulation) = warmed(1.0);
    let (mut copy, _) = warmed(0.0);
    posed_state::restore(&mut copy, &posed_state::snapshot(&ahrs)).unwrap();
    for _ in 0..500 {
        let sample = simulation.step();
        assert_eq!(ahrs.push(&sample, 0.01), copy.push(&sample, 0.01));
    }
}

/// Every second and a half so many samples of a sensor that moves are lost; `gap` tells the filter, and how long the next
/// sample's step is, s. Error of the bias, degrees/s, and mean of the largest inclination errors of every second, degrees.
fn with_gaps(lost: usize, gap: fn(&mut Ahrs, usize) -> f64) -> (f64, f64) {
    let (mut ahrs, mut simulation) = warmed(2.0);
    let mut sum_deg = 0.0;
    for _ in 0..60 {
        run(&mut ahrs, &mut simulation, 0.5);
        sum_deg += run(&mut ahrs, &mut simulation, 1.0).1;
        (0..lost).for_each(|_| _ = simulation.step());
        let dt_s = gap(&mut ahrs, lost);
        ahrs.push(&simulation.step(), dt_s);
    }
    ((ahrs.bias_rad_s() - simulation.bias).norm().to_degrees(), sum_deg / 60.0)
}

#[test]
fn a_radio_that_loses_samples_leaves_the_bias_alone() {
    let one_step = |_: &mut Ahrs, lost: usize| (lost + 1) as f64 / RATE_HZ;
    let coasting = |ahrs: &mut Ahrs, lost: usize| {
        (0..lost).for_each(|_| ahrs.coast(1.0 / RATE_HZ));
        1.0 / RATE_HZ
    };
    for (lost, most_deg) in [(5, 0.2), (15, 0.5), (30, 2.5), (60, 10.0)] {
        for (what, gap) in [("one step", one_step as fn(&mut Ahrs, usize) -> f64), ("coasting", coasting)] {
            // A step of more than half a second is for the caller to see.
            if what == "one step" && lost == 60 {
                continue;
            }
            let (bias_deg_s, inclination_deg) = with_gaps(lost, gap);
            assert!(bias_deg_s < 0.15, "{what}, {lost} lost: {bias_deg_s} degrees/s");
            assert!(inclination_deg < most_deg, "{what}, {lost} lost: {inclination_deg} degrees");
        }
    }
}

/// One sensor with bias and noise of its own, turned and shaken from a phase of its own for a minute: its normalised squared errors
/// (three degrees of freedom), twice a second once it has levelled.
fn normalised_errors(turning: f64, mut random: Random) -> Vec<f64> {
    let mut simulation = Simulation::new(turning);
    simulation.seed = (random.uniform() * 1e15) as u64;
    simulation.time_s = 100.0 * random.uniform();
    simulation.bias = random.vector() * params().inclination.bias_initial_rad_s;
    simulation.truth = so3::exp(&random.vector());
    let mut ahrs = Ahrs::new(params());
    let mut errors = Vec::new();
    for k in 0..6000 {
        let sample = simulation.step();
        let orientation = ahrs.push(&sample, 1.0 / RATE_HZ);
        if k >= 1000 && k % 50 == 0 {
            let error = so3::log(&(orientation.inverse() * simulation.truth));
            errors.push(error.dot(&ahrs.rotation_rad2().cholesky().unwrap().solve(&error)));
        }
    }
    errors
}

/// The body's motion is not as the filter assumes, so that the covariance is held against it from above: errors are never larger
/// than it says (97.5 % of chi squared with 150 degrees of freedom, over 50), and not so small that it says nothing.
#[test]
fn errors_are_no_larger_than_the_covariance_says() {
    for turning in [0.0, 0.5, 3.0] {
        let inside = consistency(50, &(0.05..3.72), |random| normalised_errors(turning, random));
        assert!(inside >= 0.95, "{inside} at {turning} rad/s");
    }
}

#[test]
fn a_heading_that_no_field_has_given_may_be_any_and_one_that_the_gyro_holds_grows_uncertain() {
    let heading_rad = |ahrs: &Ahrs| {
        let level = ahrs.orientation_6d().to_rotation_matrix().into_inner();
        (level * ahrs.rotation_rad2() * level.transpose())[(2, 2)].sqrt()
    };
    let (mut ahrs, mut simulation) = (Ahrs::new(params()), Simulation::new(0.5));
    let mut go = |ahrs: &mut Ahrs, field: bool| {
        for _ in 0..1000 {
            let sample = simulation.step();
            ahrs.push(&ImuSample { mag: sample.mag.filter(|_| field), ..sample }, 1.0 / RATE_HZ);
        }
    };
    go(&mut ahrs, false);
    assert!((heading_rad(&ahrs) - std::f64::consts::PI / 3_f64.sqrt()).abs() < 1e-9);
    go(&mut ahrs, true);
    let given = heading_rad(&ahrs);
    go(&mut ahrs, false);
    assert!(given < 0.1 && heading_rad(&ahrs) > 1.2 * given, "{given} then {} rad", heading_rad(&ahrs));
}

/// Ten minutes of laps without a field, after a rest: who runs in a circle is accelerated inwards for as long, leans, and sways with every step.
#[test]
fn who_runs_in_laps_keeps_the_bias_that_a_rest_has_shown() {
    let (mut ahrs, mut rest) = (Ahrs::new(params()), Simulation::new(0.0));
    let bias = rest.bias;
    for _ in 0..1000 {
        let sample = rest.step();
        ahrs.push(&ImuSample { mag: None, ..sample }, 1.0 / RATE_HZ);
    }
    let shown = ahrs.bias_rad_s();
    assert!((shown - bias).norm() < 0.03_f64.to_radians(), "{}", (shown - bias).norm());
    let (speed_m_s, turns_rad_s) = (3.0, 0.15);
    let posture = |t: f64| {
        let sway = Vector3::new(
            0.1 * libm::sin(9.0 * t),
            0.15 + 0.05 * libm::sin(18.0 * t),
            0.1 * libm::cos(9.0 * t),
        );
        so3::exp(&(Vector3::z() * turns_rad_s * t)) * so3::exp(&sway)
    };
    let start = posture(0.0);
    for k in 1..=60_000 {
        let t = f64::from(k) / RATE_HZ;
        let [last, now] = [t - 1.0 / RATE_HZ, t].map(|t| rest.truth * start.inverse() * posture(t));
        let gyro_rad_s = so3::log(&(last.inverse() * now)) * RATE_HZ;
        let inwards = Vector3::new(-libm::sin(turns_rad_s * t), libm::cos(turns_rad_s * t), 0.0);
        let steps = Vector3::z() * (GRAVITY_M_S2 + 3.0 * libm::sin(18.0 * t));
        let sway = Vector3::new(libm::cos(turns_rad_s * t), libm::sin(turns_rad_s * t), 0.0)
            * libm::sin(18.0 * t + 1.0);
        let force = rest.truth * start.inverse() * (inwards * (speed_m_s * turns_rad_s) + steps + sway);
        let sample = ImuSample {
            gyro_rad_s: gyro_rad_s + bias + rest.noise(0.002),
            accel_m_s2: now.inverse() * force + rest.noise(0.03),
            mag: None,
        };
        ahrs.push(&sample, 1.0 / RATE_HZ);
    }
    let moved = (ahrs.bias_rad_s() - shown).norm().to_degrees();
    assert!(moved < 1e-9, "movements moved it by {moved} deg/s");
}
