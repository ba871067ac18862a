//! Liberty and Patriot: worked examples, round trips, damage, and the session against a pretended unit.

use std::collections::VecDeque;
use std::time::Duration;

use posed_drivers::polhemus::wire::{Header, Model, Numbers, Piece, Record, Shape, Splitter};
use posed_drivers::polhemus::{PolhemusSession, Settings};
use posed_drivers::{DeviceTime, Measurement, Sample, Session, State, Timestamp};
use proptest::prelude::*;

use crate::damage::{Damage, FRAMING, damaged};
use crate::hex;
use crate::matrix::Noise;
use crate::rig::{Device, Rig};

const BINARY: Shape = Shape { text: false, button: false };
const TEXT: Shape = Shape { text: true, button: false };

fn pieces(bytes: &[u8], shape: Shape) -> Vec<Piece> {
    let mut splitter = Splitter::new(shape);
    splitter.push(bytes);
    std::iter::from_fn(|| splitter.find()).collect()
}

fn records(bytes: &[u8], shape: Shape) -> Vec<Record> {
    let record = |piece| if let Piece::Record { record, .. } = piece { Some(record) } else { None };
    pieces(bytes, shape).into_iter().filter_map(record).collect()
}

/// Header and numbers of a record of any list.
fn parts(text: &str, items: &[u8]) -> (Header, Numbers) {
    let bytes = hex(text);
    let header = Header::parse(&bytes).unwrap();
    assert_eq!(usize::from(header.size), bytes.len() - 8);
    (header, Numbers::parse(items, &bytes[8..]).unwrap())
}

#[test]
fn worked_examples() {
    let l1 = "4C 59 01 43 20 00 21 00 00 00 40 41 00 00 60 C0 00 00 A2 41 00 00 00 3F 00 00 00 BF 00 00 00 3F 00 00 00 3F \
              0A 0A 00 00 20";
    let (header, numbers) = parts(l1, &[2, 7, 8, 0]);
    assert_eq!((header.model, header.station, header.command, header.error), (Model::Liberty, 1, b'C', b' '));
    assert_eq!((numbers.position, numbers.time_ms), ([12.0, -3.5, 20.25], 2570));
    assert_eq!(numbers.quaternion_wxyz, [0.5, -0.5, 0.5, 0.5]);

    let l2 = "50 41 02 50 20 00 1A 00 00 00 20 41 00 00 00 00 33 33 CB C1 00 00 F0 41 00 00 70 C1 00 00 B4 42 0D 0A";
    let (header, numbers) = parts(l2, &[2, 4, 1]);
    assert_eq!((header.model, header.station, header.command), (Model::Patriot, 2, b'P'));
    assert!((numbers.position[2] + 25.4).abs() < 1e-5 && numbers.position[..2] == [10.0, 0.0]);
    assert_eq!(numbers.angles_deg, Some([30.0, -15.0, 90.0]));

    let l3 = "4C 59 03 43 20 00 28 00 E8 03 00 00 F0 00 00 00 00 00 00 00 00 00 80 3F 00 00 00 40 00 00 40 40 00 00 80 3F \
              00 00 00 00 00 00 00 00 00 00 00 00";
    let (header, numbers) = parts(l3, &[8, 9, 11, 3, 7]);
    assert_eq!((header.station, numbers.time_ms, numbers.frame), (3, 1000, 240));
    assert_eq!((numbers.position, numbers.quaternion_wxyz), ([1.0, 2.0, 3.0], [1.0, 0.0, 0.0, 0.0]));

    let l4 = hex("4C 59 00 15 20 00 04 00 0F 00 05 00");
    assert_eq!(pieces(&l4, BINARY), [Piece::Active { model: Model::Liberty, stations: 0b101 }]);

    // A Latus is no unit of this driver; its numbers are written in the same way.
    let l5 = hex(
        "4C 55 01 43 41 00 25 00 00 00 80 3F 00 00 00 40 00 00 40 40 00 00 80 3F 00 00 00 00 00 00 00 00 00 00 00 00 \
                  A0 0F 00 00 C0 03 00 00 20",
    );
    assert_eq!(Header::parse(&l5), None);
    let numbers = Numbers::parse(&[2, 7, 8, 9, 0], &l5[8..]).unwrap();
    assert_eq!((numbers.position, numbers.time_ms, numbers.frame), ([1.0, 2.0, 3.0], 4000, 960));

    assert_eq!(pieces(&hex("50 41 00 4A 01 00 00 00"), BINARY), [Piece::Refusal { command: b'J', code: 1 }]);

    let l7 = b"01       4000        960   12.000   -3.500   20.250  0.50000 -0.50000  0.50000  0.50000\r\n\
               02A      4000        960   10.000    0.000  -25.400  1.00000  0.00000  0.00000  0.00000\r\n";
    let [first, second] = records(l7, TEXT)[..] else { panic!() };
    assert_eq!((first.station, first.status, second.station, second.status), (1, b' ', 2, b'A'));
    assert!((second.position_m[2] + 0.254).abs() < 1e-12);
    assert_eq!(first.orientation_wxyz, [0.5, -0.5, 0.5, 0.5]);
}

