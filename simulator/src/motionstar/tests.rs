use nalgebra::{UnitQuaternion, Vector3};
use posed_drivers::motionstar::{MotionStarSession, Settings};
use posed_drivers::{DeviceTime, Measurement, Session, State};

use crate::faults::{Bytes, Fault};
use crate::scenario::{DeviceScenario, Scenario};
use crate::testing::{Pair, angle_to, scenario_of, stage_of};
use crate::truth::Class;

fn pair(port: &str, settings: Settings, device: DeviceScenario) -> Pair<MotionStarSession> {
    let spec = stage_of("motionstar", port, 115_200, &[2, 3, 5]);
    let scenario = Scenario { sigma_signal_per_m3: 0.0, ..scenario_of(device) };
    Pair::new(&spec, &scenario, MotionStarSession::new(settings, &[2, 3, 5]).unwrap())
}

fn with(faults: Vec<Fault>) -> Pair<MotionStarSession> {
    pair(
        "tcp://x:6000",
        Settings::default(),
        DeviceScenario { faults, rate_hz: 100.0, ..DeviceScenario::default() },
    )
}

fn pose(measurement: Measurement) -> (Vector3<f64>, [f64; 4]) {
    match measurement {
        Measurement::Pose { position_m: Some(p), orientation_wxyz: Some(q), .. } => (p.into(), q),
        other => panic!("{other:?}"),
    }
}

#[test]
fn over_both_transports_and_in_all_formats_it_measures_what_is_true() {
    use posed_drivers::flock::wire::Format;
    for port in ["tcp://x:6000", "udp://x:5000"] {
        for format in [Format::PositionQuaternion, Format::PositionMatrix, Format::PositionAngles] {
            let settings = Settings { format, button: true, ..Settings::default() };
            let mut pair = pair(port, settings, DeviceScenario::default());
            pair.run_until(3.0);
            assert_eq!(*pair.session.state(), State::Streaming, "{:?}", pair.warnings);
            assert_eq!(pair.session.rate_hz(), Some(103.3));
            let samples: Vec<_> = pair.samples.iter().skip(30).copied().collect();
            assert!(samples.len() > 600);
            for sample in samples {
                let (p, q) = pose(sample.measurement);
                let (_, truth) = pair.truth_of(&sample);
                assert_eq!(truth.class, Class::Clean);
                // A word is 0.11 mm and 0.006 degrees.
                assert!((p - truth.pose.translation.vector).norm() < 2e-4, "{p:?} {truth:?}");
                assert!(angle_to(q, &truth) < 3e-4, "{}", angle_to(q, &truth));
            }
        }
    }
}

#[test]
fn rate_and_reports_are_as_set() {
    let settings =
        Settings { measurement_rate_hz: Some(50.0), report_every_cycles: 2, ..Settings::default() };
    let mut pair = pair("tcp://x:6000", settings, DeviceScenario::default());
    pair.run_until(2.0);
    pair.forget();
    pair.run_until(4.0);
    let count = pair.samples_of(3).len();
    assert!((49..=51).contains(&count), "{count}");
}

#[test]
fn losses_are_counted_by_the_sequence() {
    let mut pair = with(vec![Fault::LostPeriods { at_s: 2.0, count: 9 }]);
    pair.run_until(4.0);
    assert_eq!(pair.counted(), [9; 3]);
    assert_eq!([2, 3, 5].map(|address| pair.lost(address)), [9; 3]);
    let few = Bytes { count: 20, start_s: 2.0, end_s: 8.0 };
    let faults = vec![Fault::LostDatagrams(few)];
    let device = DeviceScenario { faults, ..DeviceScenario::default() };
    let mut pair = pair_udp(device);
    pair.run_until(9.0);
    assert_eq!(pair.counted(), [20; 3]);
    assert_eq!(pair.lost(5), 20);
}

fn pair_udp(device: DeviceScenario) -> Pair<MotionStarSession> {
    pair("udp://x:5000", Settings::default(), device)
}

#[test]
fn its_time_is_that_of_the_measurement_and_drifts() {
    let mut pair = pair(
        "tcp://x:6000",
        Settings::default(),
        DeviceScenario { drift_ppm: 5000.0, ..DeviceScenario::default() },
    );
    pair.run_until(6.0);
    for sample in pair.samples.iter().skip(60) {
        let DeviceTime::Counter { ticks, .. } = sample.t_device else { panic!("{sample:?}") };
        let t_s = (ticks - 1_000_000_000_000) as f64 * 1e-3 * 1.005;
        assert!((t_s - pair.truth_of(sample).0.as_secs_f64()).abs() < 6e-4, "{t_s}");
    }
}

