//! SlimeVR: worked examples, round trips, and the server against pretended trackers.

use std::collections::VecDeque;
use std::net::SocketAddr;
use std::time::Duration;

use posed_drivers::datagram::{Datagram, datagrams};
use posed_drivers::slimevr::wire::{self, Item, Refused};
use posed_drivers::slimevr::{Settings, SlimeVrSession};
use posed_drivers::{LineEvent, Measurement, Session, State, Timestamp};
use proptest::prelude::*;

use crate::hex;
use crate::rig::{Device, Rig};

fn items(bytes: &[u8]) -> Vec<Result<Item<'_>, Refused>> {
    let mut found = Vec::new();
    wire::parse(bytes).unwrap().items(|item| found.push(item));
    found
}

#[test]
fn worked_examples() {
    let handshake = hex(
        "00 00 00 03 00 00 00 00 00 00 00 00 00 00 00 09 00 00 00 04 00 00 00 01 00 00 00 00 00 00 00 00 00 00 00 00 00 00
         00 16 05 30 2E 36 2E 30 A4 CF 12 D4 E5 F6 00 07 53 6C 69 6D 65 56 52 00 0F 53 6C 69 6D 65 56 52 20 54 72 61 63 6B
         65 72 00 00",
    );
    let [Ok(Item::Handshake(found))] = items(&handshake)[..] else { panic!() };
    assert_eq!((found.board, found.imu, found.mcu, found.protocol), (9, 4, 1, 22));
    assert_eq!((found.firmware, found.mac), (&b"0.6.0"[..], Some([0xA4, 0xCF, 0x12, 0xD4, 0xE5, 0xF6])));
    assert_eq!(wire::handshake_reply()[..13], hex("03 48 65 79 20 4F 56 52 20 3D 44 20 35")[..]);
    assert_eq!(wire::handshake_reply().len(), 64);

    let info = hex("00 00 00 0F 00 00 00 00 00 00 00 05 01 01 04 00 03 01 07 00 42 C8 00 00 42 C8 00 00");
    let [Ok(Item::SensorInfo(found))] = items(&info)[..] else { panic!() };
    assert_eq!((found.sensor, found.state, found.kind, found.position), (1, 1, 4, 7));
    assert_eq!(wire::sensor_info_ack(1, 1), hex("00 00 00 0F 01 01"));

    let rotation =
        hex("00 00 00 11 00 00 00 00 00 00 00 2A 00 01 3F 00 00 00 BF 00 00 00 3F 00 00 00 3F 00 00 00 03");
    assert_eq!(wire::parse(&rotation).unwrap().number, 42);
    let orientation_wxyz = [0.5, 0.5, -0.5, 0.5];
    assert_eq!(items(&rotation), [Ok(Item::Rotation { sensor: 0, orientation_wxyz })]);

    let acceleration = hex("00 00 00 04 00 00 00 00 00 00 00 2B 3E 80 00 00 BE 00 00 00 3F C0 00 00 00");
    let acceleration_m_s2 = [0.25, -0.125, 1.5];
    assert_eq!(items(&acceleration), [Ok(Item::Acceleration { sensor: 0, acceleration_m_s2 })]);

    let bundle = hex(
        "00 00 00 64 00 00 00 00 00 00 00 2C 00 17 00 00 00 11 00 01 00 00 00 00 00 00 00 00 00 00 00 00 3F 80 00 00 00 00
         11 00 00 00 04 00 00 00 00 00 00 00 00 3F 00 00 00 00",
    );
    assert_eq!(
        items(&bundle),
        [
            Ok(Item::Rotation { sensor: 0, orientation_wxyz: [1.0, 0.0, 0.0, 0.0] }),
            Ok(Item::Acceleration { sensor: 0, acceleration_m_s2: [0.0, 0.0, 0.5] }),
        ]
    );
    assert_eq!(wire::ping(0xDEAD_BEEF), hex("00 00 00 0A 00 00 00 00 00 00 00 00 DE AD BE EF"));
    assert_eq!(items(&wire::ping(0xDEAD_BEEF)), [Ok(Item::Pong(0xDEAD_BEEF))]);

    let compact =
        hex("00 00 00 65 00 00 00 00 00 00 00 2D 10 17 02 40 00 C0 00 40 00 40 00 00 80 FE C0 00 00");
    let acceleration_m_s2 = [1.0, -2.5, 0.0];
    assert_eq!(items(&compact), [Ok(Item::Motion { sensor: 2, orientation_wxyz, acceleration_m_s2 })]);

    let battery = hex("00 00 00 0C 00 00 00 00 00 00 00 2E 40 78 00 00 3F 00 00 00");
    assert_eq!(items(&battery), [Ok(Item::Battery { volts: Some(3.875), level: 0.5 })]);
    let signal = wire::encode(3, 19, &[255, (-61_i8).cast_unsigned()]);
    assert_eq!(items(&signal), [Ok(Item::Signal { strength_dbm: -61.0 })]);
    assert_eq!(items(&hex("00 00 00 16 00 00 00 00 00 00 00 2F 06")), [Ok(Item::FeatureFlags)]);
    assert_eq!(wire::feature_flags(), hex("00 00 00 16 00 00 00 00 00 00 00 00 03"));
}