#[test]
fn both_ways_of_counting_the_size_and_a_status_of_0_are_taken() {
    let record = at(1, 7);
    let mut bytes = Vec::new();
    record.encode(BINARY, &mut bytes);
    bytes[6] += 8;
    bytes[4] = 0;
    assert_eq!(records(&bytes, BINARY)[0].status, b' ');
    bytes[6] += 1;
    assert_eq!(records(&bytes, BINARY), []);
}

/// Where a station is in a frame, and what the unit counts then.
fn at(station: u8, frame: u32) -> Record {
    let angle = 0.01 * f64::from(frame) + f64::from(station);
    Record {
        model: Some(Model::Liberty),
        station,
        status: b' ',
        time_ms: 1000 + frame * 1000 / 240,
        frame,
        position_m: [0.5 + 0.1 * libm::sin(angle), 0.1 * libm::cos(angle), f64::from(station) * 0.05],
        orientation_wxyz: [libm::cos(0.5 * angle), 0.0, libm::sin(0.5 * angle), 0.0],
        button: None,
    }
}

#[test]
fn the_letters_of_a_tag_in_a_number_break_nothing() {
    // 0x3F4C594C is a number between 0 and 1, and holds `LY`, as does the time.
    let mut record = at(1, 7);
    record.position_m[0] = f64::from(f32::from_bits(0x3F59_4C59)) * 0.01;
    record.time_ms = 0x594C_594C;
    let mut bytes = Vec::new();
    record.encode(BINARY, &mut bytes);
    for cut in 0..bytes.len() {
        let stream = [&bytes[cut..], &bytes.repeat(4)].concat();
        let found = records(&stream, BINARY);
        assert!(found.len() >= 4, "cut at {cut}: {}", found.len());
        assert!(found.iter().all(|record| record.time_ms == 0x594C_594C && record.frame == 7));
    }
}

proptest! {
    #[test]
    fn round_trip(
        station in 1_u8..=16,
        position_m in proptest::array::uniform3(-3.0_f64..3.0),
        q in proptest::array::uniform4(-1.0_f64..1.0).prop_filter("long", |q| q.iter().map(|v| v * v).sum::<f64>() > 0.1),
        (time_ms, frame) in (0..u32::MAX, 0..u32::MAX),
        text: bool,
        button: bool,
    ) {
        let norm = q.iter().map(|v| v * v).sum::<f64>().sqrt();
        let orientation_wxyz = q.map(|v| v / norm);
        let model = Some(Model::Patriot).filter(|_| !text);
        let record = Record { model, station, status: b'u', time_ms, frame, position_m, orientation_wxyz, button: Some(button) };
        let shape = Shape { text, button };
        let mut bytes = Vec::new();
        record.encode(shape, &mut bytes);
        let [back] = records(&bytes, shape)[..] else { panic!("{bytes:?}") };
        prop_assert_eq!((back.model, back.station, back.status), (model, station, b'u'));
        prop_assert_eq!((back.time_ms, back.frame, back.button), (time_ms, frame, Some(true).filter(|_| button)));
        for (a, b) in back.position_m.iter().chain(&back.orientation_wxyz).zip(position_m.iter().chain(&orientation_wxyz)) {
            prop_assert!((a - b).abs() < 2e-5, "{} {}", a, b);
        }
    }
}

