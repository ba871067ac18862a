use nalgebra::Vector3;
use posed_drivers::xbus::{Settings, XbusSession};
use posed_drivers::{DeviceTime, LineEvent, Measurement, Sample, Session, State};

use crate::faults::{Bytes, Fault};
use crate::inertial::{GRAVITY_M_S2, ImuClass};
use crate::motion::{Motion, Walk};
use crate::scenario::{BodySpec, DeviceScenario, Personality, Scenario, SensorScenario};
use crate::testing::{Pair, angle_to, scenario_of, stage_of};

fn session(addresses: &[u16], baud: u32) -> XbusSession {
    XbusSession::new(Settings::default(), baud, addresses).unwrap()
}

/// A chain of three at 100 Hz.
fn chain(device: DeviceScenario) -> Pair<XbusSession> {
    Pair::new(&stage_of("xbus", "a", 460_800, &[1, 2, 3]), &scenario_of(device), session(&[1, 2, 3], 460_800))
}

fn alone(personality: Personality, device: DeviceScenario) -> Pair<XbusSession> {
    let device = DeviceScenario { xbus: Some(personality), ..device };
    Pair::new(&stage_of("xbus", "a", 115_200, &[1]), &scenario_of(device), session(&[1], 115_200))
}

fn ideal() -> DeviceScenario {
    DeviceScenario { imu: ImuClass::Ideal, ..DeviceScenario::default() }
}

fn with(faults: Vec<Fault>) -> DeviceScenario {
    DeviceScenario { faults, ..ideal() }
}

fn bytes(count: u32) -> Bytes {
    Bytes { count, start_s: 4.0, end_s: 14.0 }
}

/// Angular velocity, specific force, magnetic field and orientation.
fn imu(sample: &Sample) -> ([f64; 3], [f64; 3], [f64; 3], [f64; 4]) {
    match sample.measurement {
        Measurement::Imu {
            angular_velocity_rad_s: Some(angular_velocity_rad_s),
            specific_force_m_s2: Some(specific_force_m_s2),
            magnetic_field: Some(field),
            orientation_wxyz: Some(q),
            ..
        } => (angular_velocity_rad_s, specific_force_m_s2, field, q),
        other => panic!("{other:?}"),
    }
}

fn ticks(sample: &Sample) -> u64 {
    match sample.t_device {
        DeviceTime::Counter { ticks, .. } => ticks,
        DeviceTime::Cycle(_) => panic!("no counter"),
    }
}

#[test]
fn all_personalities_stream_what_is_true() {
    let pairs = [chain(ideal()), alone(Personality::Mti, ideal()), alone(Personality::Mtx, ideal())];
    for mut pair in pairs {
        pair.run_until(3.0);
        assert_eq!(*pair.session.state(), State::Streaming, "{:?}", pair.warnings);
        pair.forget();
        pair.run_until(5.0);
        assert_eq!(pair.warnings, [""; 0]);
        assert_eq!(pair.session.rate_hz(), Some(100.0));
        for address in pair.session.sensors().iter().map(|sensor| sensor.address).collect::<Vec<_>>() {
            let samples = pair.samples_of(address);
            assert!((198..=201).contains(&samples.len()), "{}", samples.len());
            for (k, sample) in samples.iter().enumerate().skip(4) {
                let (angular_velocity_rad_s, specific_force_m_s2, field, q) = imu(sample);
                let (t, truth) = pair.truth_of(sample);
                assert!(angle_to(q, &truth) < 1e-6);
                // The field's inclination and gravity, both in room axes.
                let north = truth.pose.rotation * Vector3::from(field);
                assert!((north - Vector3::new(0.0, 0.5, -0.75f64.sqrt())).norm() < 1e-6, "{north:?}");
                assert!(
                    (truth.pose.rotation * Vector3::from(specific_force_m_s2) - Vector3::z() * GRAVITY_M_S2)
                        .norm()
                        < 2.0
                );
                // The rotation over two periods is the mean angular velocity.
                let (before, earlier) = pair.truth_of(&samples[k - 2]);
                let rotation_vector_rad =
                    (earlier.pose.rotation.inverse() * truth.pose.rotation).scaled_axis();
                let mean = Vector3::from(imu(&samples[k - 1]).0);
                assert!(
                    (rotation_vector_rad / t.seconds_since(before) - mean).norm() < 1e-3,
                    "{angular_velocity_rad_s:?} {mean:?}"
                );
            }
        }
    }
}