#[test]
fn damaged_values_are_refused_not_mended() {
    let rotation = |q| wire::encode(1, 17, &wire::rotation_body(0, q));
    for q in [[0.0; 4], [f64::NAN, 0.0, 0.0, 0.0], [0.5, 0.0, 0.0, 0.0]] {
        assert_eq!(items(&rotation(q)), [Err(Refused)]);
    }
    assert_eq!(items(&wire::encode(1, 4, &wire::acceleration_body(0, [f64::NAN, 0.0, 0.0]))), [Err(Refused)]);
    assert_eq!(items(&wire::encode(1, 99, &[])), [Err(Refused)], "an unknown type");
    // A bundle whose last length goes beyond its end keeps what was whole.
    let mut bundle = vec![24, 17];
    bundle.extend(wire::rotation_body(3, [1.0, 0.0, 0.0, 0.0]));
    bundle[0] = bundle.len() as u8 - 1;
    bundle.extend([9, 4, 0]);
    let found = wire::encode(1, 101, &bundle);
    assert!(matches!(items(&found)[..], [Ok(Item::Rotation { sensor: 3, .. }), Err(Refused)]));
    assert_eq!(wire::parse(&[1, 0, 0, 4, 0, 0, 0, 0, 0, 0, 0, 1]), None);
    assert_eq!(wire::parse(&[0; 11]), None);
}

#[test]
fn imitations_leave_out_fields() {
    let full = wire::handshake_body([1, 2, 3, 4, 5, 6], 22, "0.6.0");
    for len in 0..full.len() {
        let packet = wire::encode(0, 3, &full[..len]);
        let [Ok(Item::Handshake(found))] = items(&packet)[..] else { panic!() };
        assert_eq!(found.mac.is_some(), len >= 40, "{len}");
    }
}

proptest! {
    #[test]
    fn round_trip(q in proptest::array::uniform4(-1.0_f64..1.0), a in proptest::array::uniform3(-100.0_f64..100.0), sensor: u8) {
        let norm = q.iter().map(|v| v * v).sum::<f64>().sqrt();
        prop_assume!(norm > 0.1);
        let q = q.map(|v| v / norm);
        let rotation = wire::encode(9, 17, &wire::rotation_body(sensor, q));
        let motion = wire::encode(9, 23, &wire::motion_body(sensor, q, a));
        let [Ok(Item::Rotation { sensor: s, orientation_wxyz })] = items(&rotation)[..] else { panic!() };
        prop_assert_eq!(s, sensor);
        let [Ok(Item::Motion { orientation_wxyz: packed, acceleration_m_s2, .. })] = items(&motion)[..] else { panic!() };
        for k in 0..4 {
            prop_assert!((orientation_wxyz[k] - q[k]).abs() < 1e-6);
            prop_assert!((packed[k] - q[k]).abs() < 1e-4);
        }
        for k in 0..3 {
            prop_assert!((acceleration_m_s2[k] - a[k]).abs() <= 0.51 / 128.0);
        }
    }
}

/// Trackers that look for their server once a second and then send at 100 Hz.
struct Pretended {
    trackers: Vec<One>,
    out: VecDeque<Vec<u8>>,
}

struct One {
    mac: [u8; 6],
    peer: SocketAddr,
    protocol: u32,
    on: bool,
    connected: bool,
    received_at: Timestamp,
    next: Timestamp,
    number: u64,
    bundles: bool,
    acknowledged: bool,
    beats: u32,
}

