//! MotionStar: worked examples, round trips, and the session against a pretended server.

use std::collections::VecDeque;
use std::time::Duration;

use posed_drivers::flock::wire::{Format, QuaternionSense};
use posed_drivers::motionstar::wire::{self, BirdStatus, Header, Packets, Pose, SystemStatus, kind};
use posed_drivers::motionstar::{MotionStarSession, Settings};
use posed_drivers::rate::Rate;
use posed_drivers::{Measurement, Output, Session, State, Timestamp};
use proptest::prelude::*;

use crate::hex;
use crate::rig::{Device, Rig};

const IN: f64 = 0.0254;

fn packet(bytes: &[u8]) -> (Header, Vec<u8>) {
    let mut packets = Packets::default();
    packets.push(bytes);
    let found = packets.find().unwrap();
    (found.header, packets.body(found).to_vec())
}

#[test]
fn worked_examples() {
    let mut bytes = Vec::new();
    Header { sequence: 1, kind: kind::WAKE_UP, ..Header::default() }.encode(&[], &mut bytes);
    assert_eq!(bytes, hex("00 01 00 00 00 00 00 00 0A 00 03 00 00 00 00 00"));

    let (header, body) = packet(&hex(
        "00 02 00 00 3B 9A CA 00 C9 00 03 00 00 00 00 13 84 00 03 01 10 31 30 33 33 30 30 01 03 01 01 02 D1 E0 E0",
    ));
    assert_eq!((header.sequence, header.kind, header.seconds), (2, kind::RSP_GET_STATUS, 1_000_000_000));
    let system = SystemStatus::parse(&body).unwrap();
    assert_eq!(system.rate().map(Rate::hz), Ok(103.3));
    assert_eq!(system.sensors().collect::<Vec<_>>(), [2, 3]);
    assert_eq!(&system.with_rate(86.1)[5..11], b"086100");

    let mut body = hex("44 06 03 43 00 07 64 01 00 90 00 02 00 00 00 00");
    body.resize(wire::BIRD_STATUS, 0);
    let bird = BirdStatus::parse(&body).unwrap();
    assert!(bird.has_sensor());
    assert!((bird.range_m().unwrap() - 144.0 * IN).abs() < 1e-12);
    assert_eq!(bird.with(Format::PositionQuaternion, 2, 3, true)[5..11], [0x0F, 0x78, 2, 0x00, 0x90, 3]);

    let (header, body) = packet(&hex(
        "00 2A 00 FA 3B 9A CA 00 D2 00 03 00 00 00 00 20 82 46 2A AB E5 55 35 55 AA AB 07 1C 20 00 00 01 03 87 00 E4
         01 C7 02 AB 53 9F A6 44 F4 30 DD 5D",
    ));
    assert_eq!((header.sequence, header.millis, header.kind), (42, 250, kind::DATA_PACKET));
    let records: Vec<_> = wire::records(&body).unwrap().collect();
    assert_eq!((records[0].address, records[0].buttons), (2, Some([0, 1])));
    let pose = |k: usize| records[k].pose(144.0 * IN, QuaternionSense::Direct).unwrap().unwrap();
    for (value, expected) in pose(0).position_m.unwrap().iter().zip([48.0015, -30.0015, 59.9985]) {
        assert!((value / IN - expected).abs() < 1e-4);
    }
    let angles = posed_drivers::flock::wire::rotation::to_angles(pose(0).orientation_wxyz.unwrap());
    for (angle, expected) in angles.iter().zip([-119.9982_f64, 9.9976, 45.0]) {
        assert!((angle.to_degrees() - expected).abs() < 1e-4);
    }
    for (value, expected) in pose(1).position_m.unwrap().iter().zip([1.0020, 1.9995, 3.0015]) {
        assert!((value / IN - expected).abs() < 1e-4);
    }
    for (value, expected) in
        pose(1).orientation_wxyz.unwrap().iter().zip([0.65329, -0.70105, -0.09229, -0.27060])
    {
        assert!((value - expected).abs() < 1e-4);
    }
}