#[test]
fn trackers_on_a_walking_body_measure_within_their_noise() {
    let spec = stage_of("xbus", "a", 460_800, &[1, 2]);
    let rides = |name: &str, segment: &str| SensorScenario {
        name: name.into(),
        body: "walker".into(),
        segment: Some(segment.into()),
        mount_quat_wxyz: [0.5, 0.5, -0.5, 0.5],
        offset_m: [0.02, -0.2, 0.05],
    };
    let scenario = Scenario {
        bodies: vec![BodySpec { name: "walker".into(), motion: Motion::Walk(Walk::default()) }],
        sensors: vec![rides("s1", "thigh_r"), rides("s2", "shank_r")],
        ..scenario_of(DeviceScenario::default())
    };
    let mut pair = Pair::new(&spec, &scenario, session(&[1, 2], 460_800));
    pair.run_until(6.0);
    let (mut worst, mut square, mut count) = (0.0f64, 0.0, 0.0);
    for sample in pair.samples.iter().filter(|sample| sample.arrival.t_read.as_secs_f64() > 3.0) {
        let (_, _, field, q) = imu(sample);
        let (_, truth) = pair.truth_of(sample);
        worst = worst.max(angle_to(q, &truth));
        let north = truth.pose.rotation * Vector3::from(field) - Vector3::new(0.0, 0.5, -0.75f64.sqrt());
        square += north.norm_squared();
        count += 1.0;
    }
    // 0.5 and 1 degree; the magnetometer has 0.5 % of scale and 5e-4 / sqrt(20 ms) of noise.
    assert!(worst < 4f64.to_radians() && worst > 0.1f64.to_radians(), "{worst}");
    let rms = (square / count).sqrt();
    assert!(rms > 2e-3 && rms < 2e-2, "{rms}");
}

#[test]
fn damaged_bytes_cost_whole_periods_and_the_driver_counts_each() {
    for fault in [Fault::LostBytes, Fault::InsertedBytes, Fault::DataBitFlips, Fault::Bit7Flips] {
        for personality in [Personality::Chain, Personality::Mti, Personality::Mtx] {
            let device = with(vec![fault(bytes(40))]);
            let mut pair =
                if personality == Personality::Chain { chain(device) } else { alone(personality, device) };
            pair.run_until(3.5);
            let before = pair.counted();
            pair.forget();
            pair.run_until(15.0);
            assert_eq!(pair.hits.len(), 40);
            for (k, address) in (1..).zip(pair.session.sensors().to_vec()).map(|(k, s)| (k - 1, s.address)) {
                let lost = pair.lost(address);
                assert!((30..=40).contains(&lost), "{personality:?} {lost}");
                let counted = pair.counted()[k] - before[k];
                // Two flips of bit 7 in one message leave its sum as it was.
                let even = pair.hits.iter().filter(|hit| {
                    let in_cycle = pair.hits.iter().filter(|other| other.cycle == hit.cycle).count();
                    hit.fault == "bit7-flips" && in_cycle == 2
                });
                assert_eq!(
                    counted + even.count() as u64 / 2,
                    lost,
                    "{personality:?} {address} {:?}",
                    pair.hits[0].fault
                );
                assert!(pair.session.losses().iter().all(|loss| !loss.estimated));
            }
        }
    }
}

#[test]
fn left_out_periods_are_counted_by_the_device() {
    let mut pair = chain(with(vec![Fault::LostPeriods { at_s: 4.0, count: 7 }]));
    pair.run_until(6.0);
    assert_eq!(pair.counted(), [7, 7, 7]);
    assert_eq!([1, 2, 3].map(|address| pair.lost(address)), [7, 7, 7]);
}

