//! WitMotion: worked examples, round trips, damage, and the session against a pretended sensor.

use std::collections::VecDeque;
use std::time::Duration;

use posed_drivers::witmotion::wire::{self, Group, Piece, Splitter, kind};
use posed_drivers::witmotion::{Settings, WitMotionSession};
use posed_drivers::{LineEvent, Measurement, Output, Sample, Session, State, Timestamp};
use proptest::prelude::*;

use crate::damage::{Damage, FRAMING, damaged};
use crate::hex;
use crate::matrix::Noise;
use crate::rig::{Device, Rig};

fn words(text: &str) -> (u8, [i16; 4]) {
    wire::parse(&hex(text)).unwrap()
}

fn group_of(frames: &[&str]) -> Group {
    let mut splitter = Splitter::new();
    splitter.push(&hex(&frames.concat()));
    let Some(Piece::Group { group, .. }) = splitter.find() else { panic!() };
    group
}

const W1: &str = "55 51 00 00 00 00 00 08 D0 09 87";
const W2: &str = "55 52 66 06 CD FC 00 00 00 00 DC";
const W3: &str = "55 53 55 15 55 F5 00 40 EE 02 8C";
const W5: &str = "55 59 00 40 00 40 00 C0 00 40 2E";

#[test]
fn worked_examples() {
    let group = group_of(&[W1, W2, W3, W5]);
    assert!((group.specific_force_m_s2[2] - 9.80665).abs() < 1e-9 && group.specific_force_m_s2[0] == 0.0);
    let [x, y, z] = group.angular_velocity_rad_s.map(f64::to_degrees);
    assert!((x - 100.0).abs() < 0.05 && (y + 50.0).abs() < 0.05 && z == 0.0, "{x} {y}");
    for (angle, degrees) in group.angles_rad.iter().zip([29.998_f64, -15.002, 90.0]) {
        assert!((angle.to_degrees() - degrees).abs() < 1e-3, "{angle}");
    }
    assert_eq!(group.quaternion, [0.5, 0.5, -0.5, 0.5]);
    // Frames that are not asked for: field, time, pressure.
    assert_eq!(words("55 54 68 01 69 00 86 FF D0 09 D9"), (0x54, [360, 105, -122, 2512]));
    assert_eq!(words("55 50 1A 0B 17 07 05 09 FA 00 F0").0, 0x50);
    assert_eq!(words("55 56 CD 8B 01 00 A8 11 00 00 BD").0, 0x56);
    let mut splitter = Splitter::new();
    splitter.push(&hex("55 5F 09 00 06 00 00 00 00 00 C3"));
    assert_eq!(splitter.find(), Some(Piece::Registers([9, 6, 0, 0])));
    assert_eq!(wire::write(wire::register::KEY, wire::KEY).to_vec(), hex("FF AA 69 88 B5"));
    assert_eq!(wire::write(wire::register::RATE, 9).to_vec(), hex("FF AA 03 09 00"));
    assert_eq!(wire::read(0x3A).to_vec(), hex("FF AA 27 3A 00"));
}

proptest! {
    #[test]
    fn round_trip(
        force in proptest::array::uniform3(-150.0_f64..150.0),
        turn in proptest::array::uniform3(-30.0_f64..30.0),
        angles_rad in proptest::array::uniform3(-3.1_f64..3.1),
        q in proptest::array::uniform4(-1.0_f64..1.0).prop_filter("long", |q| q.iter().map(|v| v * v).sum::<f64>() > 0.1),
    ) {
        let norm = q.iter().map(|v| v * v).sum::<f64>().sqrt();
        let group = Group { specific_force_m_s2: force, angular_velocity_rad_s: turn, angles_rad, quaternion: q.map(|v| v / norm) };
        let mut bytes = Vec::new();
        group.encode(&mut bytes);
        let mut splitter = Splitter::new();
        splitter.push(&bytes);
        let Some(Piece::Group { group: back, .. }) = splitter.find() else { panic!() };
        let pairs = [(back.specific_force_m_s2, force, 3e-3), (back.angular_velocity_rad_s, turn, 1e-3), (back.angles_rad, angles_rad, 1e-4)];
        for (found, put, step) in pairs {
            for (a, b) in found.iter().zip(put) {
                prop_assert!((a - b).abs() < step, "{} {}", a, b);
            }
        }
    }
}

/// How the quaternion of a pretended sensor stands on the wire.
#[derive(Clone, Copy, PartialEq)]
enum Writes {
    First,
    Last,
    Nonsense,
}

/// What a sensor measures as its `n`-th sample.
fn measured(n: u32, writes: Writes) -> Group {
    let angle = 0.02 * f64::from(n);
    let (roll, pitch, yaw) = (0.3 * libm::sin(angle), 0.2 * libm::cos(angle), 0.5 * libm::sin(angle));
    let [w, x, y, z] = posed_drivers::flock::wire::rotation::from_angles([yaw, pitch, roll]);
    Group {
        specific_force_m_s2: [0.1 * f64::from(n % 7), 0.0, 9.81],
        angular_velocity_rad_s: [0.01 * f64::from(n % 11), 0.0, 0.5],
        angles_rad: [roll, pitch, yaw],
        quaternion: match writes {
            Writes::First => [w, x, y, z],
            Writes::Last => [x, y, z, w],
            Writes::Nonsense => [0.0, 0.6, 0.8, 0.0],
        },
    }
}

