//! Fastrak: worked examples, round trips, and the session against a pretended unit.

use std::collections::VecDeque;
use std::time::Duration;

use posed_drivers::fastrak::wire::{Piece, Record, Shape, Splitter};
use posed_drivers::fastrak::{FastrakSession, Settings};
use posed_drivers::{DeviceTime, LineEvent, Measurement, Session, State, Timestamp};
use proptest::prelude::*;

use crate::hex;
use crate::rig::{Device, Rig};

const BINARY: Shape = Shape { text: false, button: false };

fn records(bytes: &[u8], shape: Shape) -> Vec<Record> {
    let mut splitter = Splitter::new(shape);
    splitter.push(bytes);
    std::iter::from_fn(|| splitter.find())
        .filter_map(|piece| if let Piece::Record { record, .. } = piece { Some(record) } else { None })
        .collect()
}

#[test]
fn worked_example() {
    // The sheet's record with CR LF in place of the space: 12, -3.5, 20.25 and a quaternion.
    let bytes = hex(
        "30 31 20 00 00 40 41 00 00 60 C0 00 00 A2 41 75 3D 27 3F 7F 78 33 3F A9 05 BD 3D D4 8B 8A 3E 0D 0A",
    );
    assert_eq!(bytes.len(), BINARY.binary_len());
    let record = records(&bytes, BINARY)[0];
    assert_eq!((record.station, record.status), (1, b' '));
    for (value, expected) in record.position_m.iter().zip([0.12, -0.035, 0.2025]) {
        assert!((value - expected).abs() < 1e-12);
    }
    for (value, expected) in record.orientation_wxyz.iter().zip([0.65328, 0.70106, 0.09230, 0.27060]) {
        assert!((value - expected).abs() < 1e-5);
    }
}

#[test]
fn text_fields_may_touch() {
    let line = b"02 -120.0000-115.2500   20.2500   0.5000  -0.5000-0.5000 0.5000\r\n";
    let record = records(line, Shape { text: true, button: false })[0];
    assert_eq!(record.station, 2);
    assert_eq!(record.position_m, [-1.2, -1.1525, 0.2025]);
    assert_eq!(record.orientation_wxyz, [0.5, -0.5, -0.5, 0.5]);
}

#[test]
fn a_line_of_text_that_has_lost_a_byte_is_refused_though_its_numbers_can_be_read() {
    let shape = Shape { text: true, button: false };
    let line = b"02   46.4311 -12.4180   4.5738  -0.0612   0.0255   0.3404   0.9379\r\n";
    for lost in 0..line.len() - 2 {
        let mut stream = line.to_vec();
        stream.extend(line.iter().enumerate().filter(|(at, _)| *at != lost).map(|(_, byte)| byte));
        stream.extend(line);
        assert_eq!(records(&stream, shape).len(), 2, "without byte {lost}");
    }
    // Another width of all lines is believed after a few.
    let wider = b"02    46.4311  -12.4180    4.5738   -0.0612    0.0255    0.3404    0.9379\r\n";
    let stream = [&line[..], &wider.repeat(6)].concat();
    assert_eq!(records(&stream, shape).len(), 4);
}

prop_compose! {
    fn any_record()(
        station in 1_u8..=4,
        position_m in proptest::array::uniform3(-3.0_f64..3.0),
        q in proptest::array::uniform4(-1.0_f64..1.0).prop_filter("long", |q| q.iter().map(|v| v * v).sum::<f64>() > 0.1),
        button: bool,
    ) -> Record {
        let norm = q.iter().map(|v| v * v).sum::<f64>().sqrt();
        let orientation_wxyz = q.map(|v| v / norm);
        Record { station, status: b' ', position_m, orientation_wxyz, button: Some(button) }
    }
}