#[test]
fn the_counter_wraps_without_a_loss() {
    let mut pair = alone(Personality::Mti, ideal());
    pair.run_until(670.0);
    assert_eq!(pair.counted(), [0]);
    assert!(pair.samples.len() > 65_600);
}

#[test]
fn errors_between_data_are_reported_and_cost_nothing() {
    let mut pair = chain(with(vec![Fault::Error { address: 2, at_s: 4.0, code: 0x1D, detail: 2 }]));
    pair.run_until(6.0);
    assert!(pair.warnings.iter().any(|text| text.contains("tracker 2")), "{:?}", pair.warnings);
    assert_eq!(pair.counted(), [0, 0, 0]);
}

#[test]
fn a_restarted_counter_is_no_loss_of_a_million_periods() {
    for personality in [Personality::Chain, Personality::Mti] {
        let device = with(vec![Fault::CounterRestart { at_s: 4.0 }]);
        let mut pair =
            if personality == Personality::Chain { chain(device) } else { alone(personality, device) };
        pair.run_until(3.9);
        let before = ticks(pair.samples.last().unwrap());
        pair.run_until(4.5);
        assert!(ticks(pair.samples.last().unwrap()) < before);
        assert_eq!(*pair.session.state(), State::Streaming);
        assert!(pair.counted().iter().all(|&lost| lost < 100), "{:?}", pair.counted());
    }
}

#[test]
fn wrong_outputs_are_refused_and_set_right() {
    for personality in [Personality::Chain, Personality::Mti, Personality::Mtx] {
        let device = with(vec![Fault::WrongOutput { at_s: 4.0, duration_s: None }]);
        let mut pair =
            if personality == Personality::Chain { chain(device) } else { alone(personality, device) };
        pair.run_until(8.0);
        assert!(pair.session.counters().rejected >= 10);
        assert_eq!(*pair.session.state(), State::Streaming, "{personality:?} {:?}", pair.warnings);
        let last = pair.samples.last().unwrap();
        assert!(pair.now.seconds_since(last.arrival.t_read) < 0.05);
    }
}

#[test]
fn a_tracker_that_is_gone_fails_its_periods_until_the_chain_is_scanned_again() {
    let dies = Fault::BirdDies { address: 3, at_s: 4.0, duration_s: None };
    let mut pair = chain(with(vec![dies]));
    pair.run_until(4.2);
    // The master tells which tracker, and sends no data.
    assert!(pair.warnings.iter().any(|text| text.contains("of tracker 3")), "{:?}", pair.warnings);
    pair.forget();
    pair.run_until(10.0);
    assert!(pair.warnings.iter().any(|text| text.contains("tracker 3 is not there")), "{:?}", pair.warnings);
    assert_eq!(pair.samples_of(3).len(), 0);
    assert!(pair.samples_of(1).len() > 300);
}

#[test]
fn without_a_tracker_in_the_middle_those_behind_it_stay_who_they_are() {
    let dies = Fault::BirdDies { address: 2, at_s: 4.0, duration_s: Some(4.0) };
    let mut pair = chain(with(vec![dies, Fault::PowerCycle { at_s: 9.0 }]));
    pair.run_until(3.9);
    let serial = |pair: &Pair<XbusSession>, address: u16| {
        let sensors = pair.session.sensors();
        sensors.iter().find(|sensor| sensor.address == address).and_then(|sensor| sensor.serial.clone())
    };
    let (second, third) = (serial(&pair, 2), serial(&pair, 3));
    assert!(second.is_some() && third.is_some() && second != third);
    pair.run_until(7.9);
    assert_eq!((serial(&pair, 2), serial(&pair, 3)), (None, third.clone()));
    pair.forget();
    pair.run_until(14.0);
    assert_eq!((serial(&pair, 2), serial(&pair, 3)), (second, third));
    assert!(pair.samples_of(2).len() > 100 && pair.samples_of(3).len() > 200);
}