#[test]
fn a_body_that_lost_bytes_costs_the_packet_after_it_nothing() {
    let pose = Pose { position_m: Some([0.1, 0.2, 0.3]), orientation_wxyz: Some([0.5, 0.5, 0.5, 0.5]) };
    let packet = |sequence: u16| {
        let mut body = Vec::new();
        for address in [2, 3] {
            let format = Format::PositionQuaternion;
            wire::encode_record(address, format, pose, 3.0, QuaternionSense::Direct, None, &mut body);
        }
        let mut bytes = Vec::new();
        Header { sequence, kind: kind::DATA_PACKET, ..Header::default() }.encode(&body, &mut bytes);
        bytes
    };
    // From the words of the last record; what is lost before them makes another record of the rest.
    let words = wire::HEADER + 16 + 2;
    for (lost, count) in [(words, 1), (words + 3, 2), (packet(0).len() - 1, 1), (packet(0).len() - 9, 9)] {
        let mut bytes = packet(7);
        bytes.drain(lost..lost + count);
        bytes.extend(packet(8));
        bytes.extend(packet(9));
        for size in [1, 5, bytes.len()] {
            let mut packets = Packets::default();
            let mut numbers = Vec::new();
            for piece in bytes.chunks(size) {
                packets.push(piece);
                while let Some(found) = packets.find() {
                    assert_eq!(packets.body(found).len(), 32);
                    numbers.push(found.header.sequence);
                }
            }
            assert_eq!(numbers, [7, 8, 9], "{count} lost at {lost}, {size} at a time");
        }
    }
}

#[test]
fn bad_data_are_not_used_and_records_must_fill_their_packet() {
    let record = |bytes: &[u8]| {
        wire::records(bytes).map(|mut records| records.next().unwrap().pose(3.0, QuaternionSense::Vendor))
    };
    assert_eq!(record(&hex("02 F1 00 00")), Some(Err(wire::BadRecord)), "marked as bad");
    assert_eq!(record(&hex("02 E1 00 00")), Some(Ok(None)), "a wand");
    assert_eq!(record(&hex("02 13 00 00 00 00 00")), None, "too short");
    assert_eq!(record(&hex("02 12 00 00 00 00")), Some(Err(wire::BadRecord)), "two words are no position");
    assert_eq!(
        record(&hex("02 74 10 00 00 00 00 00 00 00")),
        Some(Err(wire::BadRecord)),
        "no unit quaternion"
    );
    assert_eq!(
        record(&hex("02 39 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00")),
        Some(Err(wire::BadRecord))
    );
}

proptest! {
    #[test]
    fn round_trip(
        position_m in proptest::array::uniform3(-0.9_f64..0.9),
        angles in proptest::array::uniform3(-1.5_f64..1.5),
        format in proptest::sample::select(&Format::ALL[..]),
        vendor: bool,
        buttons in proptest::option::of(proptest::array::uniform2(0_u8..128)),
    ) {
        let sense = if vendor { QuaternionSense::Vendor } else { QuaternionSense::Direct };
        let q = posed_drivers::flock::wire::rotation::from_angles(angles);
        let pose = Pose { position_m: Some(position_m), orientation_wxyz: Some(q) };
        let mut body = Vec::new();
        wire::encode_record(7, format, pose, 0.9144, sense, buttons, &mut body);
        let records: Vec<_> = wire::records(&body).unwrap().collect();
        prop_assert_eq!((records.len(), records[0].address, records[0].buttons), (1, 7, buttons));
        let back = records[0].pose(0.9144, sense).unwrap().unwrap();
        prop_assert_eq!(back.position_m.is_some(), format.has_position());
        for (a, b) in back.position_m.into_iter().flatten().zip(position_m) {
            prop_assert!((a - b).abs() <= 0.51 * 0.9144 / 32768.0);
        }
        if let Some(back) = back.orientation_wxyz {
            let dot: f64 = back.iter().zip(q).map(|(a, b)| a * b).sum();
            prop_assert!(dot.abs() > 1.0 - 1e-6, "{:?} {:?}", back, q);
        }
    }
}

/// A byte of a packet, by its place.
#[derive(Clone, Copy, Debug)]
enum Damage {
    Lost(usize),
    Added(usize),
}

struct Pretended {
    packets: Packets,
    out: VecDeque<Vec<u8>>,
    running: bool,
    dead: bool,
    formats: Vec<u8>,
    next: Timestamp,
    sequence: u16,
    writes: usize,
    /// Six digits of its measurement rate, mHz.
    rate: String,
    /// What happens to the next data packet on its way.
    damage: Option<Damage>,
}

impl Pretended {
    fn new() -> Self {
        Self {
            packets: Packets::default(),
            out: VecDeque::new(),
            running: true,
            dead: false,
            formats: vec![0x64; 3],
            next: Timestamp::ZERO,
            sequence: 500,
            writes: 0,
            rate: "100000".into(),
            damage: None,
        }
    }

    fn answer(&mut self, question: Header, kind: u8, body: &[u8]) {
        let mut bytes = Vec::new();
        Header { kind, ..question }.encode(body, &mut bytes);
        self.out.push_back(bytes);
    }
}