proptest! {
    #[test]
    fn round_trip(record in any_record(), text: bool, button: bool) {
        let shape = Shape { text, button };
        let mut bytes = Vec::new();
        record.encode(shape, &mut bytes);
        let [back] = records(&bytes, shape)[..] else { panic!("{bytes:?}") };
        let tolerance = if text { 1e-4 } else { 1e-6 };
        prop_assert_eq!(back.station, record.station);
        prop_assert_eq!(back.button, record.button.filter(|_| button));
        for (a, b) in back.position_m.iter().chain(&back.orientation_wxyz).zip(record.position_m.iter().chain(&record.orientation_wxyz)) {
            prop_assert!((a - b).abs() < tolerance, "{} {}", a, b);
        }
    }

    #[test]
    fn a_lost_byte_costs_at_most_its_record_and_the_next(record in any_record(), at in 0_usize..33) {
        let mut one = Vec::new();
        record.encode(BINARY, &mut one);
        let mut bytes = one.repeat(4);
        bytes.remove(33 + at);
        let found = records(&bytes, BINARY);
        prop_assert!(found.len() >= 2);
        let whole = records(&one, BINARY)[0];
        prop_assert!(found.iter().all(|record| *record == whole));
    }
}

/// A unit that obeys the commands that set-up uses.
struct Pretended {
    stations: Vec<u8>,
    shape: Shape,
    on: bool,
    dead: bool,
    status: u8,
    next: Timestamp,
    turn: usize,
    out: VecDeque<Vec<u8>>,
    received: Vec<u8>,
    skip: usize,
    /// Records to come whose first byte is damaged, and bytes at the front of the next one that are lost.
    damaged: usize,
    cut: usize,
    /// From one record to the next.
    period: Duration,
}

impl Pretended {
    fn new() -> Self {
        Self {
            stations: vec![1, 2, 3, 4],
            shape: BINARY,
            on: true,
            dead: false,
            status: b' ',
            next: Timestamp::ZERO,
            turn: 0,
            out: VecDeque::new(),
            received: vec![],
            skip: 0,
            damaged: 0,
            cut: 0,
            period: Duration::from_nanos(8_333_333),
        }
    }
}

impl Device for Pretended {
    fn receive(&mut self, now: Timestamp, bytes: &[u8]) {
        self.received.extend(bytes);
        if self.dead {
            return;
        }
        let text = String::from_utf8(bytes.to_vec()).unwrap();
        if text == "\rc" {
            self.on = false;
        } else if text == "S" {
            let status = format!("21S000000      2.08  {:<32}\r\n", "FASTRAK");
            self.out.push_back(status.into_bytes());
        } else if text.ends_with('C') {
            self.stations = (1..=4).filter(|station| text.contains(&format!("l{station},1\r"))).collect();
            self.shape = Shape { text: text.ends_with("FC"), button: text.contains("2,11,16,1") };
            self.on = true;
            self.turn = 0;
            self.next = now;
        }
    }

    fn send(&mut self, now: Timestamp) -> Option<Vec<u8>> {
        if self.on && !self.dead && now >= self.next {
            self.next = self.next.max(now - Duration::from_millis(5)) + self.period;
            let station = self.stations[self.turn % self.stations.len()];
            self.turn += 1;
            if self.skip > 0 {
                self.skip -= 1;
            } else {
                let mut bytes = Vec::new();
                Record {
                    station,
                    status: self.status,
                    position_m: [0.5, 0.25, -0.125],
                    orientation_wxyz: [0.5, 0.5, -0.5, 0.5],
                    button: Some(true),
                }
                .encode(self.shape, &mut bytes);
                if self.damaged > 0 {
                    self.damaged -= 1;
                    bytes[0] ^= 0x40;
                }
                bytes.drain(..std::mem::take(&mut self.cut));
                self.out.push_back(bytes);
            }
        }
        self.out.pop_front()
    }
}

fn rig(settings: Settings, wanted: &[u16]) -> Rig<FastrakSession, Pretended> {
    Rig::open(FastrakSession::new(settings, wanted).unwrap(), Pretended::new())
}