#[test]
fn a_brown_out_in_mid_stream_is_followed_by_a_new_set_up() {
    for personality in [Personality::Chain, Personality::Mti, Personality::Mtx] {
        let device = with(vec![Fault::PowerCycle { at_s: 4.0 }]);
        let mut pair =
            if personality == Personality::Chain { chain(device) } else { alone(personality, device) };
        pair.run_until(7.0);
        assert!(pair.warnings.iter().any(|text| text.contains("restarted")), "{:?}", pair.warnings);
        assert_eq!(*pair.session.state(), State::Streaming);
    }
}

#[test]
fn it_returns_after_unplugging_and_stalling_and_the_gap_is_about_what_was_lost() {
    for fault in [
        Fault::Unplug { at_s: 4.0, duration_s: Some(1.5), power: false },
        Fault::Unplug { at_s: 4.0, duration_s: Some(1.5), power: true },
        Fault::Stall { at_s: 4.0, duration_s: 1.0 },
    ] {
        let mut pair = chain(with(vec![fault.clone()]));
        pair.run_until(9.0);
        assert_eq!(*pair.session.state(), State::Streaming, "{fault:?}");
        let truth = pair.truth.iter().filter(|cycle| {
            let first = pair.samples.first().unwrap().arrival.t_read;
            let last = pair.samples.last().unwrap().arrival.t_read;
            first <= cycle.t && cycle.t < last
        });
        let missed = truth.count() as i64 - pair.samples_of(1).len() as i64;
        let counted = pair.counted()[0] as i64;
        assert!((missed - counted).abs() <= 2, "{fault:?}: {missed} missed, {counted} counted");
    }
}

#[test]
fn without_a_host_it_begins_to_measure_by_itself() {
    let device = DeviceScenario { xbus: Some(Personality::Mtx), ..ideal() };
    let mut pair =
        Pair::new(&stage_of("xbus", "a", 115_200, &[1]), &scenario_of(device), session(&[1], 115_200));
    // Nobody answers its first words.
    pair.session.handle_line(pair.now, &LineEvent::Closed { reason: "test".into() });
    pair.stage = crate::stage::VirtualStage::new(
        &stage_of("xbus", "a", 115_200, &[1]),
        &scenario_of(DeviceScenario { xbus: Some(Personality::Mtx), ..ideal() }),
        ".".as_ref(),
    )
    .unwrap();
    pair.run_until(1.0);
    let summary = posed_drivers::xbus::capture::decode(&pair.bytes, |_| {});
    assert!(summary.records > 45 && summary.bad_checksums == 0, "{summary:?}");
}

#[test]
fn rts_pauses_a_master() {
    let mut pair = chain(ideal());
    pair.run_until(3.0);
    pair.stage.device_mut(0).handle_rts(pair.now, false);
    pair.forget();
    pair.run_until(3.2);
    assert!(pair.samples.len() <= 3);
    pair.stage.device_mut(0).handle_rts(pair.now, true);
    pair.run_until(3.3);
    assert!(pair.samples.len() >= 27);
    assert_eq!(pair.counted()[0], pair.lost(1));
}

#[test]
fn a_slow_clock_shows_in_the_times_and_the_same_seed_gives_the_same_bytes() {
    let run = |drift_ppm| {
        let mut pair = chain(DeviceScenario { drift_ppm, ..DeviceScenario::default() });
        pair.run_until(10.0);
        pair
    };
    let (a, b) = (run(5000.0), run(5000.0));
    assert_eq!(a.bytes, b.bytes);
    assert_ne!(a.bytes, run(0.0).bytes);
    let samples = a.samples_of(1);
    let (first, last) = (samples.first().unwrap(), samples.last().unwrap());
    let period_s =
        last.arrival.t_read.seconds_since(first.arrival.t_read) / (ticks(last) - ticks(first)) as f64;
    assert!((period_s / 0.01 - 1.005).abs() < 1e-4, "{period_s}");
}

#[test]
fn at_a_wrong_rate_nothing_is_understood() {
    let mut pair = chain(ideal());
    pair.stage.device_mut(0).set_host_baud(115_200);
    pair.run_until(8.0);
    assert!(pair.samples.is_empty());
    assert!(matches!(pair.session.state(), State::Failed { .. } | State::Silent { .. }));
}
