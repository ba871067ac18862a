//! The Xbus session against pretended devices.

use std::collections::VecDeque;
use std::time::Duration;

use posed_drivers::xbus::message::{self, Configuration, Tracker};
use posed_drivers::xbus::mtdata::{Block, Layout, Orientation};
use posed_drivers::xbus::mtdata2::{self, id};
use posed_drivers::xbus::{Framer, Settings, XbusSession};
use posed_drivers::{DeviceTime, Measurement, Session, State, Timestamp};

use crate::rig::{Device, Rig};

#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Chain(usize),
    Legacy,
    Items,
}

/// An Xsens device with as much behaviour as the tests ask for.
struct Pretended {
    kind: Kind,
    framer: Framer,
    out: VecDeque<Vec<u8>>,
    measuring: bool,
    answers: bool,
    layouts: Vec<Layout>,
    period_ticks: u16,
    skip_factor: u16,
    /// What it claims in place of the rates that it was set to.
    claims: Option<u16>,
    outputs: Vec<(u16, u16)>,
    /// Quantity that the device does not have.
    lacks: Option<u16>,
    counter: u16,
    next: Timestamp,
    writes: usize,
    /// Periods to leave out while the counter goes on.
    skip: u16,
    resets: usize,
    quaternion: [f64; 4],
}

impl Pretended {
    fn new(kind: Kind) -> Self {
        let trackers = if let Kind::Chain(n) = kind { n } else { 1 };
        Self {
            kind,
            framer: Framer::default(),
            out: VecDeque::new(),
            measuring: true,
            answers: true,
            layouts: vec![Layout { mode: 4, settings: 8 }; trackers],
            period_ticks: 2304,
            skip_factor: 0,
            claims: None,
            outputs: vec![],
            lacks: None,
            counter: 65_500,
            next: Timestamp::ZERO,
            writes: 0,
            skip: 0,
            resets: 0,
            quaternion: [1.0, 0.0, 0.0, 0.0],
        }
    }

    fn answer(&mut self, bid: u8, mid: u8, data: &[u8]) {
        self.out.push_back(message::request(bid, mid, data));
    }

    fn rate_hz(&self) -> f64 {
        match self.kind {
            Kind::Items => {
                self.outputs.iter().find(|(_, hz)| *hz != 0xFFFF).map_or(100.0, |&(_, hz)| hz.into())
            }
            _ => 115_200.0 / f64::from(self.period_ticks),
        }
    }

    fn request(&mut self, bid: u8, mid: u8, data: &[u8]) {
        let index = if bid == 0xFF { 0 } else { usize::from(bid) - 1 };
        if mid == message::RESET {
            self.resets += 1;
            self.measuring = false;
            self.answers = true;
            return self.answer(0xFF, message::WAKE_UP, &[]);
        }
        if !self.answers {
            return;
        }
        if self.measuring && mid != message::GOTO_CONFIG {
            return;
        }
        let is_items = self.kind == Kind::Items;
        match mid {
            message::GOTO_CONFIG => {
                self.measuring = false;
                self.answer(bid, mid + 1, &[]);
            }
            message::GOTO_MEASUREMENT => {
                self.answer(bid, mid + 1, &[]);
                self.measuring = true;
            }
            message::REQ_DEVICE_ID => {
                let id: u32 = if let Kind::Chain(_) = self.kind { 0x0010_0021 } else { 0x0032_03E9 };
                self.answer(bid, mid + 1, &id.to_be_bytes());
            }
            message::INIT_BUS => {
                let ids: Vec<u8> =
                    (0..self.layouts.len() as u32).flat_map(|k| (0x0032_03E9 + k).to_be_bytes()).collect();
                self.answer(bid, mid + 1, &ids);
            }
            message::REQ_CONFIGURATION => {
                let chain = matches!(self.kind, Kind::Chain(_));
                let configuration = Configuration {
                    master_id: if chain { 0x0010_0021 } else { 0x0032_03E9 },
                    period_ticks: self.claims.unwrap_or(self.period_ticks),
                    skip_factor: self.skip_factor,
                    trackers: (0..)
                        .zip(&self.layouts)
                        .map(|(k, &layout)| Tracker {
                            device_id: 0x0032_03E9 + k,
                            data_len: layout.block_len() as u16,
                            layout,
                        })
                        .collect(),
                };
                self.answer(bid, mid + 1, &configuration.encode());
            }
            message::OUTPUT_CONFIGURATION if is_items => {
                if !data.is_empty() {
                    self.writes += 1;
                    self.outputs = message::output_configuration(data).unwrap();
                    self.outputs.retain(|(id, _)| self.lacks != Some(*id));
                }
                let claimed = |hz: u16| self.claims.filter(|_| hz != 0xFFFF).unwrap_or(hz);
                let list = self.outputs.iter().flat_map(|&(id, hz)| [id, claimed(hz)]);
                let list: Vec<u8> = list.flat_map(u16::to_be_bytes).collect();
                self.answer(bid, mid + 1, &list);
            }
            message::OUTPUT_MODE if !is_items => {
                self.writes += 1;
                self.layouts[index].mode = u16::from_be_bytes(data.try_into().unwrap());
                self.answer(bid, mid + 1, &[]);
            }
            message::OUTPUT_SETTINGS if !is_items => {
                self.writes += 1;
                self.layouts[index].settings = u32::from_be_bytes(data.try_into().unwrap());
                self.answer(bid, mid + 1, &[]);
            }
            message::PERIOD if !is_items => {
                self.writes += 1;
                let ticks = u16::from_be_bytes(data.try_into().unwrap());
                if ticks < 1000 && self.layouts.len() > 4 {
                    return self.answer(bid, message::ERROR, &[0x03]);
                }
                self.period_ticks = ticks;
                self.answer(bid, mid + 1, &[]);
            }
            message::WAKE_UP_ACK => {}
            _ => self.answer(bid, message::ERROR, &[0x04]),
        }
    }

