use nalgebra::{UnitQuaternion, Vector3};
use posed_drivers::slimevr::{Settings, SlimeVrSession};
use posed_drivers::{Measurement, Session, State};

use crate::faults::{Bytes, Fault};
use crate::inertial::ImuClass;
use crate::scenario::{DeviceScenario, Scenario};
use crate::testing::{Pair, scenario_of, stage_of};

/// Sensor 0 of trackers 1 to 3, and a second sensor of tracker 2.
const ADDRESSES: [u16; 4] = [1, 2, 3, 0x102];

fn session() -> SlimeVrSession {
    SlimeVrSession::new(Settings::default(), &ADDRESSES).unwrap()
}

fn pair(faults: Vec<Fault>) -> Pair<SlimeVrSession> {
    let device = DeviceScenario { imu: ImuClass::Ideal, faults, ..DeviceScenario::default() };
    Pair::new(&stage_of("slimevr", "udp://0.0.0.0:6969", 0, &ADDRESSES), &scenario_of(device), session())
}

/// Orientation and acceleration.
fn motion(measurement: Measurement) -> (UnitQuaternion<f64>, Vector3<f64>) {
    match measurement {
        Measurement::Imu {
            orientation_wxyz: Some([w, x, y, z]), linear_acceleration_m_s2: Some(a), ..
        } => (UnitQuaternion::new_normalize(nalgebra::Quaternion::new(w, x, y, z)), a.into()),
        other => panic!("{other:?}"),
    }
}

fn between(pair: &Pair<SlimeVrSession>, address: u16, from_s: f64, to_s: f64) -> usize {
    let inside = |t_s: f64| from_s <= t_s && t_s < to_s;
    pair.samples_of(address).iter().filter(|sample| inside(sample.arrival.t_read.as_secs_f64())).count()
}

#[test]
fn all_trackers_find_the_server_and_send_what_is_true_up_to_their_heading() {
    let mut pair = pair(vec![]);
    pair.run_until(3.0);
    assert_eq!(*pair.session.state(), State::Streaming, "{:?}", pair.warnings);
    pair.forget();
    pair.run_until(5.0);
    for address in ADDRESSES {
        let samples = pair.samples_of(address);
        assert!((198..=202).contains(&samples.len()), "{address} {}", samples.len());
        let mut heading = None;
        for sample in samples.iter().skip(2) {
            let (q, a) = motion(sample.measurement);
            let (_, truth) = pair.truth_of(sample);
            let offset = q * truth.pose.rotation.inverse();
            let first = *heading.get_or_insert(offset);
            // Packed in 16 bits; the offset is about z only, and stays.
            assert!(offset.angle_to(&first) < 3e-4);
            assert!(offset.i.abs() < 2e-4 && offset.j.abs() < 2e-4, "{offset:?}");
            assert!(a.norm() < 2.0);
        }
    }
    // Number 1 has the first address, and all have one heading each.
    let serials: Vec<_> =
        pair.session.sensors().iter().map(|sensor| sensor.serial.clone().unwrap()).collect();
    assert!(serials[0].ends_with(":01") && serials[1].ends_with(":02"), "{serials:?}");
    assert_eq!(pair.counted(), [0; 4]);
}

#[test]
fn lost_datagrams_are_counted_doubled_and_reordered_ones_refused() {
    let few = |count| Bytes { count, start_s: 3.0, end_s: 9.0 };
    let mut pair = pair(vec![Fault::LostDatagrams(few(25))]);
    pair.run_until(10.0);
    assert_eq!(pair.hits.len(), 25);
    for (k, address) in ADDRESSES.into_iter().enumerate() {
        assert_eq!(pair.counted()[k], pair.lost(address), "{address}");
    }
    let lone = ADDRESSES.map(|address| pair.lost(address));
    assert_eq!(lone[0] + lone[1] + lone[2], 25);
    assert_eq!(lone[1], lone[3], "both are in one packet");

    let mut pair = self::pair(vec![Fault::DuplicatedDatagrams(few(25))]);
    pair.run_until(10.0);
    assert_eq!(pair.session.counters().rejected, 25);
    assert_eq!(pair.counted(), [0; 4]);
    let mut pair = self::pair(vec![Fault::ReorderedDatagrams(few(25))]);
    pair.run_until(10.0);
    assert_eq!(pair.session.counters().rejected, 25);
    assert!(pair.session.losses().iter().all(|loss| loss.lost <= 25 && (loss.lost == 0 || loss.estimated)));
}