struct Pretended {
    writes: Writes,
    registers: [u16; 256],
    unlocked: bool,
    is_locked_for_good: bool,
    answers: bool,
    dead: bool,
    n: u32,
    next: Timestamp,
    received: Vec<u8>,
    out: VecDeque<Vec<u8>>,
}

impl Pretended {
    fn new() -> Self {
        let mut registers = [0; 256];
        registers[2] = 0x0E;
        registers[3] = 6;
        Self {
            writes: Writes::First,
            registers,
            unlocked: false,
            is_locked_for_good: false,
            answers: true,
            dead: false,
            n: 0,
            next: Timestamp::from_secs_f64(1.0),
            received: Vec::new(),
            out: VecDeque::new(),
        }
    }
}

impl Device for Pretended {
    fn receive(&mut self, _: Timestamp, bytes: &[u8]) {
        self.received.extend(bytes);
        let &[0xFF, 0xAA, register, low, high] = bytes else { panic!("{bytes:?}") };
        let value = u16::from_le_bytes([low, high]);
        match register {
            0x69 => self.unlocked = value == wire::KEY && !self.is_locked_for_good,
            0x27 if self.answers && !self.dead => {
                let words = std::array::from_fn(|k| self.registers[usize::from(low) + k] as i16);
                let mut answer = Vec::new();
                wire::frame(kind::REGISTERS, words, &mut answer);
                self.out.push_back(answer);
            }
            _ if self.unlocked => self.registers[usize::from(register)] = value,
            _ => {}
        }
    }

    fn send(&mut self, now: Timestamp) -> Option<Vec<u8>> {
        if let Some(answer) = self.out.pop_front() {
            return Some(answer);
        }
        if now < self.next || self.dead {
            return None;
        }
        let rate_hz = wire::RATES.iter().find(|(_, code)| *code == self.registers[3]).unwrap().0;
        self.next = self.next + Duration::from_secs_f64(1.0 / rate_hz);
        self.n += 1;
        let mut bytes = Vec::new();
        measured(self.n, self.writes).encode(&mut bytes);
        if self.registers[2] & 0x200 == 0 {
            bytes.truncate(33);
        }
        Some(bytes)
    }
}

fn rig(device: Pretended) -> Rig<WitMotionSession, Pretended> {
    Rig::open(WitMotionSession::new(Settings::default(), 115_200, &[0]).unwrap(), device)
}

fn oriented(samples: &[Sample]) -> usize {
    let is =
        |sample: &&Sample| matches!(sample.measurement, Measurement::Imu { orientation_wxyz: Some(_), .. });
    samples.iter().filter(is).count()
}

#[test]
fn a_sensor_is_unlocked_set_up_and_streams() {
    let mut rig = rig(Pretended::new());
    rig.run_stored_ms(900);
    assert!(rig.is_streaming(), "{}", rig.reason());
    rig.samples.clear();
    rig.run_ms(1000);
    assert!((99..=101).contains(&rig.samples.len()), "{}", rig.samples.len());
    assert_eq!((oriented(&rig.samples), rig.warnings.len()), (rig.samples.len(), 0), "{:?}", rig.warnings);
    assert_eq!(rig.session.losses()[0].lost, 0);
    // Nothing was saved.
    assert!(!rig.device.received.windows(3).any(|command| command == [0xFF, 0xAA, 0x00]));
}

#[test]
fn the_order_of_the_quaternion_is_proven_by_the_angles() {
    let mut last = rig(Pretended { writes: Writes::Last, ..Pretended::new() });
    last.run_ms(1500);
    assert!(last.warnings.iter().any(|text| text.contains("scalar last")), "{:?}", last.warnings);
    let mut first = rig(Pretended::new());
    first.run_ms(1500);
    let pose = |sample: &Sample| match sample.measurement {
        Measurement::Imu { orientation_wxyz: Some(q), .. } => q,
        _ => panic!("{sample:?}"),
    };
    for (one, other) in first.samples.iter().zip(&last.samples) {
        assert_eq!(pose(one), pose(other));
    }
    let mut neither = rig(Pretended { writes: Writes::Nonsense, ..Pretended::new() });
    neither.run_ms(700);
    assert_eq!(oriented(&neither.samples), 0, "nothing is published of what is not understood");
    neither.run_ms(900);
    assert!(oriented(&neither.samples) > 0 && neither.warnings.iter().any(|text| text.contains("disagree")));
}