fn one(last: u8) -> One {
    One {
        mac: [0xA4, 0xCF, 0x12, 0, 0, last],
        peer: SocketAddr::from(([192, 0, 2, last], 6969)),
        protocol: 22,
        on: true,
        connected: false,
        received_at: Timestamp::ZERO,
        next: Timestamp::ZERO,
        number: 0,
        bundles: false,
        acknowledged: false,
        beats: 0,
    }
}

impl Device for Pretended {
    fn receive(&mut self, now: Timestamp, bytes: &[u8]) {
        for datagram in datagrams(bytes) {
            let datagram = datagram.unwrap();
            let Some(one) = self.trackers.iter_mut().find(|one| one.peer == datagram.peer && one.on) else {
                continue;
            };
            one.received_at = now;
            match datagram.data {
                [3, text @ ..] => {
                    assert!(text.starts_with(b"Hey OVR =D 5"));
                    one.connected = true;
                    one.next = now;
                }
                [0, 0, 0, 1, ..] => one.beats += 1,
                [0, 0, 0, 10, ..] => {
                    self.out.push_back(Datagram { peer: one.peer, data: datagram.data }.encode());
                }
                [0, 0, 0, 15, _, 1] => one.acknowledged = true,
                [0, 0, 0, 22, ..] => one.bundles = true,
                other => panic!("{other:?}"),
            }
        }
    }

    fn send(&mut self, now: Timestamp) -> Option<Vec<u8>> {
        for one in self.trackers.iter_mut().filter(|one| one.on) {
            if one.connected && now.seconds_since(one.received_at) > 3.0 {
                one.connected = false;
            }
            if now < one.next {
                continue;
            }
            let mut emit = |number: u64, kind: u32, body: &[u8]| {
                let data = wire::encode(number, kind, body);
                self.out.push_back(Datagram { peer: one.peer, data: &data }.encode());
            };
            if !one.connected {
                one.next = now + Duration::from_secs(1);
                emit(0, 3, &wire::handshake_body(one.mac, one.protocol, "0.6.0"));
                continue;
            }
            one.next = now + Duration::from_millis(10);
            let mut number = one.number;
            if !one.acknowledged {
                number += 1;
                emit(number, 15, &[0, 1, 4, 0, 3, 1, 7, 0]);
            }
            if !one.bundles {
                number += 1;
                emit(number, 22, &[6]);
            }
            number += 1;
            emit(number, 23, &wire::motion_body(0, [0.5, -0.5, 0.5, 0.5], [1.0, -2.5, 0.5]));
            one.number = number;
        }
        self.out.pop_front()
    }
}

fn rig(settings: Settings, wanted: &[u16], trackers: Vec<One>) -> Rig<SlimeVrSession, Pretended> {
    Rig::open(SlimeVrSession::new(settings, wanted).unwrap(), Pretended { trackers, out: VecDeque::new() })
}

fn named(lasts: &[u8]) -> Settings {
    Settings { trackers: lasts.iter().map(|last| format!("A4:CF:12:00:00:{last:02X}")).collect() }
}

#[test]
fn trackers_join_and_stream() {
    let mut rig = rig(named(&[7, 8]), &[1, 2], vec![one(8), one(7)]);
    rig.run_stored_ms(200);
    assert!(rig.is_streaming(), "{}", rig.reason());
    assert!(rig.device.trackers.iter().all(|one| one.acknowledged && one.bundles));
    rig.samples.clear();
    rig.run_ms(1000);
    for address in [1, 2] {
        assert_eq!(rig.samples.iter().filter(|sample| sample.address == address).count(), 100);
    }
    let Measurement::Imu { orientation_wxyz, linear_acceleration_m_s2, specific_force_m_s2, .. } =
        rig.samples[0].measurement
    else {
        panic!()
    };
    assert_eq!(orientation_wxyz, Some([0.5, -0.5, 0.5, 0.5]));
    assert_eq!((linear_acceleration_m_s2, specific_force_m_s2), (Some([1.0, -2.5, 0.5]), None));
    assert_eq!(rig.session.sensors()[0].serial.as_deref(), Some("A4:CF:12:00:00:07"));
    assert!((2..=3).contains(&rig.device.trackers[0].beats));
    assert!(rig.warnings.is_empty(), "{:?}", rig.warnings);
    assert_eq!(rig.session.counters().rejected, 0);
    assert!(rig.session.losses().iter().all(|loss| loss.lost == 0));
}