#[test]
fn a_unit_is_set_up_and_streams() {
    for text in [false, true] {
        for button in [false, true] {
            let mut rig = rig(Settings { text, button, ..Settings::default() }, &[1, 3]);
            rig.run_stored_ms(750);
            assert!(rig.is_streaming(), "{}", rig.reason());
            rig.samples.clear();
            rig.run_ms(1000);
            assert!((119..=121).contains(&rig.samples.len()), "{}", rig.samples.len());
            let sample = rig.samples[0];
            let Measurement::Pose { position_m, orientation_wxyz, button: pressed, .. } = sample.measurement
            else {
                panic!()
            };
            assert_eq!(position_m, Some([0.5, 0.25, -0.125]));
            assert_eq!(orientation_wxyz, Some([0.5, 0.5, -0.5, 0.5]));
            assert_eq!(pressed, button.then_some(1));
            let cycles: Vec<_> = rig.samples.iter().map(|sample| sample.t_device).collect();
            let DeviceTime::Cycle(first) = cycles[0] else { panic!() };
            let DeviceTime::Cycle(last) = cycles[cycles.len() - 1] else { panic!() };
            assert!((59..=60).contains(&(last - first)));
            assert!(rig.session.losses().iter().all(|loss| loss.lost == 0));
            assert_eq!(rig.session.counters().rejected, 0);
        }
    }
}

#[test]
fn passed_over_stations_are_lost() {
    let mut rig = rig(Settings::default(), &[1, 2, 3]);
    rig.run_ms(1000);
    rig.device.skip = 1;
    rig.run_ms(100);
    let lost: u64 = rig.session.losses().iter().map(|loss| loss.lost).sum();
    assert_eq!(lost, 1);
}

#[test]
fn what_a_gap_swallows_is_counted_by_time() {
    for stations in [&[1][..], &[1, 2], &[1, 2, 3, 4]] {
        for lost in [1, 4, 7, 24, 30] {
            let mut rig = rig(Settings::default(), stations);
            rig.run_ms(1000);
            let before = rig.samples.len() as u64;
            rig.device.skip = lost;
            rig.run_stored_ms(2000);
            let losses = rig.session.losses();
            let reported: u64 = losses.iter().map(|loss| loss.lost).sum();
            let case = format!("{lost} records of {} stations: {losses:?}", stations.len());
            assert!(reported.abs_diff(lost as u64) <= 1, "{case}");
            assert!(losses.iter().all(|loss| loss.estimated == (loss.lost > 0)), "{case}");
            // It is reported 0.1 s later, when a clock has detected it by itself: the number of a cycle must not report it again.
            let cycle = |at: usize| match rig.samples[at].t_device {
                DeviceTime::Cycle(cycle) => cycle,
                DeviceTime::Counter { .. } => unreachable!(),
            };
            let turns = cycle(rig.samples.len() - 1) - cycle(before as usize - 1);
            let records = rig.samples.len() as u64 - before;
            assert!(turns.abs_diff(records / stations.len() as u64) <= 1, "{case}: {turns} cycles");
        }
    }
}

#[test]
fn damaged_records_are_counted_by_their_bytes_and_lost_bytes_leave_doubt() {
    for text in [false, true] {
        for stations in [&[1][..], &[1, 2], &[1, 2, 3, 4]] {
            for records in [1, 3, 9] {
                let mut rig = rig(Settings { text, ..Settings::default() }, stations);
                rig.run_ms(1000);
                rig.samples.clear();
                rig.device.damaged = records;
                rig.run_ms(300);
                let case = format!("{records} of {} stations, text {text}", stations.len());
                let lost: u64 = rig.session.losses().iter().map(|loss| loss.lost).sum();
                assert_eq!(lost, records as u64, "{case}");
                // Of more than one, the bytes may be as many by chance.
                let doubtful = rig.samples.iter().any(|sample| sample.arrival.after_loss);
                assert_eq!(doubtful, records > 1, "{case}");

                rig.samples.clear();
                rig.device.cut = 13;
                rig.run_stored_ms(300);
                // Each station has a clock of its own: each reports it, once.
                let reported = rig.samples.iter().filter(|sample| sample.arrival.after_loss);
                let mut reported: Vec<_> = reported.map(|sample| sample.address).collect();
                reported.sort_unstable();
                assert_eq!(reported, *stations, "{case}");
            }
        }
    }
}