    fn data(&self) -> Vec<u8> {
        let mut data = Vec::new();
        if self.kind == Kind::Items {
            mtdata2::encode_bytes(id::PACKET_COUNTER, &self.counter.to_be_bytes(), &mut data);
            let ticks = u32::from(self.counter) * 100;
            mtdata2::encode_bytes(id::SAMPLE_TIME_FINE, &ticks.to_be_bytes(), &mut data);
            for &(id, _) in &self.outputs {
                match id {
                    id::ACCELERATION => mtdata2::encode_numbers(id, &[0.0, 0.0, 9.75], &mut data),
                    id::RATE_OF_TURN => mtdata2::encode_numbers(id, &[0.25, 0.0, 0.0], &mut data),
                    id::MAGNETIC_FIELD => mtdata2::encode_numbers(id, &[0.0, 0.5, -0.75], &mut data),
                    id::QUATERNION => mtdata2::encode_numbers(id, &self.quaternion, &mut data),
                    _ => {}
                }
            }
            return message::request(0xFF, message::MTDATA2, &data);
        }
        let chain = matches!(self.kind, Kind::Chain(_));
        if chain {
            data.extend(self.counter.to_be_bytes());
        }
        for (k, layout) in self.layouts.iter().enumerate() {
            let block = Block {
                acceleration: Some([0.0, 0.0, 9.75]),
                rate_of_turn: Some([0.25 * (k + 1) as f64, 0.0, 0.0]),
                magnetic_field: Some([0.0, 0.5, -0.75]),
                orientation: (layout.settings & 0x0C == 0)
                    .then_some(Orientation::Quaternion([1.0, 0.0, 0.0, 0.0])),
                ..Block::default()
            };
            layout.encode(&block, &mut data);
            if layout.has_counter() {
                data.extend(self.counter.to_be_bytes());
            }
        }
        message::request(0xFF, message::MTDATA, &data)
    }
}

impl Device for Pretended {
    fn receive(&mut self, _: Timestamp, bytes: &[u8]) {
        let mut framer = std::mem::take(&mut self.framer);
        framer.push(bytes);
        while let Some(found) = framer.find() {
            let frame = framer.frame(found);
            self.request(frame.bid, frame.mid, frame.data);
        }
        self.framer = framer;
    }

    fn send(&mut self, now: Timestamp) -> Option<Vec<u8>> {
        if self.measuring && now >= self.next {
            self.next = now.max(self.next) + Duration::from_secs_f64(1.0 / self.rate_hz());
            self.counter = self.counter.wrapping_add(1 + std::mem::take(&mut self.skip));
            let data = self.data();
            self.out.push_back(data);
        }
        self.out.pop_front()
    }
}