#[test]
fn unknown_trackers_are_named_and_not_served_when_the_stage_names_some() {
    let mut strict = rig(named(&[7]), &[1], vec![one(7), one(9)]);
    strict.run_ms(500);
    assert!(
        strict.warnings.iter().any(|warning| warning.contains("A4:CF:12:00:00:09")),
        "{:?}",
        strict.warnings
    );
    assert!(!strict.device.trackers[1].connected);

    let mut open = rig(Settings::default(), &[1, 2], vec![one(7), one(9)]);
    open.run_ms(500);
    assert!(open.device.trackers.iter().all(|one| one.connected));
    assert!(open.warnings[0].contains("is tracker 1"), "{:?}", open.warnings);
}

#[test]
fn a_tracker_returns_from_another_address_and_counts_anew() {
    let mut rig = rig(named(&[7]), &[1], vec![one(7)]);
    rig.run_ms(500);
    let tracker = &mut rig.device.trackers[0];
    tracker.peer = SocketAddr::from(([198, 51, 100, 3], 1234));
    tracker.connected = false;
    tracker.number = 0;
    rig.samples.clear();
    rig.run_ms(500);
    assert!(rig.samples.len() > 40, "{}", rig.samples.len());
    assert_eq!(rig.session.losses()[0].lost, 0);
}

#[test]
fn late_and_doubled_packets_are_dropped_and_missing_ones_counted() {
    let mut rig = rig(named(&[7]), &[1], vec![one(7)]);
    rig.run_ms(500);
    rig.samples.clear();
    let rejected = rig.session.counters().rejected;
    let peer = rig.device.trackers[0].peer;
    let base = rig.device.trackers[0].number;
    let body = wire::motion_body(0, [1.0, 0.0, 0.0, 0.0], [0.0; 3]);
    for step in [1, 1, 3, 2, 4] {
        let data = wire::encode(base + step, 23, &body);
        rig.session.handle_bytes(rig.now, &Datagram { peer, data: &data }.encode());
    }
    rig.device.trackers[0].number = base + 4;
    rig.run_ms(1);
    assert_eq!(rig.session.counters().rejected - rejected, 2);
    assert_eq!(rig.session.losses()[0].lost, 1);
    // A returned ping has number 0, and opens no door to older packets.
    let pong = wire::ping(5);
    rig.session.handle_bytes(rig.now, &Datagram { peer, data: &pong }.encode());
    let old = wire::encode(base, 23, &body);
    rig.session.handle_bytes(rig.now, &Datagram { peer, data: &old }.encode());
    assert_eq!(rig.session.counters().rejected - rejected, 3);
}

#[test]
fn one_silent_tracker_leaves_the_others_alone() {
    let mut rig = rig(named(&[7, 8]), &[1, 2], vec![one(7), one(8)]);
    rig.run_ms(500);
    rig.device.trackers[1].on = false;
    rig.samples.clear();
    rig.run_ms(5000);
    assert_eq!(rig.samples.iter().filter(|sample| sample.address == 1).count(), 500);
    assert!(rig.is_streaming());
    assert!(rig.warnings.iter().any(|warning| warning.contains("tracker 2 is gone")), "{:?}", rig.warnings);
    rig.device.trackers[1].on = true;
    rig.samples.clear();
    rig.run_ms(3000);
    assert!(rig.samples.iter().filter(|sample| sample.address == 2).count() > 100);

    rig.device.trackers.iter_mut().for_each(|one| one.on = false);
    rig.run_ms(2000);
    assert!(matches!(rig.session.state(), State::Silent { .. }));
    rig.session.handle_line(rig.now, &LineEvent::Closed { reason: "gone".into() });
    assert_eq!(rig.session.poll_timeout(), None);
}

#[test]
fn old_protocols_have_acceleration_a_quarter_turn_off() {
    let mut rig = rig(named(&[7]), &[1], vec![One { protocol: 19, ..one(7) }]);
    rig.run_ms(300);
    let Measurement::Imu { linear_acceleration_m_s2, .. } = rig.samples[0].measurement else { panic!() };
    assert_eq!(linear_acceleration_m_s2, Some([-2.5, -1.0, 0.5]));
}

