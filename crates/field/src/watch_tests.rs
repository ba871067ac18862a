use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;

const RATE_HZ: f64 = 100.0;

fn normal(random: &mut ChaCha8Rng) -> f64 {
    (-2.0 * libm::log(1.0 - random.random::<f64>())).sqrt()
        * libm::cos(std::f64::consts::TAU * random.random::<f64>())
}

/// A reference sensor at rest and a pair that moves about, whose distance is `off(t)` wrong.
struct Bench {
    random: ChaCha8Rng,
    watch: Watch,
    frame: u64,
    emitted: Vec<(f64, Warning)>,
}

impl Bench {
    fn new() -> Self {
        let settings = WatchSettings { reference_sensors: vec![0], pairs: vec![[1, 2]], mains_hz: 50.0 };
        Self {
            random: ChaCha8Rng::seed_from_u64(5),
            watch: Watch::new(&settings),
            frame: 0,
            emitted: Vec::new(),
        }
    }

    fn run(&mut self, seconds: f64, reference: impl Fn(f64) -> Vector3<f64>, apart: impl Fn(f64) -> f64) {
        let end = self.frame + (seconds * RATE_HZ) as u64;
        while self.frame < end {
            let t = self.frame as f64 / RATE_HZ;
            let mut noise = |sigma: f64| Vector3::from_fn(|_, _| sigma * normal(&mut self.random));
            let still = Vector3::new(1.0, 0.3, 0.5) + noise(3e-4) + reference(t);
            let hand =
                Vector3::new(1.2 + 0.4 * libm::sin(0.7 * t), 0.5 * libm::cos(0.9 * t), 0.4) + noise(3e-4);
            let direction = Vector3::new(libm::cos(0.3 * t), libm::sin(0.3 * t), 0.0);
            // What the map leaves changes with the place.
            let rest = 3e-4 * libm::sin(2.0 * hand.x);
            let other = hand + direction * (0.2 + rest + apart(t)) + noise(3e-4);
            let seen = [still, hand, other].map(|p| WatchedPosition {
                measured_m: Some(p),
                tracked_m: Some(p),
                sigma_m: 7e-4,
            });
            let emitted = &mut self.emitted;
            self.watch.push(t, |k| seen[k], &mut |warning| emitted.push((t, warning)));
            self.frame += 1;
        }
    }
}

fn still(_: f64) -> Vector3<f64> {
    Vector3::zeros()
}

#[test]
fn half_an_hour_of_motion_raises_no_alarm_and_a_steel_object_does_within_half_a_second() {
    let mut bench = Bench::new();
    bench.run(1800.0, still, |_| 0.0);
    assert!(bench.emitted.is_empty(), "{:?}", bench.emitted);
    bench.run(3.0, |_| Vector3::new(0.001, -0.002, 0.001), |_| 0.0);
    let (t, Warning::Disturbed { cause: Cause::ReferenceSensor, active: true, deviation_m, .. }) =
        bench.emitted[0]
    else {
        panic!("{:?}", bench.emitted)
    };
    assert!(t - 1800.0 < 0.5, "{t}");
    assert!((deviation_m - 6f64.sqrt() * 1e-3).abs() < 5e-4);
    assert!(bench.watch.is_disturbed());
    // Twice as far out it is sixteen times as much.
    let [near, far] = [1.0, 2.0].map(|range| bench.watch.doubt_m2(range).sqrt());
    assert!(near > 5e-4 && (far / near - 16.0).abs() < 1e-6);
    bench.run(3.0, still, |_| 0.0);
    assert!(!bench.watch.is_disturbed() && bench.watch.doubt_m2(1.0) == 0.0);
    assert_eq!(bench.emitted.len(), 2);
}

#[test]
fn a_pair_that_comes_apart_is_a_disturbance() {
    let mut bench = Bench::new();
    bench.run(30.0, still, |_| 0.0);
    bench.run(2.0, still, |_| 0.006);
    let (t, Warning::Disturbed { cause: Cause::RigidPair, sensors: [1, 2], active: true, .. }) =
        bench.emitted[0]
    else {
        panic!("{:?}", bench.emitted)
    };
    assert!(t - 30.0 < 0.5, "{t}");
}

#[test]
fn mains_hum_on_a_sensor_at_rest_is_heard() {
    let mut bench = Bench::new();
    bench.run(20.0, still, |_| 0.0);
    // 50 Hz at 100 Hz: every other reading is wrong by as much to the other side.
    bench.run(2.0, |t| Vector3::y() * 0.004 * libm::cos(std::f64::consts::TAU * 50.0 * t + 1.0), |_| 0.0);
    let hum = bench
        .emitted
        .iter()
        .find(|(_, w)| matches!(w, Warning::Disturbed { cause: Cause::Hum, active: true, .. }));
    assert!(hum.is_some_and(|(t, _)| t - 20.0 < 0.5), "{:?}", bench.emitted);
}

#[test]
fn a_slow_drift_is_no_disturbance_but_asks_for_a_new_calibration() {
    let mut bench = Bench::new();
    bench.run(60.0, still, |_| 0.0);
    bench.run(900.0, |t| Vector3::z() * (6e-6 * (t - 60.0)), |_| 0.0);
    assert!(
        matches!(bench.emitted[..], [(_, Warning::Drifted { sensors: [0, 0], .. })]),
        "{:?}",
        bench.emitted
    );
}

#[test]
fn what_was_seen_is_kept_in_a_snapshot() {
    let mut bench = Bench::new();
    bench.run(12.0, still, |_| 0.0);
    let mut again = Bench::new().watch;
    assert_ne!(again, bench.watch);
    posed_state::restore(&mut again, &posed_state::snapshot(&bench.watch)).unwrap();
    assert_eq!(again, bench.watch);
}