/// A unit that obeys the commands that set-up uses.
struct Pretended {
    stations: Vec<u8>,
    shape: Shape,
    streams: bool,
    dead: bool,
    status: u8,
    frame: u32,
    next: Timestamp,
    period: Duration,
    skip: u32,
    received: Vec<u8>,
    out: VecDeque<Vec<u8>>,
}

impl Pretended {
    fn new(stations: &[u8]) -> Self {
        Self {
            stations: stations.to_vec(),
            shape: BINARY,
            streams: false,
            dead: false,
            status: b' ',
            frame: 100,
            next: Timestamp::from_secs_f64(1.0),
            period: Duration::from_nanos(4_166_667),
            skip: 0,
            received: Vec::new(),
            out: VecDeque::new(),
        }
    }
}

impl Device for Pretended {
    fn receive(&mut self, _: Timestamp, bytes: &[u8]) {
        self.received.extend(bytes);
        if self.dead {
            return;
        }
        let text = String::from_utf8_lossy(bytes);
        if text.contains("\rP") {
            self.streams = false;
        }
        if text.contains("\u{15}0\r") {
            let mut answer = Vec::new();
            Header { model: Model::Liberty, station: 0, command: 0x15, error: b' ', size: 4 }
                .encode(&mut answer);
            let map = self.stations.iter().fold(0_u16, |map, station| map | 1 << (station - 1));
            answer.extend([map.to_le_bytes(), map.to_le_bytes()].concat());
            self.out.push_back(answer);
        }
        if text.ends_with("C\r") {
            assert!(text.starts_with("U1\rH*,"), "{text}");
            self.shape = Shape { text: text.contains("F0\r"), button: text.contains(",10,") };
            self.streams = true;
        }
    }

    fn send(&mut self, now: Timestamp) -> Option<Vec<u8>> {
        if let Some(answer) = self.out.pop_front() {
            return Some(answer);
        }
        if now < self.next {
            return None;
        }
        self.next = self.next + self.period;
        self.frame += 1;
        if self.skip > 0 {
            self.skip -= 1;
            return Some(Vec::new());
        }
        let mut bytes = Vec::new();
        for &station in self.stations.iter().filter(|_| self.streams && !self.dead) {
            Record { status: self.status, ..at(station, self.frame) }.encode(self.shape, &mut bytes);
        }
        Some(bytes)
    }
}

fn rig(settings: Settings, wanted: &[u16]) -> Rig<PolhemusSession, Pretended> {
    Rig::open(PolhemusSession::new(settings, 0, wanted).unwrap(), Pretended::new(&[1, 2, 3]))
}

#[test]
fn a_unit_is_set_up_and_streams_with_its_own_time() {
    for text in [false, true] {
        for button in [false, true] {
            let mut rig = rig(Settings { text, button, ..Settings::default() }, &[1, 3]);
            rig.run_stored_ms(750);
            assert!(rig.is_streaming(), "{}", rig.reason());
            assert_eq!(rig.session.rate_hz(), Some(240.0));
            rig.samples.clear();
            rig.run_ms(1000);
            assert!((478..=482).contains(&rig.samples.len()), "{}", rig.samples.len());
            for sample in &rig.samples {
                let DeviceTime::Counter { ticks, tick_s } = sample.t_device else { panic!() };
                assert!((tick_s - 1e-6).abs() < 1e-15);
                let behind_s = sample.arrival.t_read.as_secs_f64() - ticks as f64 * 1e-6;
                assert!((behind_s + 0.417).abs() < 6e-3, "{behind_s}");
            }
            assert!(rig.session.losses().iter().all(|loss| loss.lost == 0));
            assert_eq!(
                (rig.session.counters().rejected, rig.warnings.len()),
                (1, 0),
                "the first is proven by the second"
            );
        }
    }
}

