//! x-IMU3: worked examples, round trips, and the session against pretended units.

use std::collections::VecDeque;
use std::time::Duration;

use posed_drivers::x_imu3::data::{self, Data};
use posed_drivers::x_imu3::wire::{self, Body, Lines};
use posed_drivers::x_imu3::{Settings, XImu3Session};
use posed_drivers::{DeviceTime, Measurement, Session, State, Timestamp};
use proptest::prelude::*;
use serde_json::{Value, json};

use crate::hex;
use crate::rig::{Device, Rig};

/// Reads the one message of `bytes`, LF included.
fn read(bytes: &[u8], check: impl FnOnce(u16, Option<data::Stamped<'_>>, Body<'_>)) {
    let mut lines = Lines::default();
    lines.push(bytes);
    let line = lines.find().unwrap();
    let mut scratch = Vec::new();
    let message = wire::parse(lines.line(line), &mut scratch).unwrap();
    check(message.address, data::decode(&message.body), message.body);
    assert_eq!(lines.bytes_skipped(), 0);
}

#[test]
fn worked_examples() {
    let inertial = Data::Inertial { gyroscope: [0.0; 3], accelerometer: [0.0, 0.0, 1.0] };
    for (text, address, time_us, expected) in [
        (
            "C9 40 42 0F 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 80 3F 0A",
            0,
            1_000_000,
            inertial,
        ),
        (
            "D1 DB DC DB DC 00 00 00 00 00 00 00 00 00 3F 00 00 00 BF 00 00 00 3F 00 00 00 3F 0A",
            0,
            2570,
            Data::Quaternion([0.5, -0.5, 0.5, 0.5]),
        ),
        (
            "CD DB DD 00 00 00 00 00 00 00 00 00 80 3F 00 00 00 00 00 00 00 00 0A",
            0,
            219,
            Data::Magnetometer([1.0, 0.0, 0.0]),
        ),
        (
            "49 2C 31 30 30 30 30 30 30 2C 30 2E 30 30 30 30 2C 30 2E 30 30 30 30 2C 30 2E 30 30 30 30 2C 30 2E 30 30 30
             30 2C 30 2E 30 30 30 30 2C 31 2E 30 30 30 30 0A",
            0,
            1_000_000,
            inertial,
        ),
        (
            "5E 02 D1 87 D6 12 00 00 00 00 00 00 00 80 3F 00 00 00 00 00 00 00 00 00 00 00 00 0A",
            2,
            1_234_567,
            Data::Quaternion([1.0, 0.0, 0.0, 0.0]),
        ),
        ("D4 40 42 0F 00 00 00 00 00 00 00 C8 41 0A", 0, 1_000_000, Data::Temperature(25.0)),
        (
            "CE 40 4B 4C 00 00 00 00 00 42 75 74 74 6F 6E 20 70 72 65 73 73 65 64 2E 0A",
            0,
            5_000_000,
            Data::Notification(b"Button pressed."),
        ),
    ] {
        read(&hex(text), |from, stamped, _| {
            let stamped = stamped.unwrap();
            assert_eq!((from, stamped.time_us, stamped.data), (address, time_us, expected));
        });
    }
    assert_eq!(wire::command(0, "ping", &Value::Null), hex("7B 22 70 69 6E 67 22 3A 6E 75 6C 6C 7D 0A"));
    assert_eq!(wire::command(u16::from(wire::MUX), "ping", &Value::Null), b"^^{\"ping\":null}\n");
    let reply = b"^\x02{\"ping\":{\"interface\":\"Serial\",\"name\":\"Left thigh\",\"sn\":\"6A3F20C1\"}}\n";
    read(reply, |address, _, body| {
        let Body::Command(json) = body else { panic!("{body:?}") };
        let (key, value) = wire::answer(json).unwrap();
        assert_eq!((address, key.as_str(), &value["sn"]), (2, "ping", &json!("6A3F20C1")));
    });
}