#[test]
fn bad_data_are_refused_and_a_lost_sensor_leaves_the_others() {
    let wrong = Fault::WrongOutput { at_s: 2.0, duration_s: Some(0.5) };
    let dies = Fault::BirdDies { address: 3, at_s: 4.0, duration_s: Some(1.0) };
    let mut pair = with(vec![wrong, dies, Fault::Error { address: 2, at_s: 6.0, code: 3, detail: 0 }]);
    pair.run_until(7.0);
    assert!((49..=51).contains(&pair.lost(2)), "{}", pair.lost(2));
    assert_eq!(pair.counted()[0], pair.lost(2));
    assert!((149..=151).contains(&pair.lost(3)), "{}", pair.lost(3));
    assert!(pair.warnings.iter().any(|text| text.contains("error 3")), "{:?}", pair.warnings);
    let dead = |address| {
        pair.samples_of(address)
            .iter()
            .filter(|sample| {
                let t_s = sample.arrival.t_read.as_secs_f64();
                (4.01..4.99).contains(&t_s)
            })
            .count()
    };
    assert_eq!(dead(3), 0);
    assert!(dead(2) > 90);
}

#[test]
fn a_bird_that_is_not_there_at_set_up_joins_when_it_appears() {
    let mut pair = with(vec![Fault::BirdDies { address: 3, at_s: 0.0, duration_s: Some(4.0) }]);
    pair.run_until(10.0);
    assert!(pair.samples_of(2).len() > 700, "the others stream meanwhile: {}", pair.samples_of(2).len());
    let joined = pair.samples_of(3);
    assert!(joined.len() > 300, "{}", joined.len());
    for sample in joined {
        let off_m = pose(sample.measurement).0 - pair.truth_of(&sample).1.pose.translation.vector;
        assert!(off_m.norm() < 1e-3, "{off_m:?}");
    }
}

#[test]
fn mirrored_frozen_and_far_sensors_have_their_classes() {
    let flip = Fault::HemisphereFlip { address: 2, at_s: 2.0, duration_s: 0.5 };
    let frozen = Fault::OutOfRange { address: 3, at_s: 3.0, duration_s: 0.5 };
    let mut pair = with(vec![flip, frozen]);
    pair.run_until(4.0);
    let mut seen = [0; 3];
    for sample in &pair.samples {
        let (p, q) = pose(sample.measurement);
        let (_, truth) = pair.truth_of(sample);
        match truth.class {
            Class::Inverted => {
                assert!((p + truth.pose.translation.vector).norm() < 2e-4);
                assert!(angle_to(q, &truth) < 1e-3);
                seen[0] += 1;
            }
            Class::Stuck => seen[1] += 1,
            Class::Jump => seen[2] += 1,
            _ => {}
        }
    }
    assert!((49..=51).contains(&seen[0]) && (49..=51).contains(&seen[1]) && seen[2] == 1, "{seen:?}");
}

#[test]
fn a_system_that_sends_bad_records_alone_is_set_up_again() {
    let mut pair = with(vec![Fault::WrongOutput { at_s: 2.0, duration_s: None }]);
    pair.run_until(6.0);
    let last = pair.samples.last().unwrap();
    assert!(pair.now.seconds_since(last.arrival.t_read) < 0.05, "{:?}", pair.warnings);
}

#[test]
fn seldom_reports_are_no_silence() {
    let settings = Settings { report_every_cycles: 100, ..Settings::default() };
    let mut pair = pair("tcp://x:6000", settings, DeviceScenario::default());
    pair.run_until(20.0);
    assert!(pair.samples_of(2).len() >= 17, "{:?}", pair.warnings);
    assert_eq!(*pair.session.state(), State::Streaming);
}

#[test]
fn it_returns_after_power_network_and_stalls() {
    for fault in [
        Fault::PowerCycle { at_s: 2.0 },
        Fault::Unplug { at_s: 2.0, duration_s: Some(1.0), power: false },
        Fault::Stall { at_s: 2.0, duration_s: 1.0 },
        Fault::CounterRestart { at_s: 2.0 },
        Fault::LostBytes(Bytes { count: 20, start_s: 2.0, end_s: 4.0 }),
    ] {
        let mut pair = with(vec![fault.clone()]);
        pair.run_until(9.0);
        assert_eq!(*pair.session.state(), State::Streaming, "{fault:?}");
        let last = pair.samples.last().unwrap();
        assert!(pair.now.seconds_since(last.arrival.t_read) < 0.05, "{fault:?}");
        assert!(pair.counted().iter().all(|&lost| lost < 400), "{fault:?} {:?}", pair.counted());
    }
}

#[test]
fn the_transmitter_stands_in_the_room_and_the_same_seed_gives_the_same_bytes() {
    let run = |seed| {
        let mut spec = stage_of("motionstar", "tcp://x:6000", 115_200, &[1]);
        spec.transmitter_in_room = Some(([0.2, 0.1, 1.0], [0.0, 1.0, 0.0, 0.0]));
        let scenario = Scenario { seed, ..scenario_of(DeviceScenario::default()) };
        let session = MotionStarSession::new(Settings::default(), &[1]).unwrap();
        let mut pair = Pair::new(&spec, &scenario, session);
        pair.run_until(2.0);
        pair
    };
    let pair = run(3);
    let (p, _) = pose(pair.samples.last().unwrap().measurement);
    let (_, truth) = pair.truth_of(pair.samples.last().unwrap());
    let rotation = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let in_room = rotation * p + Vector3::new(0.2, 0.1, 1.0);
    assert!((in_room - truth.pose.translation.vector).norm() < 5e-3);
    assert_eq!(pair.bytes, run(3).bytes);
    assert_ne!(pair.bytes, run(4).bytes);
}
