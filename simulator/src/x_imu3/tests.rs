use nalgebra::Vector3;
use posed_drivers::x_imu3::{Settings, XImu3Session};
use posed_drivers::{DeviceTime, Measurement, Session, State};

use crate::faults::{Bytes, Fault};
use crate::inertial::{GRAVITY_M_S2, ImuClass};
use crate::scenario::DeviceScenario;
use crate::testing::{Pair, angle_to, scenario_of, stage_of};

fn session(addresses: &[u16]) -> XImu3Session {
    XImu3Session::new(Settings::default(), addresses).unwrap()
}

fn pair(addresses: &[u16], port: &str, device: DeviceScenario) -> Pair<XImu3Session> {
    let spec = stage_of("x-imu3", port, 460_800, addresses);
    Pair::new(&spec, &scenario_of(device), session(addresses))
}

fn with(faults: Vec<Fault>) -> DeviceScenario {
    DeviceScenario { imu: ImuClass::Ideal, faults, ..DeviceScenario::default() }
}

#[test]
fn alone_on_a_chain_and_on_a_network_they_stream_what_is_true() {
    for (addresses, port) in [(&[0][..], "a"), (&[1, 2, 3][..], "a"), (&[0][..], "udp://x:9000")] {
        let mut pair = pair(addresses, port, with(vec![]));
        pair.run_until(3.0);
        assert_eq!(*pair.session.state(), State::Streaming, "{:?}", pair.warnings);
        assert_eq!(pair.warnings, [""; 0]);
        pair.forget();
        pair.run_until(5.0);
        for &address in addresses {
            let samples = pair.samples_of(address);
            let (mut inertial, mut oriented, mut fields) = (0, 0, 0);
            for sample in samples.iter().skip(4) {
                let (_, truth) = pair.truth_of(sample);
                let Measurement::Imu { specific_force_m_s2, magnetic_field, orientation_wxyz, .. } =
                    sample.measurement
                else {
                    panic!("{sample:?}")
                };
                if let Some(q) = orientation_wxyz {
                    // The orientation is of the last sample, the truth of the middle of the message.
                    assert!(angle_to(q, &truth) < 0.03, "{}", angle_to(q, &truth));
                    oriented += 1;
                }
                if let Some(field) = magnetic_field {
                    let north = truth.pose.rotation * Vector3::from(field);
                    assert!((north - Vector3::new(0.0, 0.5, -0.75f64.sqrt())).norm() < 0.05, "{north:?}");
                    fields += 1;
                }
                if let Some(specific_force_m_s2) = specific_force_m_s2 {
                    let up = truth.pose.rotation * Vector3::from(specific_force_m_s2);
                    assert!((up - Vector3::z() * GRAVITY_M_S2).norm() < 2.0);
                    inertial += 1;
                }
            }
            assert!((190..=202).contains(&inertial), "{inertial}");
            assert!((190..=202).contains(&oriented), "{oriented}");
            assert!((34..=45).contains(&fields), "{fields}");
            assert!(pair.session.sensors().iter().all(|sensor| sensor.serial.is_some()));
        }
    }
}

#[test]
fn the_driver_knows_when_a_message_was_true() {
    let mut pair = pair(&[1, 2], "a", DeviceScenario { drift_ppm: 40.0, ..with(vec![]) });
    pair.run_until(4.0);
    let mut checked = 0;
    for sample in &pair.samples {
        let Measurement::Imu { angular_velocity_rad_s: Some(_), .. } = sample.measurement else { continue };
        let DeviceTime::Counter { ticks, tick_s } = sample.t_device else { panic!("{sample:?}") };
        let t_s = ticks as f64 * tick_s * (1.0 + 40e-6);
        let (truth, _) = pair.truth_of(sample);
        // The driver believes in the nominal 2.5 ms, a unit's own are up to 0.3 % from it.
        assert!((t_s - truth.as_secs_f64()).abs() < 2e-5, "{t_s} {truth:?}");
        checked += 1;
    }
    assert!(checked > 400);
}

#[test]
fn units_that_vanish_and_messages_left_out_are_counted_by_their_times() {
    let dies = Fault::BirdDies { address: 2, at_s: 5.0, duration_s: Some(0.3) };
    let mut pair = pair(&[1, 2], "a", with(vec![Fault::LostPeriods { at_s: 4.0, count: 5 }, dies]));
    pair.run_until(7.0);
    assert_eq!(pair.lost(1), 5);
    assert!((34..=36).contains(&pair.lost(2)), "{}", pair.lost(2));
    assert_eq!(pair.counted(), [pair.lost(1), pair.lost(2)]);
    assert!(pair.session.losses().iter().all(|loss| loss.estimated));
}