#[test]
fn old_and_new_forms_are_identified_by_their_length() {
    let seven = [1.0, 0.0, 0.0, 0.0, 0.25, -0.5, 1.5];
    let decode = |letter, values: &[f64]| {
        let bytes = data::encode(7, values);
        data::decode(&Body::Binary(letter, &bytes)).map(|stamped| format!("{:?}", stamped.data))
    };
    assert_eq!(decode(b'L', &seven[4..]).unwrap(), "Linear(None, [0.25, -0.5, 1.5])");
    assert_eq!(decode(b'L', &seven).unwrap(), "Linear(Some([1.0, 0.0, 0.0, 0.0]), [0.25, -0.5, 1.5])");
    assert_eq!(decode(b'E', &seven).unwrap(), "Earth(Some([1.0, 0.0, 0.0, 0.0]), [0.25, -0.5, 1.5])");
    assert_eq!(decode(b'L', &seven[..5]), None);
    assert_eq!(decode(b'U', &[0.0, 1.0, 0.0, 0.0]).unwrap(), "AhrsFlags([false, true, false, false])");
    assert!(decode(b'U', &[0.5, 1.0, 0.0, 0.0]).unwrap().starts_with("AhrsText"));
}

#[test]
fn what_cannot_have_been_measured_is_refused() {
    let measured = |letter, values: &[f64]| {
        let bytes = data::encode(7, values);
        data::decode(&Body::Binary(letter, &bytes)).map(|stamped| stamped.data.measurement().is_ok())
    };
    assert_eq!(measured(b'I', &[0.0, 0.0, 0.0, 0.0, 0.0, 1.0]), Some(true));
    assert_eq!(measured(b'I', &[1e9, 0.0, 0.0, 0.0, 0.0, 1.0]), Some(false));
    assert_eq!(measured(b'I', &[f64::NAN, 0.0, 0.0, 0.0, 0.0, 1.0]), None);
    assert_eq!(measured(b'Q', &[0.9, 0.0, 0.0, 0.0]), Some(false));
    assert_eq!(measured(b'I', &[0.0; 5]), None);
}

proptest! {
    #[test]
    fn binary_round_trip(
        time_us in 0_u64..1 << 50,
        values in proptest::collection::vec(-2000.0_f32..2000.0, 6),
        address in prop_oneof![Just(0_u16), Just(2), Just(0xDB), Just(0x0305)],
    ) {
        let values: Vec<f64> = values.into_iter().map(f64::from).collect();
        let mut bytes = Vec::new();
        wire::binary(address, b'I', &data::encode(time_us, &values), &mut bytes);
        prop_assert_eq!(bytes.iter().filter(|&&byte| byte == wire::LF).count(), 1);
        let expected = Data::Inertial {
            gyroscope: [values[0], values[1], values[2]],
            accelerometer: [values[3], values[4], values[5]],
        };
        read(&bytes, |from, stamped, _| {
            assert_eq!((from, stamped), (address, Some(data::Stamped { time_us, data: expected })));
        });
        let text = data::encode_text(b'I', time_us, &values);
        read(&text, |_, stamped, _| {
            let Data::Inertial { gyroscope, accelerometer } = stamped.unwrap().data else { panic!() };
            for (ours, theirs) in gyroscope.into_iter().chain(accelerometer).zip(&values) {
                assert!((ours - theirs).abs() <= 0.500_1e-4);
            }
        });
    }
}

/// Units of a chain, or one alone at address 0.
struct Pretended {
    addresses: Vec<u16>,
    lines: Lines,
    out: VecDeque<Vec<u8>>,
    divisor: Vec<u32>,
    next: Vec<Timestamp>,
    /// Microseconds of each unit's clock at the host's zero.
    clock_us: Vec<i64>,
    dead: Vec<bool>,
    drop_next: u32,
}