fn rig(kind: Kind, settings: Settings, baud: u32) -> Rig<XbusSession, Pretended> {
    let wanted: Vec<u16> = if let Kind::Chain(n) = kind { (1..=n as u16).collect() } else { vec![1] };
    Rig::open(XbusSession::new(settings, baud, &wanted).unwrap(), Pretended::new(kind))
}

/// A device that does not answer until it is asked to.
fn unresponsive(baud: u32, measuring: bool) -> Rig<XbusSession, Pretended> {
    let device = Pretended { answers: false, measuring, ..Pretended::new(Kind::Items) };
    Rig::open(XbusSession::new(Settings::default(), baud, &[1]).unwrap(), device)
}

#[test]
fn every_kind_of_device_is_set_up_and_streams() {
    for kind in [Kind::Chain(8), Kind::Legacy, Kind::Items] {
        let mut rig = rig(kind, Settings::default(), 921_600);
        rig.run_stored_ms(400);
        assert!(rig.is_streaming(), "{}", rig.reason());
        assert_eq!(rig.rts, Some(true));
        assert_eq!(rig.warnings, Vec::<String>::new());
        assert_eq!(rig.session.rate_hz(), Some(100.0));
        assert_eq!(rig.session.sensors()[0].serial.as_deref(), Some("003203E9"));
        rig.samples.clear();
        rig.run_ms(1000);
        let trackers = rig.session.sensors().len();
        assert_eq!(rig.samples.len(), 100 * trackers);
        let last = rig.samples[rig.samples.len() - 1];
        assert_eq!(
            last.measurement,
            Measurement::Imu {
                angular_velocity_rad_s: Some([0.25 * trackers as f64, 0.0, 0.0]),
                specific_force_m_s2: Some([0.0, 0.0, 9.75]),
                linear_acceleration_m_s2: None,
                magnetic_field: Some([0.0, 0.5, -0.75]),
                orientation_wxyz: Some([1.0, 0.0, 0.0, 0.0]),
            }
        );
        // The counter has wrapped on the way; the time goes on.
        let DeviceTime::Counter { ticks, tick_s } = last.t_device else { panic!("{:?}", last.t_device) };
        let DeviceTime::Counter { ticks: first, .. } = rig.samples[0].t_device else { panic!() };
        if kind != Kind::Items {
            assert!(ticks > 65_536);
        }
        if kind != Kind::Items {
            assert!(((ticks - first) as f64 * tick_s - 0.99).abs() < 1e-6);
        }
        assert!(rig.session.losses().iter().all(|loss| loss.lost == 0));
    }
}

#[test]
fn a_device_that_is_set_right_is_not_written_to() {
    let mut first = rig(Kind::Chain(2), Settings::default(), 460_800);
    first.run_ms(500);
    let writes = first.device.writes;
    assert_eq!(writes, 5, "mode and settings of two trackers, and the period");
    first.session.handle_line(first.now, &posed_drivers::LineEvent::Opened { modem_lines: false });
    first.run_ms(500);
    assert!(first.is_streaming());
    assert_eq!(first.device.writes, writes);
}

#[test]
fn lost_periods_are_counted_for_every_tracker() {
    let mut rig = rig(Kind::Chain(3), Settings::default(), 460_800);
    rig.run_ms(500);
    rig.device.skip = 4;
    rig.run_ms(100);
    rig.device.skip = 1;
    rig.run_ms(100);
    let lost: Vec<(u16, u64, bool)> =
        rig.session.losses().iter().map(|loss| (loss.address, loss.lost, loss.estimated)).collect();
    assert_eq!(lost, [(1, 5, false), (2, 5, false), (3, 5, false)]);
}

#[test]
fn an_error_between_data_is_reported_and_changes_nothing() {
    let mut rig = rig(Kind::Chain(3), Settings::default(), 460_800);
    rig.run_ms(500);
    for _ in 0..20 {
        rig.device.out.push_back(message::request(0xFF, message::ERROR, &[0x1D, 3]));
        rig.run_ms(10);
    }
    assert!(rig.is_streaming());
    assert_eq!(rig.warnings.len(), 1, "{:?}", rig.warnings);
    assert!(rig.warnings[0].contains("tracker 3"), "{}", rig.warnings[0]);
}