impl Device for Pretended {
    fn receive(&mut self, _: Timestamp, bytes: &[u8]) {
        self.packets.push(bytes);
        while let Some(found) = self.packets.find() {
            let (header, body) = (found.header, self.packets.body(found).to_vec());
            if self.dead {
                continue;
            }
            match (header.kind, header.unit) {
                (kind::STOP_DATA, _) => {
                    self.running = false;
                    self.answer(header, kind::RSP_STOP_DATA, &[]);
                }
                (kind::WAKE_UP, _) => self.answer(header, kind::RSP_WAKE_UP, &[]),
                (kind::GET_STATUS, 0) => {
                    let mut body = hex("84 00 03 01 10 31 30 30 30 30 30 01 03 01 01 02 D1 E0 E0");
                    body[5..11].copy_from_slice(self.rate.as_bytes());
                    self.answer(header, kind::RSP_GET_STATUS, &body);
                }
                (kind::GET_STATUS, unit @ 1..=3) => {
                    let mut body = hex("44 06 03 43 00 07 64 01 00 90 00 02 00 00 00 00");
                    body[0] = if unit == 1 { 0x40 } else { 0x44 };
                    body[11] = unit;
                    body.resize(wire::BIRD_STATUS, 0);
                    self.answer(header, kind::RSP_GET_STATUS, &body);
                }
                (kind::SEND_SETUP, unit @ 1..=3) => {
                    assert!(!self.running, "set up while running");
                    self.writes += 1;
                    self.formats[usize::from(unit) - 1] = body[6];
                    self.answer(header, kind::RSP_SEND_SETUP, &[]);
                }
                (kind::RUN_CONTINUOUS, _) => {
                    self.running = true;
                    self.answer(header, kind::RSP_RUN_CONTINUOUS, &[]);
                }
                _ => self.answer(Header { error: 8, ..header }, kind::RSP_ILLEGAL, &[]),
            }
        }
    }

    fn send(&mut self, now: Timestamp) -> Option<Vec<u8>> {
        if self.running && !self.dead && now >= self.next {
            self.next = now + Duration::from_millis(10);
            self.sequence = self.sequence.wrapping_add(1);
            let mut body = Vec::new();
            for unit in [2, 3] {
                let format = Format::from_status_code(self.formats[usize::from(unit) - 1] & 0x0F).unwrap();
                let pose = Pose {
                    position_m: Some([0.5, 0.25, -0.125]),
                    orientation_wxyz: Some([0.5, -0.5, 0.5, 0.5]),
                };
                wire::encode_record(unit, format, pose, 144.0 * IN, QuaternionSense::Vendor, None, &mut body);
            }
            let millis = now.as_nanos() / 1_000_000;
            let header = Header {
                sequence: self.sequence,
                millis: (millis % 1000) as u16,
                seconds: 1_000_000_000 + (millis / 1000) as u32,
                kind: kind::DATA_PACKET,
                ..Header::default()
            };
            let mut bytes = Vec::new();
            header.encode(&body, &mut bytes);
            match self.damage.take() {
                Some(Damage::Lost(at)) => drop(bytes.remove(at)),
                Some(Damage::Added(at)) => bytes.insert(at, 0x55),
                None => {}
            }
            self.out.push_back(bytes);
        }
        self.out.pop_front()
    }
}

fn rig(wanted: &[u16]) -> Rig<MotionStarSession, Pretended> {
    Rig::open(MotionStarSession::new(Settings::default(), wanted).unwrap(), Pretended::new())
}

#[test]
fn a_system_is_set_up_and_streams() {
    let mut rig = rig(&[2, 3]);
    rig.run_stored_ms(100);
    assert!(rig.is_streaming(), "{}", rig.reason());
    assert_eq!((rig.device.writes, rig.session.rate_hz()), (2, Some(100.0)));
    rig.samples.clear();
    rig.run_ms(1000);
    assert_eq!(rig.samples.len(), 200);
    assert_eq!(
        (rig.samples[0].arrival.cycle_bytes_before, rig.samples[1].arrival.cycle_bytes_before),
        (16, 32)
    );
    let Measurement::Pose { position_m, orientation_wxyz, .. } = rig.samples[1].measurement else { panic!() };
    for (value, expected) in position_m.unwrap().iter().zip([0.5, 0.25, -0.125]) {
        assert!((value - expected).abs() < 1e-4);
    }
    assert_eq!(orientation_wxyz, Some([0.5, -0.5, 0.5, 0.5]));
    assert!(rig.warnings.is_empty(), "{:?}", rig.warnings);
}

#[test]
fn lost_packets_are_counted() {
    let mut rig = rig(&[2, 3]);
    rig.run_ms(300);
    rig.device.sequence = rig.device.sequence.wrapping_add(5);
    rig.run_ms(100);
    // By the packets' numbers, which the device gives.
    assert!(rig.session.losses().iter().all(|loss| loss.lost == 5 && !loss.estimated));
}