impl Pretended {
    fn new(addresses: &[u16]) -> Self {
        let n = addresses.len();
        Self {
            addresses: addresses.into(),
            lines: Lines::default(),
            out: VecDeque::new(),
            divisor: vec![8; n],
            next: vec![Timestamp::ZERO; n],
            clock_us: vec![5_000_000; n],
            dead: vec![false; n],
            drop_next: 0,
        }
    }

    fn time_us(&self, unit: usize, now: Timestamp) -> u64 {
        (now.as_nanos() / 1000 + self.clock_us[unit]) as u64
    }
}

impl Device for Pretended {
    fn receive(&mut self, _: Timestamp, bytes: &[u8]) {
        self.lines.push(bytes);
        while let Some(line) = self.lines.find() {
            let mut scratch = Vec::new();
            let message = wire::parse(self.lines.line(line), &mut scratch).unwrap();
            let Body::Command(json) = message.body else { panic!("{message:?}") };
            let Some(unit) = self.addresses.iter().position(|&address| address == message.address) else {
                continue;
            };
            if self.dead[unit] {
                continue;
            }
            let (key, value) = wire::answer(json).unwrap();
            let value = match key.as_str() {
                "ping" => json!({"interface": "Serial", "name": "x", "sn": format!("SN{}", message.address)}),
                "inertialmessageratedivisor" => {
                    self.divisor[unit] = value.as_u64().unwrap() as u32;
                    value
                }
                "highgaccelerometermessageratedivisor" => json!({"error": "Unknown command"}),
                _ => value,
            };
            self.out.push_back(wire::command(message.address, &key, &value));
        }
    }

