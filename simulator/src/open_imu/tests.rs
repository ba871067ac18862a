use posed_drivers::open_imu::{Carrier, OpenImuSession, Settings};
use posed_drivers::{DeviceTime, Measurement, Session, State};

use crate::faults::{Bytes, Fault};
use crate::inertial::ImuClass;
use crate::scenario::DeviceScenario;
use crate::testing::{Pair, scenario_of, stage_of};

/// Sensor 0 of devices 1 to 3, and a second one of device 2.
const ADDRESSES: [u16; 4] = [1, 2, 3, 0x102];
const PORTS: [(&str, Carrier); 4] = [
    ("udp://0.0.0.0:9301", Carrier::Envelopes { port: 9301, websocket: 0 }),
    ("udp://0.0.0.0:9302", Carrier::Envelopes { port: 9302, websocket: 0 }),
    ("websocket", Carrier::Envelopes { port: 0, websocket: 0 }),
    ("/dev/ttyUSB0", Carrier::Line),
];

fn pair(port: usize, faults: Vec<Fault>, jitter_ms: f64) -> Pair<OpenImuSession> {
    let (port, carrier) = PORTS[port];
    let devices = (1..=3).map(|number| format!("device-{number}")).collect();
    let session =
        OpenImuSession::new(Settings { devices, ..Settings::default() }, carrier, &ADDRESSES).unwrap();
    let device = DeviceScenario {
        imu: ImuClass::Ideal,
        faults,
        radio_jitter_ms: jitter_ms,
        ..DeviceScenario::default()
    };
    Pair::new(&stage_of("open-imu", port, 460_800, &ADDRESSES), &scenario_of(device), session)
}

#[test]
fn devices_on_all_carriers_send_what_is_true_and_lose_nothing_where_their_counts_wrap() {
    for port in 0..PORTS.len() {
        let mut pair = pair(port, vec![], 0.0);
        pair.run_until(30.0);
        let is_phone = port == 2;
        assert_eq!(*pair.session.state(), State::Streaming, "{:?}", pair.warnings);
        for address in ADDRESSES {
            let samples = pair.samples_of(address);
            let usual = if is_phone { 1680..1801 } else { 2990..3002 };
            assert!(usual.contains(&samples.len()), "{port} {address} {}", samples.len());
            for sample in samples.iter().skip(2).step_by(50) {
                let Measurement::Imu { specific_force_m_s2: Some(force), .. } = sample.measurement else {
                    panic!()
                };
                let (_, truth) = pair.truth_of(sample);
                let up =
                    truth.pose.rotation.inverse() * nalgebra::Vector3::z() * crate::inertial::GRAVITY_M_S2;
                // People who stand hardly accelerate.
                assert!((nalgebra::Vector3::from(force) - up).norm() < 2.0, "{force:?} {up:?}");
            }
            let ticks = samples.iter().map(|sample| match sample.t_device {
                DeviceTime::Counter { ticks, .. } | DeviceTime::Cycle(ticks) => ticks,
            });
            assert!(ticks.is_sorted());
        }
        assert_eq!(pair.counted(), [0; 4], "{port}");
        assert_eq!(pair.session.counters().rejected, 0, "{port} {:?}", pair.warnings);
    }
}

#[test]
fn what_the_network_loses_is_counted_and_what_it_doubles_or_turns_round_is_refused() {
    for port in 0..2 {
        let few = |count| Bytes { count, start_s: 3.0, end_s: 9.0 };
        let mut pair =
            pair(port, vec![Fault::LostDatagrams(few(25)), Fault::DuplicatedDatagrams(few(20))], 0.0);
        pair.run_until(10.0);
        for (k, address) in ADDRESSES.into_iter().enumerate() {
            assert_eq!(pair.counted()[k], pair.lost(address), "{address}");
        }
        assert_eq!(ADDRESSES.iter().map(|&address| pair.lost(address)).sum::<u64>(), 25);
        assert!((19..=20).contains(&pair.session.counters().rejected), "{:?}", pair.session.counters());
        assert!(pair.samples.windows(2).all(|two| two[0] != two[1]));
    }
}

#[test]
fn one_that_dies_costs_the_others_nothing_and_comes_back_anew() {
    for port in 0..PORTS.len() {
        let dies = Fault::BirdDies { address: 2, at_s: 5.0, duration_s: Some(6.0) };
        let mut pair = pair(port, vec![dies], 0.0);
        pair.run_until(20.0);
        let rate_hz = if port == 2 { 60.0 } else { 100.0 };
        let between = |address: u16, from_s: f64, to_s: f64| {
            let inside = |t_s: f64| from_s <= t_s && t_s < to_s;
            pair.samples_of(address)
                .iter()
                .filter(|sample| inside(sample.arrival.t_read.as_secs_f64()))
                .count() as f64
        };
        assert_eq!(between(2, 5.2, 10.9), 0.0, "{port}");
        assert!(between(2, 13.0, 19.0) > 5.9 * rate_hz, "{port} {}", between(2, 13.0, 19.0));
        for address in [1, 3] {
            assert!(between(address, 4.0, 19.0) > 14.9 * rate_hz, "{port} {address}");
        }
        assert_eq!(pair.counted(), [0; 4], "{port}");
        let said = |what: &str| pair.warnings.iter().any(|warning| warning.contains(what));
        assert!(said(if port == 2 { "page hidden" } else { "device-2 is silent" }), "{:?}", pair.warnings);
    }
}

#[test]
fn a_restart_while_they_send_is_found_out() {
    for port in 0..PORTS.len() {
        let mut pair = pair(
            port,
            vec![Fault::CounterRestart { at_s: 6.0 }, Fault::LostPeriods { at_s: 3.0, count: 7 }],
            0.0,
        );
        pair.run_until(12.0);
        assert_eq!(pair.counted(), [7; 4], "{port}");
        let last = pair.samples_of(1).last().unwrap().arrival.t_read.as_secs_f64();
        assert!(last > 11.9, "{port}");
    }
}

#[test]
fn damaged_bytes_on_a_line_give_nothing_false() {
    let bytes = |count| Bytes { count, start_s: 3.0, end_s: 33.0 };
    let faults = vec![
        Fault::LostBytes(bytes(60)),
        Fault::InsertedBytes(bytes(60)),
        Fault::Bit7Flips(bytes(60)),
        Fault::DataBitFlips(bytes(60)),
        Fault::PhaseCut { at_s: 5.0 },
    ];
    let mut pair = pair(3, faults, 0.0);
    pair.run_until(35.0);
    assert!(pair.hits.len() > 200, "{}", pair.hits.len());
    for address in ADDRESSES {
        for sample in pair.samples_of(address).iter().skip(2) {
            let Measurement::Imu { specific_force_m_s2: Some(force), .. } = sample.measurement else {
                panic!()
            };
            let (_, truth) = pair.truth_of(sample);
            let up = truth.pose.rotation.inverse() * nalgebra::Vector3::z() * crate::inertial::GRAVITY_M_S2;
            assert!((nalgebra::Vector3::from(force) - up).norm() < 2.0, "{force:?} {up:?}");
        }
    }
    // What was damaged is counted by the numbers that are missing.
    let (counted, lost) = (pair.counted(), ADDRESSES.map(|address| pair.lost(address)));
    assert!(counted.iter().sum::<u64>() <= 240, "{counted:?} {lost:?}");
}