#[test]
fn a_packet_that_does_not_follow_is_refused_and_a_new_count_believed() {
    let mut rig = rig(&[2, 3]);
    rig.run_ms(1000);
    let before = rig.session.counters();
    rig.samples.clear();
    rig.device.sequence = rig.device.sequence.wrapping_add(20_000);
    rig.run_stored_ms(200);
    let counters = rig.session.counters();
    assert_eq!(counters.rejected - before.rejected, 1);
    assert!(rig.samples.len() > 20, "{}", rig.samples.len());
    assert!(rig.session.losses().iter().all(|loss| loss.lost == 0), "{:?}", rig.session.losses());
}

/// Angles can be anything; what tells that a record has lost or gained a byte is that no packet begins where its own ends.
#[test]
fn a_packet_behind_which_none_can_begin_is_refused() {
    let settings = Settings { format: Format::PositionAngles, ..Settings::default() };
    let mut rig = Rig::open(MotionStarSession::new(settings, &[2, 3]).unwrap(), Pretended::new());
    rig.run_ms(1000);
    let expected = rig.samples[0].measurement;
    assert!(rig.samples.iter().all(|sample| sample.measurement == expected));
    let len = wire::HEADER + 2 * (2 + 12);
    for at in 0..len {
        for damage in [Damage::Added(at), Damage::Lost(at)] {
            rig.samples.clear();
            rig.device.damage = Some(damage);
            // What is damaged, and what comes in one read with those that follow.
            if at % 2 == 0 {
                rig.run_stored_ms(60)
            } else {
                rig.hold_back_ms(60)
            }
            assert!(rig.samples.len() >= 8, "{damage:?}: {} samples", rig.samples.len());
            for sample in &rig.samples {
                assert_eq!(sample.measurement, expected, "{damage:?}");
            }
        }
    }
}

#[test]
fn a_read_that_ends_within_a_header_costs_no_record() {
    let mut rig = rig(&[2, 3]);
    rig.run_ms(1000);
    let len = wire::HEADER + 2 * (2 + 14);
    for cut in 1..=wire::HEADER + 4 {
        let mut stream = Vec::new();
        while stream.len() < 2 * len {
            rig.now = rig.now + Duration::from_millis(1);
            stream.extend(rig.device.send(rig.now).into_iter().flatten());
        }
        let (one, other) = stream.split_at(len + cut);
        rig.session.handle_bytes(rig.now, one);
        rig.session.handle_bytes(rig.now, other);
        let outputs = std::iter::from_fn(|| rig.session.poll_output());
        let samples = outputs.filter(|output| matches!(output, Output::Sample(_))).count();
        assert_eq!(samples, 4, "the first read has {cut} bytes of the second packet");
    }
}

#[test]
fn a_rate_that_cannot_be_is_not_believed() {
    for digits in ["000000", "000001", "999999", "garbag"] {
        let mut rig = rig(&[2, 3]);
        rig.device.rate = digits.into();
        rig.run_ms(200);
        assert!(rig.is_streaming(), "{}", rig.reason());
        assert_eq!(rig.session.rate_hz(), None);
        assert!(rig.warnings[0].contains("cannot be"), "{:?}", rig.warnings);
    }
}

#[test]
fn bytes_of_refused_records_are_counted() {
    let mut rig = rig(&[2, 3]);
    rig.run_ms(300);
    let before = rig.session.counters();
    let body = hex("02 F1 00 00");
    let mut packet = Vec::new();
    let header = Header { sequence: rig.device.sequence, kind: kind::DATA_PACKET, ..Header::default() };
    header.encode(&body, &mut packet);
    rig.device.out.push_back(packet);
    rig.run_ms(5);
    let counters = rig.session.counters();
    assert_eq!(counters.rejected - before.rejected, 1);
    assert_eq!(counters.bytes_skipped - before.bytes_skipped, body.len() as u64);
}

#[test]
fn a_unit_without_sensor_is_named_and_the_others_go_on() {
    let mut rig = rig(&[1, 2, 9]);
    rig.run_ms(500);
    assert!(rig.is_streaming(), "{}", rig.reason());
    assert!(rig.warnings.iter().any(|warning| warning.contains("address 1")), "{:?}", rig.warnings);
    assert!(rig.warnings.iter().any(|warning| warning.contains("address 9")), "{:?}", rig.warnings);
}

#[test]
fn silence_is_reported_and_ended() {
    let mut rig = rig(&[2]);
    rig.run_ms(500);
    rig.device.dead = true;
    rig.run_ms(8000);
    assert!(matches!(rig.session.state(), State::Silent { .. }));
    rig.device.dead = false;
    let before = rig.samples.len() as u64;
    rig.run_ms(4000);
    assert!(rig.is_streaming(), "{}", rig.reason());
    let (loss, ours) = (rig.session.losses()[0], rig.samples.len() as u64 - before);
    assert!(loss.estimated && (loss.lost + ours).abs_diff(1200) <= 1, "{loss:?} and {ours}");
}