    fn send(&mut self, now: Timestamp) -> Option<Vec<u8>> {
        for unit in 0..self.addresses.len() {
            if now < self.next[unit] || self.dead[unit] {
                continue;
            }
            self.next[unit] =
                now.max(self.next[unit]) + Duration::from_micros(2500 * u64::from(self.divisor[unit]));
            if self.drop_next > 0 {
                self.drop_next -= 1;
                continue;
            }
            let mut bytes = Vec::new();
            let time_us = self.time_us(unit, now);
            let inertial = data::encode(time_us, &[180.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
            wire::binary(self.addresses[unit], b'I', &inertial, &mut bytes);
            let quaternion = data::encode(time_us, &[1.0, 0.0, 0.0, 0.0]);
            wire::binary(self.addresses[unit], b'Q', &quaternion, &mut bytes);
            self.out.push_back(bytes);
        }
        self.out.pop_front()
    }
}

fn rig(addresses: &[u16]) -> Rig<XImu3Session, Pretended> {
    Rig::open(XImu3Session::new(Settings::default(), addresses).unwrap(), Pretended::new(addresses))
}

#[test]
fn a_chain_is_set_up_and_streams() {
    let mut rig = rig(&[2, 3, 0xDB]);
    rig.run_stored_ms(100);
    assert!(rig.is_streaming(), "{}", rig.reason());
    let serials: Vec<_> = rig.session.sensors().iter().map(|sensor| sensor.serial.clone().unwrap()).collect();
    assert_eq!(serials, ["SN2", "SN3", "SN219"]);
    assert_eq!(rig.warnings.len(), 3, "the unknown command of each unit: {:?}", rig.warnings);
    rig.samples.clear();
    rig.run_ms(1000);
    assert_eq!(rig.samples.len(), 600);
    let Measurement::Imu { angular_velocity_rad_s, specific_force_m_s2, .. } = rig.samples[0].measurement
    else {
        panic!()
    };
    assert_eq!(angular_velocity_rad_s, Some([std::f64::consts::PI, 0.0, 0.0]));
    assert_eq!(specific_force_m_s2, Some([0.0, 0.0, 9.80665]));
    // Four samples are averaged: the message is true 1.5 sample periods before its stamp.
    let DeviceTime::Counter { ticks: inertial, tick_s } = rig.samples[0].t_device else { panic!() };
    let DeviceTime::Counter { ticks: quaternion, .. } = rig.samples[1].t_device else { panic!() };
    assert_eq!((quaternion - inertial, tick_s), (3750, 1e-6));
    assert!(rig.session.losses().iter().all(|loss| loss.lost == 0));
    assert_eq!(rig.session.counters().rejected, 0);
}

#[test]
fn gaps_in_time_are_counted_as_estimated_losses() {
    let mut rig = rig(&[0]);
    rig.run_ms(300);
    rig.device.drop_next = 7;
    rig.run_ms(300);
    let loss = rig.session.losses()[0];
    assert_eq!((loss.lost, loss.estimated), (7, true));
}

#[test]
fn one_dead_unit_holds_up_no_other() {
    let mut rig = rig(&[2, 3]);
    rig.run_ms(300);
    rig.device.dead[1] = true;
    rig.samples.clear();
    rig.run_ms(4000);
    assert_eq!(rig.samples.iter().filter(|sample| sample.address == 2).count(), 800);
    assert!(rig.is_streaming());
    assert!(rig.warnings.iter().any(|warning| warning.contains("unit 3 is silent")), "{:?}", rig.warnings);
    rig.device.dead[1] = false;
    rig.samples.clear();
    rig.run_ms(1500);
    let back = rig.samples.iter().filter(|sample| sample.address == 3).count() as u64 / 2;
    assert!(back > 50);
    let loss = rig.session.losses()[1];
    assert!(loss.estimated && loss.lost.abs_diff(550 - back) <= 1, "{loss:?} of {back}");
}

#[test]
fn a_restart_is_noticed_by_two_stamps_in_a_row() {
    let mut rig = rig(&[0]);
    rig.run_ms(2000);
    rig.device.clock_us[0] -= 1_900_000;
    rig.samples.clear();
    rig.run_ms(500);
    assert!(rig.warnings.iter().any(|warning| warning.contains("restarted")), "{:?}", rig.warnings);
    assert!(rig.samples.len() > 80);
    assert!(rig.session.losses()[0].lost <= 2);
}

#[test]
fn a_damaged_stamp_and_merged_messages_are_refused() {
    let mut rig = rig(&[0]);
    rig.run_ms(300);
    let before = rig.session.counters();
    rig.samples.clear();
    let mut bytes = Vec::new();
    let time_us = rig.device.time_us(0, rig.now);
    wire::binary(0, b'I', &data::encode(time_us ^ 1 << 40, &[0.0; 6]), &mut bytes);
    let mut merged = Vec::new();
    wire::binary(0, b'I', &data::encode(time_us, &[0.0; 6]), &mut merged);
    merged.pop();
    wire::binary(0, b'Q', &data::encode(time_us, &[1.0, 0.0, 0.0, 0.0]), &mut merged);
    rig.session.handle_bytes(rig.now, &[bytes, merged].concat());
    assert_eq!(rig.session.poll_output(), None);
    assert_eq!(rig.session.counters().rejected - before.rejected, 2);
    assert!(rig.session.counters().bytes_skipped > before.bytes_skipped);
    rig.run_ms(100);
    assert_eq!(rig.samples.len(), 20);
}

#[test]
fn silence_is_reported() {
    let mut device = Pretended::new(&[0]);
    device.dead[0] = true;
    let mut rig = Rig::open(XImu3Session::new(Settings::default(), &[0]).unwrap(), device);
    rig.run_ms(3000);
    assert!(matches!(rig.session.state(), State::Silent { .. }), "{:?}", rig.session.state());
    rig.device.dead[0] = false;
    rig.run_ms(1500);
    assert!(rig.is_streaming(), "{}", rig.reason());
}

#[test]
fn addresses_are_checked() {
    for wanted in [&[][..], &[0, 1], &[10], &[94], &[2, 2], &[0x0A02]] {
        assert!(XImu3Session::new(Settings::default(), wanted).is_err(), "{wanted:?}");
    }
}