#[test]
fn lost_bytes_are_found_where_their_length_tells() {
    let bytes = Bytes { count: 30, start_s: 3.0, end_s: 13.0 };
    let mut pair = pair(&[1, 2], "a", with(vec![Fault::LostBytes(bytes)]));
    pair.run_until(2.9);
    let before: u64 = pair.counted().iter().sum();
    pair.run_until(14.0);
    assert_eq!(pair.hits.len(), 30);
    let lost = pair.lost(1) + pair.lost(2);
    let counted = pair.counted().iter().sum::<u64>() - before;
    // A lost line end merges two messages, and takes the next one with it.
    assert!(counted.abs_diff(lost) <= 2, "{lost} {counted}");
}

#[test]
fn datagrams_get_lost_doubled_and_late() {
    let few = |count| Bytes { count, start_s: 3.0, end_s: 8.0 };
    let mut pair = pair(&[0], "udp://x:9000", with(vec![Fault::LostDatagrams(few(12))]));
    pair.run_until(9.0);
    assert_eq!(pair.hits.len(), 12);
    assert_eq!(pair.lost(0), 12);
    assert_eq!(pair.counted(), [12]);
}

#[test]
fn words_between_the_data_reach_the_operator() {
    let faults = vec![
        Fault::Error { address: 2, at_s: 4.0, code: 7, detail: 0 },
        Fault::LowBattery { address: 1, at_s: 4.5 },
    ];
    let mut pair = pair(&[1, 2], "a", with(faults));
    pair.run_until(5.0);
    for words in ["unit 2 reports: Error 7.", "unit 1 reports: Battery low."] {
        assert!(pair.warnings.iter().any(|text| text == words), "{:?}", pair.warnings);
    }
    let [low, other] = pair.session.conditions() else { panic!("two units") };
    assert_eq!((low.address, low.battery, other.battery), (1, Some(0.03), None));
    assert!((low.battery_v.unwrap() - 3.4).abs() < 1e-6);
    assert_eq!(pair.counted(), [0, 0]);
}

#[test]
fn they_return_after_a_restart_an_unplugging_and_a_stall() {
    for fault in [
        Fault::PowerCycle { at_s: 4.0 },
        Fault::CounterRestart { at_s: 4.0 },
        Fault::Unplug { at_s: 4.0, duration_s: Some(1.0), power: false },
        Fault::Unplug { at_s: 4.0, duration_s: Some(1.0), power: true },
        Fault::Stall { at_s: 4.0, duration_s: 1.0 },
    ] {
        let mut pair = pair(&[1, 2], "a", with(vec![fault.clone()]));
        pair.run_until(8.0);
        for address in [1, 2] {
            let last = *pair.samples_of(address).last().unwrap();
            assert!(pair.now.seconds_since(last.arrival.t_read) < 0.05, "{fault:?} {:?}", pair.warnings);
        }
    }
}

#[test]
fn wrong_outputs_lack_the_inertial_data() {
    let wrong = Fault::WrongOutput { at_s: 4.0, duration_s: Some(1.0) };
    let mut pair = pair(&[0], "a", with(vec![wrong]));
    pair.run_until(6.0);
    // After half a second without them it is set up again.
    assert!((50..=60).contains(&pair.lost(0)), "{}", pair.lost(0));
    assert_eq!(pair.counted(), [pair.lost(0)]);
}

#[test]
fn units_that_were_set_to_something_else_are_set_up_again() {
    let mut pair = pair(&[1, 2], "a", with(vec![Fault::WrongOutput { at_s: 4.0, duration_s: None }]));
    pair.run_until(6.0);
    for address in [1, 2] {
        let inertial = |sample: &&posed_drivers::Sample| {
            matches!(sample.measurement, Measurement::Imu { angular_velocity_rad_s: Some(_), .. })
        };
        let samples = pair.samples_of(address);
        let last = samples.iter().rfind(inertial).unwrap();
        assert!(pair.now.seconds_since(last.arrival.t_read) < 0.05, "{:?}", pair.warnings);
    }
}

#[test]
fn the_same_seed_gives_the_same_bytes() {
    let run = |seed| {
        let scenario = crate::scenario::Scenario { seed, ..scenario_of(DeviceScenario::default()) };
        let mut pair = Pair::new(&stage_of("x-imu3", "a", 460_800, &[1, 2]), &scenario, session(&[1, 2]));
        pair.run_until(3.0);
        pair.bytes
    };
    assert_eq!(run(3), run(3));
    assert_ne!(run(3), run(4));
}