#[test]
fn a_lock_and_a_sensor_that_cannot_be_asked_are_reported() {
    let mut locked = rig(Pretended { is_locked_for_good: true, ..Pretended::new() });
    locked.run_ms(3500);
    assert!(locked.warnings.iter().any(|text| text.contains("keep its settings")), "{:?}", locked.warnings);
    assert!(matches!(locked.session.state(), State::Silent { .. }), "{:?}", locked.session.state());
    let mut mute = rig(Pretended { answers: false, ..Pretended::new() });
    mute.run_ms(4000);
    assert!(mute.is_streaming() && mute.warnings.iter().any(|text| text.contains("does not answer")));
}

#[test]
fn a_rate_that_the_line_does_not_carry_is_lowered() {
    for (baud, rate_hz, taken_hz) in
        [(9600, 100.0, 20.0), (115_200, 170.0, 200.0), (57_600, 200.0, 100.0), (0, 200.0, 200.0)]
    {
        let session = WitMotionSession::new(Settings { rate_hz }, baud, &[0]).unwrap();
        assert_eq!(session.rate_hz(), Some(taken_hz), "{rate_hz} Hz at {baud}");
        let mut rig = Rig::open(session, Pretended::new());
        rig.run_ms(1500);
        assert_eq!(rig.warnings.iter().any(|text| text.contains("raise `baud`")), taken_hz < rate_hz);
    }
}

#[test]
fn silence_is_reported_and_the_sensor_set_up_again() {
    let mut rig = rig(Pretended::new());
    rig.run_ms(1500);
    rig.device.dead = true;
    rig.run_ms(5000);
    assert!(matches!(rig.session.state(), State::Silent { .. }));
    rig.device = Pretended { next: rig.now, ..Pretended::new() };
    rig.run_ms(2000);
    assert!(rig.is_streaming(), "{}", rig.reason());
    let loss = rig.session.losses()[0];
    assert!(loss.estimated && (450..=700).contains(&loss.lost), "{loss:?}");
}

#[test]
fn settings_and_addresses_are_checked() {
    for wanted in [&[][..], &[1], &[0, 1], &[0, 0]] {
        assert!(WitMotionSession::new(Settings::default(), 0, wanted).is_err(), "{wanted:?}");
    }
    assert!(WitMotionSession::new(Settings { rate_hz: 201.0 }, 0, &[0]).is_err());
}

/// Gives a damaged stream to a session that streams; returns samples and those that are none of the true ones.
fn wrong(kinds: &[Damage], seed: u64) -> (usize, usize) {
    let mut rig = rig(Pretended::new());
    rig.run_ms(1000);
    let first = rig.device.n + 1;
    let messages: Vec<Vec<u8>> = (first..first + 200)
        .map(|n| {
            let mut bytes = Vec::new();
            measured(n, Writes::First).encode(&mut bytes);
            bytes
        })
        .collect();
    let mut noise = Noise::new(seed);
    let (mut now, mut samples, mut wrong) = (rig.now, 0, 0);
    for chunk in damaged(&messages, kinds, &mut noise) {
        now = now + Duration::from_millis(10);
        rig.session.handle_bytes(now, &chunk);
        while let Some(output) = rig.session.poll_output() {
            let Output::Sample(sample) = output else { continue };
            let Measurement::Imu {
                orientation_wxyz: Some(q),
                specific_force_m_s2: Some(force),
                angular_velocity_rad_s: Some(turn),
                ..
            } = sample.measurement
            else {
                panic!()
            };
            let is_true = (first..first + 200).map(|n| measured(n, Writes::First)).any(|put| {
                let near = |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 5e-3);
                let [roll, pitch, yaw] = put.angles_rad;
                let of = posed_drivers::flock::wire::rotation::from_angles([yaw, pitch, roll]);
                near(force, put.specific_force_m_s2)
                    && near(turn, put.angular_velocity_rad_s)
                    && q.iter().zip(of).all(|(a, b)| (a - b).abs() < 1e-3)
            });
            samples += 1;
            wrong += usize::from(!is_true);
        }
    }
    (samples, wrong)
}

#[test]
fn damage_makes_no_wrong_sample() {
    let kinds = [&FRAMING[..], &[Damage::Flipped]].concat();
    let runs = (0..1000).map(|seed| wrong(&kinds, seed));
    let (samples, wrong) = runs.fold((0, 0), |(all, bad), (samples, wrong)| (all + samples, bad + wrong));
    assert!(samples > 1000 * 150, "{samples} of {}", 1000 * 200);
    assert_eq!(wrong, 0);
}

#[test]
fn lost_bytes_are_counted_and_leave_doubt() {
    let mut rig = rig(Pretended::new());
    rig.run_ms(2000);
    rig.session.handle_line(rig.now, &LineEvent::Dropped { bytes: 3 * 44 });
    rig.device.n += 3;
    rig.device.next = rig.device.next + Duration::from_millis(30);
    rig.samples.clear();
    rig.run_ms(500);
    assert_eq!(rig.session.losses()[0].lost, 3);
    assert!(rig.samples[0].arrival.after_loss);
}