#[test]
fn settings_are_checked() {
    let bad = |trackers: &[&str]| Settings { trackers: trackers.iter().map(|&text| text.into()).collect() };
    for settings in [bad(&["x"]), bad(&["A4:CF:12:00:00"]), bad(&["A4:CF:12:00:00:07", "a4-cf-12-00-00-07"])]
    {
        assert!(SlimeVrSession::new(settings.clone(), &[1]).is_err(), "{settings:?}");
    }
    for wanted in [&[][..], &[0], &[3], &[1, 1], &[256]] {
        assert!(SlimeVrSession::new(named(&[7, 8]), wanted).is_err(), "{wanted:?}");
    }
    assert!(SlimeVrSession::new(named(&[7, 8]), &[1, 257, 2]).is_ok());
}

/// A handshake of a device that never measures.
fn ask(rig: &mut Rig<SlimeVrSession, Pretended>, last: u8) {
    let peer = SocketAddr::from(([203, 0, 113, last], 4000));
    let data = wire::encode(0, 3, &wire::handshake_body([2, 0, 0, 0, 0, last], 22, "0.6.0"));
    rig.session.handle_bytes(rig.now, &Datagram { peer, data: &data }.encode());
}

#[test]
fn who_asks_and_never_measures_locks_nobody_out() {
    // All 64 numbers are taken by questions when the tracker comes, and goes on being asked for.
    let mut rig = rig(Settings::default(), &(1..=64).collect::<Vec<_>>(), vec![]);
    for last in 0..64 {
        ask(&mut rig, last);
    }
    rig.device.trackers = vec![one(7)];
    rig.run_ms(500);
    assert!(!rig.samples.is_empty(), "{:?}", rig.warnings.last());
    for last in 64..=255 {
        ask(&mut rig, last);
    }
    rig.samples.clear();
    rig.run_ms(1000);
    assert_eq!(rig.samples.len(), 100, "the one that measures keeps its number");

    // Those that are gone leave the low numbers, which a stage names, to those that come.
    let mut rig = self::rig(Settings::default(), &[1, 2], vec![]);
    ask(&mut rig, 1);
    ask(&mut rig, 2);
    rig.run_ms(4000);
    rig.device.trackers = vec![one(7), one(8)];
    rig.run_ms(1000);
    assert_eq!(rig.session.sensors()[0].serial.as_deref(), Some("A4:CF:12:00:00:07"));
    assert_eq!(rig.session.sensors()[1].serial.as_deref(), Some("A4:CF:12:00:00:08"));
}

#[test]
fn beyond_64_that_measure_nobody_is_let_in_and_none_of_them_loses_anything() {
    let mut rig = rig(Settings::default(), &(1..=64).collect::<Vec<_>>(), (0..64).map(one).collect());
    rig.run_ms(500);
    rig.device.trackers.push(one(64));
    rig.samples.clear();
    rig.run_ms(1500);
    let counts =
        (1..=64).map(|address| rig.samples.iter().filter(|sample| sample.address == address).count());
    assert_eq!(counts.collect::<Vec<_>>(), [150; 64]);
    assert!(!rig.device.trackers[64].connected);
    assert!(rig.warnings.iter().any(|warning| warning.contains("A4:CF:12:00:00:40 wants to join")));
    assert!(rig.session.losses().iter().all(|loss| loss.lost == 0));
}

#[test]
fn an_answer_is_no_longer_than_its_question() {
    let mut rig = rig(named(&[7]), &[1], vec![one(7)]);
    rig.run_ms(500);
    let peer = rig.device.trackers[0].peer;
    // A compact bundle of 600 questions of two bytes each.
    let data = wire::encode(rig.device.trackers[0].number + 1, 101, &[1, 22].repeat(600));
    while rig.session.poll_output().is_some() {}
    rig.session.handle_bytes(rig.now, &Datagram { peer, data: &data }.encode());
    let mut answered = 0;
    while let Some(output) = rig.session.poll_output() {
        if let posed_drivers::Output::Transmit(bytes) = output {
            answered += datagrams(&bytes).map(|datagram| datagram.unwrap().data.len()).sum::<usize>();
        }
    }
    assert!((13..=data.len()).contains(&answered), "{answered} bytes for {}", data.len());
}