#[test]
fn frames_that_are_missing_are_counted_by_the_unit() {
    let mut rig = rig(Settings::default(), &[1, 2]);
    rig.run_ms(1000);
    rig.device.skip = 37;
    rig.run_stored_ms(500);
    assert!(
        rig.session.losses().iter().all(|loss| loss.lost == 37 && !loss.estimated),
        "{:?}",
        rig.session.losses()
    );
    // It counts anew, as after `Q0` of another program.
    rig.device.frame = 3;
    rig.run_ms(300);
    let [first, second] = rig.session.losses() else { panic!() };
    assert!(first.lost.abs_diff(38) <= 1 && second.lost.abs_diff(38) <= 1, "{:?}", rig.session.losses());
    rig.samples.clear();
    rig.run_ms(100);
    assert!(rig.samples.len() >= 46, "{}", rig.samples.len());
}

#[test]
fn an_error_letter_marks_the_pose_and_a_missing_sensor_is_reported() {
    let mut rig = rig(Settings::default(), &[1, 5]);
    rig.run_ms(1000);
    assert!(rig.warnings.iter().any(|text| text.contains("station 5 has no sensor")), "{:?}", rig.warnings);
    rig.device.status = b'A';
    rig.samples.clear();
    rig.run_ms(200);
    let marked = |sample: &Sample| {
        matches!(sample.measurement, Measurement::Pose { clipped: true, position_m: Some(_), .. })
    };
    assert!(rig.samples.len() > 40 && rig.samples.iter().all(marked));
    assert!(rig.warnings.iter().any(|text| text.contains("error A")), "{:?}", rig.warnings);
}

#[test]
fn a_line_that_is_too_slow_is_reported() {
    let warned = |baud, stations: &[u8]| {
        let wanted: Vec<u16> = stations.iter().copied().map(u16::from).collect();
        let session = PolhemusSession::new(Settings::default(), baud, &wanted).unwrap();
        let mut rig = Rig::open(session, Pretended::new(stations));
        rig.run_ms(800);
        rig.warnings.iter().any(|text| text.contains("records will be missing"))
    };
    assert!(warned(115_200, &[1, 2, 3, 4, 5, 6, 7, 8]));
    assert!(!warned(115_200, &[1]) && !warned(0, &[1, 2, 3, 4, 5, 6, 7, 8]));
}

#[test]
fn silence_is_reported_and_the_unit_reset_and_it_returns() {
    let mut rig = rig(Settings::default(), &[1]);
    rig.run_ms(1000);
    rig.device.dead = true;
    rig.run_ms(6000);
    assert!(matches!(rig.session.state(), State::Silent { .. }));
    let resets = |rig: &Rig<_, Pretended>| rig.device.received.iter().filter(|&&byte| byte == 0x19).count();
    assert_eq!(resets(&rig), 1);
    rig.run_ms(12_000);
    assert_eq!(resets(&rig), 1, "a unit that is being reset is left to it");
    rig.device.dead = false;
    rig.run_ms(2500);
    assert!(rig.is_streaming(), "{}", rig.reason());
}

#[test]
fn settings_and_stations_are_checked() {
    for wanted in [&[][..], &[0], &[17], &[1, 1], &[256]] {
        assert!(PolhemusSession::new(Settings::default(), 0, wanted).is_err(), "{wanted:?}");
    }
    let follows = Settings { hemisphere: [0.0; 3], ..Settings::default() };
    assert!(PolhemusSession::new(follows, 0, &[1]).is_err());
}