#[test]
fn any_number_of_dropped_bytes_is_borne() {
    let mut rig = rig(Settings::default(), &[1, 2]);
    rig.run_ms(1000);
    let now = Timestamp::from_secs_f64(1.0);
    rig.session.handle_line(now, &LineEvent::Dropped { bytes: u64::MAX / 2 });
    rig.samples.clear();
    rig.run_ms(500);
    assert!(rig.samples.len() > 50 && rig.is_streaming());
    assert_eq!(rig.samples.iter().filter(|sample| sample.arrival.after_loss).count(), 2);
}

#[test]
fn what_a_host_holds_back_is_not_lost() {
    // At half the pace, too, as a slow line has it.
    for period_ns in [8_333_333, 16_666_667] {
        let mut rig = rig(Settings::default(), &[1, 2]);
        rig.device.period = Duration::from_nanos(period_ns);
        rig.run_ms(3000);
        for held_ms in [16, 40, 150, 250] {
            for _ in 0..20 {
                rig.hold_back_ms(held_ms);
                rig.run_ms(100);
            }
        }
        for _ in 0..500 {
            rig.hold_back_ms(16);
        }
        assert!(rig.session.losses().iter().all(|loss| loss.lost == 0), "{:?}", rig.session.losses());
    }
}

#[test]
fn poses_of_a_station_in_error_are_not_used() {
    let mut rig = rig(Settings::default(), &[1]);
    rig.run_ms(1000);
    rig.device.status = b'E';
    rig.samples.clear();
    let before = rig.session.counters();
    rig.run_ms(200);
    let counters = rig.session.counters();
    let refused = counters.rejected - before.rejected;
    assert_eq!(counters.bytes_skipped - before.bytes_skipped, refused * BINARY.binary_len() as u64);
    assert!(rig.samples.is_empty());
    assert!(rig.session.counters().rejected >= 20);
    assert_eq!(rig.warnings.len(), 1, "{:?}", rig.warnings);
}

#[test]
fn silence_is_reported_and_the_unit_reset() {
    let mut rig = rig(Settings::default(), &[1]);
    rig.run_ms(1000);
    rig.device.dead = true;
    rig.run_ms(6000);
    assert!(matches!(rig.session.state(), State::Silent { .. }));
    let resets = |rig: &Rig<_, Pretended>| rig.device.received.iter().filter(|&&byte| byte == 0x19).count();
    assert_eq!(resets(&rig), 1, "a unit that is being reset is left to it");
    rig.run_ms(11_000);
    assert_eq!(resets(&rig), 1);
    rig.run_ms(6000);
    assert_eq!(resets(&rig), 2);
    // It was off, and has never heard of a reset: it is not kept waiting for the end of one.
    rig.device.dead = false;
    let before = rig.samples.len() as u64;
    rig.run_ms(2500);
    assert!(rig.is_streaming(), "{}", rig.reason());
    let (loss, ours) = (rig.session.losses()[0], rig.samples.len() as u64 - before);
    assert!(loss.estimated && (loss.lost + ours).abs_diff(25 * 120 + 60) <= 3, "{loss:?} and {ours}");
}

#[test]
fn stations_are_checked() {
    for wanted in [&[][..], &[0], &[5], &[1, 1], &[256]] {
        assert!(FastrakSession::new(Settings::default(), wanted).is_err(), "{wanted:?}");
    }
}