#[test]
fn a_restart_in_mid_stream_is_answered_in_time() {
    let mut rig = rig(Kind::Items, Settings::default(), 115_200);
    rig.run_ms(500);
    rig.device.measuring = false;
    rig.device.counter = 0;
    rig.device.out.push_back(message::request(0xFF, message::WAKE_UP, &[]));
    rig.samples.clear();
    rig.run_ms(300);
    assert!(rig.is_streaming() && !rig.samples.is_empty(), "{}", rig.reason());
    assert!(rig.warnings.iter().any(|warning| warning.contains("restarted")));
    let loss = rig.session.losses()[0];
    assert!(loss.lost <= 3, "a new count is no loss, only the pause is: {loss:?}");
}

#[test]
fn missing_quantities_are_said() {
    let mut rig = rig(Kind::Items, Settings::default(), 115_200);
    rig.device.lacks = Some(id::MAGNETIC_FIELD);
    rig.run_ms(500);
    assert!(rig.is_streaming());
    assert!(rig.warnings.iter().any(|warning| warning.contains("magnetic field")), "{:?}", rig.warnings);
    let Measurement::Imu { magnetic_field, .. } = rig.samples[0].measurement else { panic!() };
    assert_eq!(magnetic_field, None);
}

#[test]
fn a_rate_that_cannot_be_is_not_believed() {
    // A skip factor of 65535; a period of one tick, which is 115,200 Hz; 65,534 Hz.
    for (kind, skip_factor, claims) in [
        (Kind::Legacy, 65_535, None),
        (Kind::Chain(2), 65_535, Some(65_535)),
        (Kind::Legacy, 0, Some(1)),
        (Kind::Legacy, 0, Some(0)),
        (Kind::Items, 0, Some(65_534)),
        (Kind::Items, 0, Some(2001)),
    ] {
        let mut rig = rig(kind, Settings::default(), 921_600);
        (rig.device.skip_factor, rig.device.claims) = (skip_factor, claims);
        rig.run_ms(600);
        assert!(rig.is_streaming(), "{}", rig.reason());
        assert_eq!(rig.session.rate_hz(), Some(100.0), "{skip_factor} {claims:?}");
        assert!(rig.warnings.iter().any(|warning| warning.contains("cannot be")), "{:?}", rig.warnings);
        let a_tick_is_a_period = |sample: &posed_drivers::Sample| match sample.t_device {
            DeviceTime::Counter { tick_s, .. } => tick_s == 0.01 || tick_s == 1e-4,
            DeviceTime::Cycle(_) => false,
        };
        assert!(rig.samples.iter().all(a_tick_is_a_period));
    }
}

#[test]
fn bytes_of_refused_messages_are_counted() {
    let mut rig = rig(Kind::Items, Settings::default(), 921_600);
    rig.run_ms(500);
    let before = rig.session.counters();
    // A rate of turn of 1000 rad/s cannot have been measured.
    let mut data = Vec::new();
    mtdata2::encode_numbers(id::RATE_OF_TURN, &[1000.0, 0.0, 0.0], &mut data);
    let impossible = message::request(0xFF, message::MTDATA2, &data);
    rig.device.out.push_back(impossible.clone());
    rig.run_ms(50);
    let counters = rig.session.counters();
    assert_eq!(counters.rejected - before.rejected, 1);
    assert_eq!(counters.bytes_skipped - before.bytes_skipped, impossible.len() as u64);
}

#[test]
fn a_message_that_ends_in_the_next_one_is_refused_though_its_sum_fits() {
    let mut rig = rig(Kind::Chain(2), Settings::default(), 921_600);
    rig.run_ms(500);
    assert!(rig.is_streaming(), "{}", rig.reason());
    let before = rig.session.counters().rejected;
    let next = rig.device.data();
    let mut data = next[4..next.len() - 1].to_vec();
    // The last byte of an angular velocity. Where it is lost, the preamble of the next message takes the place of the sum.
    data[17] = 0xFA;
    let mut bytes = message::request(0xFF, message::MTDATA, &data);
    bytes.remove(4 + 17);
    bytes.extend(next);
    rig.device.out.push_back(bytes);
    rig.samples.clear();
    rig.run_ms(100);
    assert!(rig.session.counters().rejected > before);
    assert!(rig.samples.len() >= 10);
    for sample in &rig.samples {
        let Measurement::Imu { magnetic_field, .. } = sample.measurement else { panic!() };
        assert_eq!(magnetic_field, Some([0.0, 0.5, -0.75]));
    }
}