/// Gives a damaged stream of two stations to a session that streams, and holds each sample against the truth; returns samples and
/// those that are wrong.
fn wrong(text: bool, kinds: &[Damage], seed: u64) -> (usize, usize) {
    const FRAMES: u32 = 120;
    let mut rig = rig(Settings { text, ..Settings::default() }, &[1, 2]);
    rig.run_ms(700);
    rig.samples.clear();
    let first = rig.device.frame + 1;
    let frames: Vec<Vec<u8>> = (first..first + FRAMES)
        .flat_map(|frame| [1, 2].map(|station| at(station, frame)))
        .map(|record| {
            let mut bytes = Vec::new();
            record.encode(rig.device.shape, &mut bytes);
            bytes
        })
        .collect();
    let mut noise = Noise::new(seed);
    let mut samples = Vec::new();
    let mut now = rig.now;
    for pair in damaged(&frames, kinds, &mut noise).chunks(2) {
        now = now + Duration::from_nanos(4_166_667);
        rig.session.handle_bytes(now, &pair.concat());
        while let Some(output) = rig.session.poll_output() {
            if let posed_drivers::Output::Sample(sample) = output {
                samples.push(sample);
            }
        }
    }
    let is_true = |sample: &Sample| {
        let Measurement::Pose { position_m: Some(p), orientation_wxyz: Some(q), .. } = sample.measurement
        else {
            return false;
        };
        (first..first + FRAMES).map(|frame| at(sample.address as u8, frame)).any(|record| {
            let DeviceTime::Counter { ticks, .. } = sample.t_device else { return false };
            let apart = p.iter().chain(&q).zip(record.position_m.iter().chain(&record.orientation_wxyz));
            ticks / 1000 == u64::from(record.time_ms) && apart.into_iter().all(|(a, b)| (a - b).abs() < 2e-5)
        })
    };
    (samples.len(), samples.iter().filter(|sample| !is_true(sample)).count())
}

#[test]
fn what_is_lost_added_or_cut_makes_no_wrong_pose() {
    for text in [false, true] {
        let runs = (0..500).map(|seed| wrong(text, &FRAMING, seed));
        let (samples, wrong) = runs.fold((0, 0), |(all, bad), (samples, wrong)| (all + samples, bad + wrong));
        assert!(samples > 500 * 150, "{samples} of {}", 500 * 240);
        assert_eq!(wrong, 0, "text {text}");
    }
}

#[test]
fn a_flipped_bit_anywhere_but_in_the_pose_makes_no_wrong_one() {
    for bit in (0..8 * 16).chain(8 * 44..8 * 45) {
        let mut rig = rig(Settings::default(), &[1]);
        rig.device.stations = vec![1];
        rig.run_ms(700);
        rig.samples.clear();
        let mut now = rig.now;
        for frame in rig.device.frame + 1..rig.device.frame + 8 {
            let mut bytes = Vec::new();
            at(1, frame).encode(BINARY, &mut bytes);
            if frame == rig.device.frame + 3 {
                bytes[bit / 8] ^= 1 << (bit % 8);
            }
            now = now + Duration::from_nanos(4_166_667);
            rig.session.handle_bytes(now, &bytes);
            while let Some(output) = rig.session.poll_output() {
                let posed_drivers::Output::Sample(sample) = output else { continue };
                let DeviceTime::Counter { ticks, .. } = sample.t_device else { panic!() };
                // The lowest bits of the time are within what whole milliseconds leave open.
                let off_ms = (ticks / 1000).abs_diff(u64::from(at(1, frame).time_ms));
                assert!(off_ms <= 2 || frame != rig.device.frame + 3, "bit {bit}: {off_ms} ms");
            }
        }
    }
}