#[test]
fn a_burst_delay_is_no_loss() {
    let mut pair = pair(vec![Fault::DelayedDatagrams { at_s: 4.0, duration_s: 0.8 }]);
    pair.run_until(7.0);
    assert_eq!(pair.counted(), [0; 4]);
    assert!(between(&pair, 1, 4.05, 4.79) <= 1);
    assert!(between(&pair, 1, 4.79, 4.85) > 75);
}

#[test]
fn a_tracker_that_is_gone_comes_back_and_disturbs_no_other() {
    for (duration_s, quick) in [(1.0, true), (5.0, false)] {
        let dies = Fault::BirdDies { address: 2, at_s: 4.0, duration_s: Some(duration_s) };
        let mut pair = pair(vec![dies]);
        pair.run_until(13.0);
        assert_eq!(between(&pair, 2, 4.02, 4.0 + duration_s - 0.01), 0);
        assert!(between(&pair, 2, 12.0, 13.0) > 95, "{duration_s} {:?}", pair.warnings);
        assert!((895..=902).contains(&between(&pair, 1, 4.0, 13.0)));
        if quick {
            assert!(between(&pair, 2, 5.0, 6.0) > 95);
        }
    }
}

#[test]
fn after_a_change_of_address_or_a_restart_it_is_the_same_tracker() {
    for fault in [Fault::AddressChange { address: 2, at_s: 4.0 }, Fault::PowerCycle { at_s: 4.0 }] {
        let mut pair = pair(vec![fault.clone()]);
        pair.run_until(10.0);
        for address in ADDRESSES {
            assert!(between(&pair, address, 9.0, 10.0) > 95, "{fault:?} {address} {:?}", pair.warnings);
        }
    }
}

#[test]
fn without_the_network_it_looks_for_the_server_again() {
    let mut pair = pair(vec![Fault::Unplug { at_s: 4.0, duration_s: Some(4.0), power: false }]);
    pair.run_until(11.0);
    assert_eq!(between(&pair, 1, 4.02, 8.0), 0);
    assert!(between(&pair, 1, 10.0, 11.0) > 95, "{:?}", pair.warnings);
}

#[test]
fn nonsense_is_refused_and_words_reach_the_operator() {
    let faults = vec![
        Fault::WrongOutput { at_s: 4.0, duration_s: Some(0.5) },
        Fault::Error { address: 0x102, at_s: 5.0, code: 9, detail: 0 },
        Fault::LowBattery { address: 3, at_s: 5.5 },
    ];
    let mut pair = pair(faults);
    pair.run_until(5.4);
    let battery = |pair: &Pair<SlimeVrSession>| {
        pair.session.conditions().iter().map(|condition| condition.battery).collect::<Vec<_>>()
    };
    assert_eq!(battery(&pair).iter().flatten().count(), ADDRESSES.len(), "each has reported it");
    pair.run_until(7.0);
    assert!(pair.session.counters().rejected >= 190, "{}", pair.session.counters().rejected);
    let words = "sensor 1 of tracker 2 reports error 9";
    assert!(pair.warnings.iter().any(|text| text.contains(words)), "{:?}", pair.warnings);
    for condition in pair.session.conditions() {
        let [level, volts] = if condition.address == 3 { [0.05, 3.25] } else { [0.9, 4.1] };
        let near = |value: Option<f64>, expected: f64| (value.unwrap() - expected).abs() < 1e-6;
        assert!(near(condition.battery, level) && near(condition.battery_v, volts), "{condition:?}");
        assert_eq!(condition.signal_dbm, Some(-58.0));
    }
}

#[test]
fn nothing_is_known_of_the_battery_of_a_tracker_that_is_gone() {
    let mut pair = pair(vec![Fault::BirdDies { address: 2, at_s: 4.0, duration_s: None }]);
    pair.run_until(9.0);
    for condition in pair.session.conditions() {
        assert_eq!(condition.battery.is_none(), condition.address & 0xFF == 2, "{condition:?}");
    }
}

#[test]
fn the_same_seed_gives_the_same_bytes() {
    let run = |seed| {
        let scenario = Scenario { seed, ..scenario_of(DeviceScenario::default()) };
        let mut pair =
            Pair::new(&stage_of("slimevr", "udp://0.0.0.0:6969", 0, &ADDRESSES), &scenario, session());
        pair.run_until(3.0);
        pair.bytes
    };
    assert_eq!(run(3), run(3));
    assert_ne!(run(3), run(4));
}