#[test]
fn the_rate_gives_way_to_line_and_device() {
    // Ten trackers of 52 bytes: 21 Hz at 115200 baud.
    let mut slow = rig(Kind::Chain(10), Settings::default(), 115_200);
    slow.run_ms(600);
    assert!(slow.is_streaming(), "{}", slow.reason());
    assert!((20.0..=21.0).contains(&slow.session.rate_hz().unwrap()));
    assert!(slow.warnings[0].contains("115200 baud"), "{:?}", slow.warnings);

    // The pretended master refuses periods under 1000 ticks.
    let settings = Settings { rate_hz: 200.0, ..Settings::default() };
    let mut refused = rig(Kind::Chain(5), settings, 921_600);
    refused.run_ms(600);
    assert!(refused.is_streaming(), "{}", refused.reason());
    assert!((refused.session.rate_hz().unwrap() - 112.0).abs() < 0.1);
    assert!(
        refused.warnings.iter().any(|warning| warning.contains("out of range")),
        "{:?}",
        refused.warnings
    );
}

#[test]
fn data_of_another_shape_is_refused_and_set_right() {
    let mut rig = rig(Kind::Chain(2), Settings::default(), 460_800);
    rig.run_ms(500);
    // Another program has changed the second tracker.
    rig.device.layouts[1] = Layout { mode: 2, settings: 0 };
    rig.samples.clear();
    rig.run_ms(90);
    assert!(rig.samples.is_empty());
    assert!(rig.session.counters().rejected > 0);
    rig.run_ms(500);
    assert!(rig.is_streaming() && rig.samples.len() > 40);
    assert!(rig.warnings.iter().any(|warning| warning.contains("something else")), "{:?}", rig.warnings);
}

#[test]
fn silence_is_reported_and_ended() {
    let mut rig = unresponsive(115_200, false);
    rig.run_ms(4000);
    assert!(matches!(rig.session.state(), State::Silent { .. }), "{:?}", rig.session.state());
    assert!(rig.reason().contains("115200"));
    rig.device.answers = true;
    rig.run_ms(2000);
    assert!(rig.is_streaming(), "{}", rig.reason());
    rig.device.measuring = false;
    rig.device.answers = false;
    rig.run_ms(400);
    assert!(matches!(rig.session.state(), State::Silent { .. }));
    rig.device.answers = true;
    let before = rig.samples.len() as u64;
    rig.run_ms(1500);
    assert!(rig.is_streaming());
    let loss = rig.session.losses()[0];
    let since_ms = 1900 - 10 * (rig.samples.len() as u64 - before);
    assert!(loss.estimated && loss.lost.abs_diff(since_ms / 10) <= 1, "{loss:?} of {since_ms} ms");
}

#[test]
fn a_device_that_ignores_goto_config_is_reset() {
    let mut rig = unresponsive(115_200, true);
    rig.run_ms(5000);
    assert_eq!(rig.device.resets, 1);
    assert!(rig.is_streaming(), "{}", rig.reason());
}

#[test]
fn a_wrong_baud_rate_is_named() {
    let mut rig = unresponsive(9600, false);
    for _ in 0..300 {
        rig.device.out.push_back(vec![0x00, 0xFE, 0xFA, 0x80]);
        rig.run_ms(10);
    }
    assert!(rig.reason().contains("9600 baud is no Xbus message"), "{}", rig.reason());
}

#[test]
fn addresses_are_checked() {
    for wanted in [&[][..], &[0, 1], &[1, 1], &[21]] {
        assert!(XbusSession::new(Settings::default(), 115_200, wanted).is_err(), "{wanted:?}");
    }
    let slow = Settings { rate_hz: 1.0, ..Settings::default() };
    assert!(XbusSession::new(slow, 115_200, &[1]).is_err());
    assert!(XbusSession::new(Settings::default(), 115_200, &[0]).is_ok());
}

#[test]
fn an_orientation_that_is_none_leaves_the_rest() {
    let mut rig = rig(Kind::Items, Settings::default(), 115_200);
    rig.device.quaternion = [0.0; 4];
    rig.run_ms(500);
    assert!(rig.is_streaming(), "{}", rig.reason());
    let Measurement::Imu { angular_velocity_rad_s, orientation_wxyz, .. } = rig.samples[0].measurement else {
        panic!()
    };
    assert_eq!((angular_velocity_rad_s, orientation_wxyz), (Some([0.25, 0.0, 0.0]), None));
}
